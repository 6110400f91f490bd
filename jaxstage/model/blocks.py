"""Every signature of the library on one page.

A block is a record of pure functions for ONE run. Its parameters, gains and memory are pytrees
handed in explicitly, so that any of them can be batched, differentiated or tuned. An empty
tuple stands for "no parameters" and "no memory". Shapes: `array_types`; units: SI, commands in
the `command_unit` of the plant.
"""

import math
from collections.abc import Callable
from typing import Any, Generic, TypeAlias, TypeVar

from jax import Array

from jaxstage.model.array_types import PerAxis, RandomKey, Scalar, Tick
from jaxstage.model.fields import definition
from jaxstage.model.signals import Measurement, Nearest, Output, Power, Sample, Setpoint

#: pytree of a block's parameters
Params = TypeVar("Params")
#: pytree of the state of a plant
State = TypeVar("State")
#: pytree of what is tuned of a law
Gains = TypeVar("Gains")
#: pytree that a law, sensor or drive carries from one period to the next
Memory = TypeVar("Memory")
#: pytree of the sums of a metric
Acc = TypeVar("Acc")
#: pytree that a metric finishes with
Report = TypeVar("Report")

#: force on the axes in N, positive against +x, at a fraction 0..1 of the substep
ForceProfile: TypeAlias = Callable[[Scalar | float], PerAxis]


def keep(gains: object, memory: Memory, demand: PerAxis, command: PerAxis, dt: float) -> Memory:
    """The `settle` of a law that does not care what the drive made of its demand."""
    return memory


def unlimited(gains: object) -> float:
    """The `longest_period` of a law that states none."""
    return math.inf


@definition
class Plant(Generic[Params, State]):
    """A machine: the equations of motion of its axes, discretised.

    Attributes:
        name: unique in the library.
        axes: names of the machine axes.
        command_unit: unit of what the plant is driven by, e.g. ``A``.
        init: ``(params, output) -> state`` at the given position and velocity, in equilibrium
            otherwise.
        step: ``(params, state, applied, force, dt) -> state`` after a substep of ``dt`` s with
            ``applied`` (axes,) held.
        observe: ``(params, state) -> output``.
        power: ``(params, before, after, applied, force, dt) -> power``, the mean over the substep
            between the two states.
        stored: ``(params, state) -> energy`` in J, (axes,).
    """

    name: str
    axes: tuple[str, ...]
    command_unit: str
    init: Callable[[Params, Output], State]
    step: Callable[[Params, State, PerAxis, ForceProfile, float], State]
    observe: Callable[[Params, State], Output]
    power: Callable[[Params, State, State, PerAxis, ForceProfile, float], Power]
    stored: Callable[[Params, State], PerAxis]


@definition
class Controller(Generic[Gains, Memory]):
    """A control law.

    ``control`` runs once a period; then ``settle`` hears the TOTAL demand of all laws and the
    command that the drive's limits left of it: observers use the command, anti-windup the
    difference. What ``settle`` needs of the measurement, ``control`` keeps in the memory.

    Attributes:
        name: unique in the library.
        init: ``(gains, setpoint, measurement) -> memory`` before the first period.
        control: ``(gains, memory, setpoint, measurement, dt) -> (demand, memory)``; demand (axes,).
        settle: ``(gains, memory, demand, command, dt) -> memory``.
        longest_period: ``gains -> period`` in s up to which the law's own memory is stable,
            elementwise in the gains; a longer one is refused.
    """

    name: str
    init: Callable[[Gains, Setpoint, Measurement], Memory]
    control: Callable[[Gains, Memory, Setpoint, Measurement, float], tuple[PerAxis, Memory]]
    settle: Callable[[Gains, Memory, PerAxis, PerAxis, float], Memory] = keep
    longest_period: Callable[[Gains], Array | float] = unlimited


