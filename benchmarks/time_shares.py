"""Where the time of the portable engine goes: the same batch with one part left out at a time."""

from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax

import jaxstage as js
from jaxstage.model.signals import Nearest
from jaxstage.simulate.rollout import start
from jaxstage.simulate.tick import tick

from .cases import Work, work
from .jax_runs import vmapped
from .timing import Times


def _commanded(path: Any, step: Any, position: Any) -> Nearest:
    """No search: what costs nothing."""
    zero = jnp.zeros_like(position[0])
    return Nearest(point=position, distance=zero, arc=zero, reach=zero)


def _without_nearest(work: Work) -> Work:
    reference = js.replace(work.loop.reference, nearest=_commanded)
    return work._replace(loop=js.replace(work.loop, reference=reference))


def unguarded(work: Work) -> Callable[[], Any]:
    """The scan over ticks without the guards of `advance` (path limit, finite values, freeze)."""
    loop = work.loop

    @jax.jit
    def every(gains: Any, plant: Any, scenario: Any, path: Any) -> Any:
        def one(gains: Any, plant: Any) -> Any:
            own = js.replace(scenario, plant=plant)
            carry = start(loop, gains, own, path)
            step = lambda c, _: tick(loop, gains, own, path, c)  # noqa: E731
            return loop.metric.finish(lax.scan(step, carry, None, length=work.ticks)[0].metric)

        return jax.vmap(one)(gains, plant)

    return lambda: every(work.gains, work.scenario.plant, work.scenario, work.path)


def programs(dtype: str, lanes: int, ticks: int) -> dict[str, Callable[[], Any]]:
    """From everything to next to nothing."""
    full = work("dfcmac", dtype, lanes, ticks, full=True)
    lean = work("dfcmac", dtype, lanes, ticks)
    light = work("sliding", dtype, lanes, ticks)
    return {
        "all": vmapped(full),
        "all, no guards": unguarded(full),
        "all, no nearest": vmapped(_without_nearest(full)),
        "ATE": vmapped(lean),
        "ATE, no guards": unguarded(lean),
        "sliding": vmapped(light),
        "sliding, no guards": unguarded(light),
    }


def shares(times: Mapping[str, Times]) -> dict[str, float]:
    """Processor seconds of each part, as differences."""
    t = {name: value.cpu for name, value in times.items()}
    return {
        "nearest point": t["all"] - t["all, no nearest"],
        "other metrics": t["all, no nearest"] - t["ATE"],
        "guards, all metrics": t["all"] - t["all, no guards"],
        "guards, ATE only": t["ATE"] - t["ATE, no guards"],
        "CMAC beyond sliding": t["ATE, no guards"] - t["sliding, no guards"],
        "sliding law and plant": t["sliding, no guards"],
    }
