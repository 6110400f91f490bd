"""What is timed: many runs of a loop that differ in gains and plant, and the same for C++."""

from functools import cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import jaxstage as js
from jaxstage.controllers import per_axis, sliding
from jaxstage.model.signals import Scenario, Start
from jaxstage.numerics.geometry import norm
from jaxstage.numerics.smooth import SmoothWidth, smooth
from jaxstage.references import circle, make_path
from jaxstage.references.timing import uniform_parameter

DT = 1e-4
LAWS = ("dfcmac", "sliding")
_PLANT: Any = Scenario(
    plant=0,
    load=None,
    sensor=None,
    drive=None,
    start=None,
    key=None,  # type: ignore[arg-type]
)
#: batch axes of (gains, scenario, path) for `rollouts`
SHARED_PATH = (0, _PLANT, None)


def _add(mean: Any, sample: js.Sample, dt: float) -> tuple[Any, None]:
    weight = 1 / (sample.step + 1).astype(mean.dtype)
    return mean + (norm(sample.setpoint.position - sample.output.position) - mean) * weight, None


#: the average tracking error and nothing else, as C++ computes it
average = js.Metric(
    name="average",
    init=lambda setpoint: jnp.zeros_like(setpoint.position[0]),
    update=_add,
    finish=lambda mean: mean,
)


class Work(NamedTuple):
    """A batch of runs; leaves of gains and plant have the batch as their leading axis."""

    law: str
    loop: js.Loop
    gains: Any
    scenario: Any
    path: Any
    ticks: int
    lanes: int

    @property
    def single(self) -> bool:
        """Whether the runs are in single precision."""
        return self.path.lap_time.dtype == np.float32

    @property
    def lane_steps(self) -> int:
        """Control periods simulated, of all runs together."""
        return self.lanes * self.ticks


@cache
def _case(law: str, lap_time: float) -> js.Case:
    case = js.build(f"{law}-circle", js.Timing(lap_time=lap_time, laps=1))
    if law != "sliding":
        return case
    # sgn amplifies every rounding: with tanh, two implementations can be compared
    loop = js.replace(case.loop, controller=per_axis(sliding(smooth)))
    gains = js.replace(case.gains, switch=SmoothWidth(width=jnp.full(2, 0.02)))
    return case._replace(loop=loop, gains=gains)


@cache
def _path(dtype: str, lap_time: float) -> Any:
    return make_path(circle(), uniform_parameter(lap_time, DT), dtype=dtype)


def _spread(random: np.random.Generator, value: Any, lanes: int, dtype: str) -> np.ndarray:
    value = np.asarray(value)
    return (value * random.uniform(0.9, 1.1, (lanes, *value.shape))).astype(dtype)


def work(
    law: str,
    dtype: str,
    lanes: int,
    ticks: int,
    full: bool = False,
    lap_time: float = 1.0,
    segment: int = 0,
) -> Work:
    """`lanes` runs with gains and plant within 10 % of the published ones, on one path, as a scan.

    full: all default metrics instead of the tracking error alone.
    """
    case = _case(law, lap_time)
    random = np.random.default_rng(lanes)
    names = ("slope", "rate", "credit") if law == "dfcmac" else ("slope", "disturbance_bound")
    same = jax.tree.map(
        lambda x: np.broadcast_to(np.asarray(x, dtype), (lanes, *x.shape)), case.gains
    )
    gains = js.replace(
        same, **{n: _spread(random, getattr(case.gains, n), lanes, dtype) for n in names}
    )
    own = jax.tree.map(lambda x: _spread(random, x, lanes, dtype), case.scenario.plant)
    plant = js.replace(own, static=np.maximum(own.static, own.coulomb))
    start = Start(offset=np.zeros(2, dtype), velocity=np.zeros(2, dtype))
    metric = case.metric if full else average
    loop = js.replace(case.loop, metric=metric, segment=segment, engine=js.scan)
    inputs = (gains, js.replace(case.scenario, plant=plant, start=start), _path(dtype, lap_time))
    gains, scenario, path = jax.tree.map(jnp.asarray, inputs)
    return Work(law, loop, gains, scenario, path, ticks, lanes)


def compiled(work: Work) -> Work:
    """The same runs, compiled."""
    return work._replace(loop=js.replace(work.loop, engine=js.compiled))


def parameter_rows(work: Work) -> np.ndarray:
    """The rows of numbers that the C++ kernel of the law reads, (2 x parameters, lanes)."""
    g, p = jax.tree.map(np.asarray, (work.gains, work.scenario.plant))
    gain = g.nominal.force_constant / g.nominal.mass
    if work.law == "dfcmac":
        ratio = g.receptive.spacing / g.receptive.width
        law = (
            g.slope,
            g.rate,
            g.credit,
            g.switching_gain,
            g.error_width,
            g.rate_width,
            ratio,
            gain,
        )
    else:
        reach = g.disturbance_bound + g.switching_gain
        drag, bias = g.nominal.damping / g.nominal.mass, g.nominal.load / g.nominal.mass
        law = (g.slope, reach, g.switch.width, gain, drag, bias)
    plant = (
        p.force_constant,
        p.mass,
        p.damping + p.viscous,
        p.coulomb,
        p.static,
        p.stribeck,
        p.load,
        p.backlash,
    )
    return np.concatenate([np.ascontiguousarray(x.T) for x in (*law, *plant)])


def path_rows(work: Work) -> np.ndarray:
    """Position, velocity and acceleration of every tick, (ticks, 6)."""
    s = work.path.setpoint
    lap = np.concatenate([np.asarray(x) for x in (s.position, s.velocity, s.acceleration)], axis=1)
    return np.ascontiguousarray(lap[np.arange(work.ticks) % len(lap)])