@definition
class Reference(Generic[Params]):
    """A commanded motion, sampled at integer ticks, and its curve.

    Attributes:
        name: unique in the library.
        sample: ``(params, tick) -> setpoint``.
        nearest: ``(params, tick, position) -> nearest``, the point of the continuous curve nearest
            to ``position`` (axes,) m on the local branch around the commanded point of that tick.
        period: ``params -> time`` between two ticks in s, which must be the control period of the
            loop.
    """

    name: str
    sample: Callable[[Params, Tick], Setpoint]
    nearest: Callable[[Params, Tick, PerAxis], Nearest]
    period: Callable[[Params], Scalar | float]


@definition
class Load(Generic[Params]):
    """An external force, evaluated inside the integrator.

    Attributes:
        name: unique in the library.
        force: ``(params, time, key, output) -> force`` (axes,) in N, positive against +x; time
            in s. ``output`` is that of the start of the substep.
    """

    name: str
    force: Callable[[Params, Scalar, RandomKey, Output], PerAxis]


@definition
class Sensor(Generic[Params, Memory]):
    """What the controller sees of the truth; it may have memory (differencing, filtering).

    Attributes:
        name: unique in the library.
        init: ``(params, output) -> memory`` before the first sample.
        read: ``(params, memory, key, output, dt) -> (measurement, memory)``, once a period.
    """

    name: str
    init: Callable[[Params, Output], Memory]
    read: Callable[[Params, Memory, RandomKey, Output, float], tuple[Measurement, Memory]]


@definition
class Drive(Generic[Params, Memory]):
    """Limits turn the demand into the command; delay and lag turn that into what is applied.

    Attributes:
        name: unique in the library.
        init: ``(params, zero command) -> memory``.
        apply: ``(params, memory, demand, dt) -> (command, applied, memory)``, once a period.
        max_delay: largest dead time in periods that its memory holds.
    """

    name: str
    init: Callable[[Params, PerAxis], Memory]
    apply: Callable[[Params, Memory, PerAxis, float], tuple[PerAxis, PerAxis, Memory]]
    max_delay: int = 0


@definition
class Metric(Generic[Acc, Report]):
    """Sums kept online, and the numbers that a run finishes with.

    Attributes:
        name: key of its report among others.
        init: ``setpoint -> sums``, from the setpoint of the first tick.
        update: ``(sums, sample, dt) -> (sums, row)``, once a period. A row is stored for every
            tick; None stores nothing.
        finish: ``sums -> report``.
    """

    name: str
    init: Callable[[Setpoint], Acc]
    update: Callable[[Acc, Sample, float], tuple[Acc, Any]]
    finish: Callable[[Acc], Report]


@definition
class Engine:
    """How the ticks of a run are computed; the results mean the same.

    Attributes:
        name: of the engine.
        shortest: runs of at least so many ticks are compiled for this processor, where there is a
            C++ compiler and the loop can be written so (`explain` says); shorter ones are a
            ``lax.scan``.
        strict: a run that cannot be compiled is refused; else it is a scan, and a warning says so
            once.
    """

    name: str
    shortest: float
    strict: bool = False


#: compiles runs that are long enough to be worth it
auto = Engine(name="auto", shortest=4000)

#: compiles every run, and refuses what it cannot compile
compiled = Engine(name="compiled", shortest=1, strict=True)

#: ``lax.scan``, which defines what the others compute
scan = Engine(name="scan", shortest=math.inf)


@definition
class Loop:
    """Everything that is fixed about a simulation.

    Attributes:
        dt: control period in s.
        substeps: plant steps per period.
        segment: ticks per checkpointed segment of the scan, 0 for a plain scan (same values; less
            memory in reverse mode).
        path_limit: following error in m beyond which the run counts as having left the path.
        engine: `auto`, or `compiled` or `scan` for always or never the compiled engine.
    """

    plant: Plant[Any, Any]
    controller: Controller[Any, Any]
    reference: Reference[Any]
    load: Load[Any]
    sensor: Sensor[Any, Any]
    drive: Drive[Any, Any]
    metric: Metric[Any, Any]
    dt: float
    substeps: int = 1
    segment: int = 0
    path_limit: float = 0.1
    engine: Engine = auto
