"""What is simulated to judge the claims of the fuzzy-CMAC paper."""

import functools
from collections.abc import Callable

import jax.numpy as jnp
import numpy as np

from jaxstage.hardware.loads import CouplingLoad, SineLoad, all_loads, coupling_load, sine_load
from jaxstage.metrics import contour as contour_error
from jaxstage.metrics import effort, sliding_metrics, together, tracking, windowed
from jaxstage.model.fields import replace
from jaxstage.studies.case import Case, Timing, scored, with_metric
from jaxstage.studies.evidence import Evidence
from jaxstage.studies.experiment import (
    Experiment,
    measure,
    measure_windows,
    simulate_all,
)
from jaxstage.studies.fuzzy_cmac.loops import CONTOURS, SPREADS, build, law
from jaxstage.studies.machines import other_machine

#: the tables are judged at this control period: below it the metrics follow the continuous law
FINE = Timing(dt=2e-5)
#: the period of the published loops, whose metrics the robustness is compared with
USUAL = Timing()
#: machines drawn for the parameter uncertainty
DRAWS = 16
#: load in N at 5 Hz on each axis, as large as the published constant load (chosen)
LOAD_AMPLITUDE, LOAD_FREQUENCY = 0.1, 2 * np.pi * 5
#: force on an axis per velocity of the other: at the speed of the circle, 31 mm/s, the published
#: load of 0.1 N; of opposite sign in x and y, so that it does no work of its own (chosen)
COUPLING = 3.2
TABLE_LAWS = ("cmac", "dfcmac")
#: credits of the conventional CMAC: as published (equation (9)), as the fuzzy one, and of (22)
CREDITS = {"": 0.25, "-equal-rate": 0.4421, "-full-credit": 1.0}


def _laps(name: str, contour: str) -> Case:
    """One law at the fine period: both laps, and the halves of the second."""
    chosen = law(name)
    case = build(chosen, contour, FINE)
    assert chosen.surface is not None
    lap, sliding = case.window.lap, sliding_metrics(chosen.surface)
    both = together(tracking, contour_error)
    parts = (
        windowed(tracking, 0, lap, name="first lap"),
        windowed(both, lap, 2 * lap, name="second lap"),
        windowed(sliding, lap, lap + lap // 2, name="third half"),
        windowed(sliding, lap + lap // 2, 2 * lap, name="fourth half"),
    )
    return with_metric(case, together(*parts))


def tables() -> Evidence:
    """Every cell of Table 2, first and second lap."""
    cases = {f"{name}-{c}": _laps(name, c) for name in TABLE_LAWS for c in CONTOURS}
    return measure_windows(simulate_all(cases), cases)


def _light(case: Case) -> Case:
    """The case with the few metrics that claims are judged on: metrics cost most of a run."""
    return with_metric(case, scored(together(tracking, contour_error, effort()), case.window))


def _disturbed(case: Case, amplitude: float, coupling: float) -> Case:
    load = (
        SineLoad(
            amplitude=jnp.full(2, amplitude),
            frequency=jnp.full(2, LOAD_FREQUENCY),
            phase=jnp.array([0.0, np.pi / 2]),
            bias=jnp.zeros(2),
        ),
        CouplingLoad(coupling=jnp.array([[0.0, coupling], [-coupling, 0.0]])),
    )
    loop = replace(case.loop, load=all_loads(sine_load, coupling_load))
    return _light(case._replace(loop=loop, scenario=replace(case.scenario, load=load)))


def _uncertain(case: Case, seed: int) -> Case:
    return other_machine(case, SPREADS, seed)


def _disturbances(name: str) -> dict[str, Case]:
    """One law on all contours as published, and on the circle with its machine disturbed."""
    nominal = {c: _disturbed(build(law(name), c, USUAL), 0.0, 0.0) for c in CONTOURS}
    circle = nominal["circle"]
    cases = {f"{name}-{contour}": case for contour, case in nominal.items()}
    cases[f"{name}-circle/load"] = _disturbed(circle, LOAD_AMPLITUDE, 0.0)
    cases[f"{name}-circle/coupling"] = _disturbed(circle, 0.0, COUPLING)
    for seed in range(DRAWS):
        cases[f"{name}-circle/machine-{seed}"] = _uncertain(circle, seed)
    return cases


def robustness(name: str) -> Evidence:
    """One law on all contours as published, and on the circle with its machine disturbed."""
    return measure(_disturbances(name))


def conventional() -> Evidence:
    """The conventional CMAC as published, disturbed, and with other credits."""
    cases = _disturbances("cmac")
    for contour in CONTOURS:
        for suffix, credit in CREDITS.items():
            published = cases[f"cmac-{contour}"]
            gains = replace(published.gains, credit=jnp.full(2, credit))
            cases[f"cmac{suffix}-{contour}"] = published._replace(gains=gains)
    return measure(cases)


def published_only(name: str) -> Callable[[], Evidence]:
    """One law on all contours as published."""
    return lambda: measure({f"{name}-{c}": _light(build(law(name), c, USUAL)) for c in CONTOURS})


def machines(law: str) -> tuple[str, ...]:
    """The names of the cases of one law on every drawn machine."""
    return tuple(f"{law}-circle/machine-{seed}" for seed in range(DRAWS))


_DISTURBED = f"four contours, {DRAWS} other machines, load, cross-coupling"

experiments: tuple[Experiment, ...] = (
    Experiment(
        name="tables",
        text="CMAC and DFCMAC: four contours, control period 20 us",
        measure=tables,
    ),
    Experiment(name="cmac", text=f"CMAC: three learning rates, {_DISTURBED}", measure=conventional),
    Experiment(
        name="dfcmac", text=f"DFCMAC: {_DISTURBED}", measure=functools.partial(robustness, "dfcmac")
    ),
    Experiment(
        name="cascade",
        text=f"industrial cascade: {_DISTURBED}",
        measure=functools.partial(robustness, "cascade"),
    ),
    Experiment(
        name="sliding", text="ideal sliding mode: four contours", measure=published_only("sliding")
    ),
)
