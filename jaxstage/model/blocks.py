"""Every signature of the library on one page.

A block is a record of pure functions for ONE run. Its parameters, gains and memory are pytrees
handed in explicitly, so that any of them can be batched, differentiated or tuned. An empty
tuple stands for "no parameters" and "no memory".
"""

import math
from collections.abc import Callable
from typing import Any

from jax import Array

from jaxstage.model.fields import definition
from jaxstage.model.signals import Measurement, Nearest, Output, Power, Sample, Setpoint

Params = Any
Gains = Any
Memory = Any
State = Any
Acc = Any

#: force on the axes in N, positive against +x, at a fraction 0..1 of the substep
ForceProfile = Callable[[Array | float], Array]


def keep(gains: Gains, memory: Memory, demand: Array, command: Array, dt: float) -> Memory:
    """The `settle` of a law that does not care what the drive made of its demand."""
    return memory


def unlimited(gains: Gains) -> float:
    """The `longest_period` of a law that states none."""
    return math.inf


@definition
class Plant:
    """A machine. ``step`` integrates one substep of ``dt`` with ``applied`` held."""

    name: str
    axes: tuple[str, ...]
    command_unit: str
    init: Callable[[Params, Output], State]
    step: Callable[[Params, State, Array, ForceProfile, float], State]
    observe: Callable[[Params, State], Output]
    power: Callable[[Params, State, State, Array, ForceProfile, float], Power]
    stored: Callable[[Params, State], Array]


@definition
class Controller:
    """A law. ``control`` runs once a period; then ``settle`` hears the TOTAL demand of all laws
    and the command that the drive's limits left of it (observers use the command, anti-windup
    the difference). What ``settle`` needs of the measurement, ``control`` keeps in the memory.
    ``longest_period``: control period in s up to which the law's own memory is stable, elementwise
    in the gains; a longer one is refused."""

    name: str
    init: Callable[[Gains, Setpoint, Measurement], Memory]
    control: Callable[[Gains, Memory, Setpoint, Measurement, float], tuple[Array, Memory]]
    settle: Callable[[Gains, Memory, Array, Array, float], Memory] = keep
    longest_period: Callable[[Gains], Array | float] = unlimited


@definition
class Reference:
    """A commanded motion, sampled at integer ticks, and its curve.

    ``nearest(params, tick, position)`` is the point of the continuous curve nearest to
    ``position`` on the local branch around the commanded point of that tick. ``period(params)``
    is the time between two ticks in s, which must be the control period of the loop.
    """

    name: str
    sample: Callable[[Params, Array], Setpoint]
    nearest: Callable[[Params, Array, Array], Nearest]
    period: Callable[[Params], Array | float]


@definition
class Load:
    """External force (axes,) in N, positive against +x. It is evaluated inside the integrator."""

    name: str
    force: Callable[[Params, Array, Array, Output], Array]


@definition
class Sensor:
    """What the controller sees of the truth; it may have memory (differencing, filtering)."""

    name: str
    init: Callable[[Params, Output], Memory]
    read: Callable[[Params, Memory, Array, Output, float], tuple[Measurement, Memory]]


@definition
class Drive:
    """Limits turn the demand into the command; delay and lag turn that into what is applied.

    ``init`` gets the parameters and a zero command; ``max_delay``: largest dead time in periods
    that its memory holds."""

    name: str
    init: Callable[[Params, Array], Memory]
    apply: Callable[[Params, Memory, Array, float], tuple[Array, Array, Memory]]
    max_delay: int = 0


@definition
class Metric:
    """Sums kept online. ``update`` may return a row to be stored; None stores nothing."""

    name: str
    init: Callable[[Setpoint], Acc]
    update: Callable[[Acc, Sample, float], tuple[Acc, Any]]
    finish: Callable[[Acc], Any]


@definition
class Engine:
    """How the ticks of a run are computed; the results mean the same.

    shortest: runs of at least so many ticks are compiled for this processor, where there is a C++
    compiler and the loop can be written so (`explain` says); shorter ones are a ``lax.scan``.
    """

    name: str
    shortest: float


#: compiles runs that are long enough to be worth it
auto = Engine(name="auto", shortest=4000)

#: compiles every run
compiled = Engine(name="compiled", shortest=1)

#: ``lax.scan``, which defines what the others compute
scan = Engine(name="scan", shortest=math.inf)


@definition
class Loop:
    """Everything that is fixed about a simulation.

    dt: control period in s. substeps: plant steps per period. segment: ticks per checkpointed
    segment of the scan, 0 for a plain scan (same values; less memory in reverse mode).
    path_limit: following error in m beyond which the run counts as having left the path.
    engine: `auto`, or `compiled` or `scan` for always or never the compiled engine.
    """

    plant: Plant
    controller: Controller
    reference: Reference
    load: Load
    sensor: Sensor
    drive: Drive
    metric: Metric
    dt: float
    substeps: int = 1
    segment: int = 0
    path_limit: float = 0.1
    engine: Engine = auto
