"""The same work in jaxstage, as a user writes it."""

from collections.abc import Callable
from typing import Any

import jax

import jaxstage as js
from jaxstage.simulate.batch import rollouts

from .cases import SHARED_PATH, Work


def batched(work: Work, tile: int, devices: int) -> Callable[[], Any]:
    """`rollouts`: lanes last, in tiles, on one or more devices. Gives the report."""

    def program() -> Any:
        return rollouts(
            work.loop,
            work.gains,
            work.scenario,
            work.path,
            work.ticks,
            in_axes=SHARED_PATH,
            tile=tile,
            devices=devices,
        ).report

    return program


def vmapped(work: Work) -> Callable[[], Any]:
    """``jax.jit(jax.vmap(simulate))``. Gives the report."""

    @jax.jit
    def every(gains: Any, plant: Any, scenario: Any, path: Any) -> Any:
        def one(gains: Any, plant: Any) -> Any:
            own = js.replace(scenario, plant=plant)
            return js.simulate(work.loop, gains, own, path, work.ticks).report

        return jax.vmap(one)(gains, plant)

    return lambda: every(work.gains, work.scenario.plant, work.scenario, work.path)


def tracking_error(report: Any) -> Any:
    """ATE of every run in m, from a report of all metrics or of `average`."""
    return report["tracking"].ate if isinstance(report, dict) else report
