"""What is simulated to judge the claims of the fuzzy cross-coupling paper."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxstage.controllers import disturbance_observer, fuzzy_pid_contour, pd, per_axis, plus
from jaxstage.metrics import (
    command_change,
    contour,
    contour_gains,
    effort,
    following,
    tangent_contour,
    together,
)
from jaxstage.model.blocks import Controller, Metric
from jaxstage.model.fields import replace
from jaxstage.model.settings import known_leaves, replaced
from jaxstage.model.signals import Sample
from jaxstage.numerics.smooth import exact
from jaxstage.studies.case import Case, Timing, scored, with_metric
from jaxstage.studies.evidence import Evidence
from jaxstage.studies.experiment import (
    Experiment,
    measure,
    metrics_of,
    simulate_all,
    stored,
)
from jaxstage.studies.fuzzy_ccc import values
from jaxstage.studies.fuzzy_ccc.loops import (
    SPREADS,
    TIMING,
    build,
    coupling,
    law,
    observing,
)
from jaxstage.studies.fuzzy_ccc.variants import (
    blind,
    coupled_to,
    of_adaptive,
    of_none,
    of_pid,
    scalar_forms,
)
from jaxstage.studies.law import StudyLaw
from jaxstage.studies.machines import other_machine

#: machines drawn for the parameter uncertainty
DRAWS = 16
#: switching gain without and with observer, m/s2 (chosen); 2.5 is above every |d|, 0.25 below
LARGE, SMALL = 2.5, 0.25
#: with the sign the metrics are judged at this period, from 1 s on
SWITCHED = replace(TIMING, dt=1e-3, skip=1.0)

LIGHT = together(following, contour)


def _light(case: Case, metric: Metric = LIGHT) -> Case:
    """The case with the few metrics that claims are judged on."""
    return with_metric(case, scored(metric, case.window))


def _matched(case: Case) -> Case:
    """All axes with the machine and the law of y, disturbed by the same accelerations as before."""
    gains, scenario = case.gains, case.scenario
    amplitude = scenario.load.amplitude * scenario.plant.mass[1] / scenario.plant.mass
    for path, (_, value) in known_leaves(gains, scenario).items():
        if path.startswith(("gains", "plant")) and jnp.shape(value) == (3,):
            gains, scenario = replaced(gains, scenario, path, jnp.full(3, value[1]))
    scenario = replace(scenario, load=replace(scenario.load, amplitude=amplitude))
    return case._replace(gains=gains, scenario=scenario)


def _machines(name: str, case: Case) -> dict[str, Case]:
    """Every axis alike, and other machines."""
    return {f"{name}/matched": _matched(case)} | {
        f"{name}/machine-{seed}": other_machine(case, SPREADS, seed) for seed in range(DRAWS)
    }


def couplings() -> Evidence:
    """The laws with and without cross-coupling, other numbers, other machines; the rules of the
    adaptive one before and after."""
    case = {name: build(law(name), name, TIMING) for name in ("none", "pid-ccc", "af-pid-ccc")}
    schedule = law("af-pid-ccc").schedule
    assert schedule is not None
    metric = together(following, contour, tangent_contour, contour_gains(schedule))
    adaptive = _light(case["af-pid-ccc"], metric)
    none, pid = _light(case["none"]), _light(case["pid-ccc"])
    cases = (
        {"af-pid-ccc": adaptive}
        | of_adaptive(adaptive)
        | _machines("af-pid-ccc", adaptive)
        | {"none": none, "none/matched": _matched(none)}
        | of_none(none)
        | {name: _light(one) for name, one in scalar_forms().items()}
    )
    runs = simulate_all(cases)
    evidence = {name: metrics_of(cases[name], run, run.report) for name, run in runs.items()}
    learned = runs["af-pid-ccc"].final.memory.extra.learned
    evidence["af-pid-ccc/rules"] = {"before": adaptive.gains.extra.rules, "after": learned}
    means = {
        f"{name}_gain": jnp.asarray(evidence["af-pid-ccc"][f"contour_{name}_mean_1_per_{unit}"])
        for name, unit in (("proportional", "s2"), ("integral", "s3"), ("derivative", "s"))
    }
    return evidence | measure(
        {"pid-ccc": pid, "pid-ccc/mean-gains": coupled_to(pid, **means)}
        | of_pid(pid)
        | _machines("pid-ccc", pid)
    )


def axis_laws() -> Evidence:
    """The PD law without observer, and with the one of the sliding mode."""
    watched = StudyLaw(
        "pd-observed",
        "PD with observer",
        plus(per_axis(pd), per_axis(disturbance_observer)),
        lambda axis: values.observed(values.pd_gains(axis), axis),
    )
    return measure({one.name: _light(build(one, one.name, TIMING)) for one in (law("pd"), watched)})


def switched(name: str, contour_law: Controller | None, gains: Any, timing: Timing) -> Case:
    """A law whose axes switch by the sign in place of a boundary layer, however far it strays."""
    controller = coupling(contour_law, exact) if contour_law else observing(exact)
    case = build(StudyLaw(name, "", controller, lambda axis: gains), name, timing)
    return case._replace(loop=replace(case.loop, path_limit=np.inf))


def sign_gains(eta: float, observer: bool = True) -> Any:
    """Gains of sliding mode with the sign, and observer; without it its gain is next to 0."""
    axis = values.nominal()
    gains = values.observed(values.sliding_gains(axis, eta, switch=()), axis)
    return gains if observer else blind(gains)


def _signals(sample: Sample) -> dict[str, Array]:
    return {
        "time_s": sample.time,
        "command_A": sample.command,
        "load_N": sample.load,
        "estimate_m_per_s2": sample.memory.extra.estimate.disturbance,
    }


#: what the plots of switching show, of every tick
SIGNALS = stored("signals", _signals)

#: the sliding modes of the observer's part of the paper: switching gain, with observer or not
SIGNS = {
    "large gain, no observer": (LARGE, False),
    "small gain, observer": (SMALL, True),
    "small gain, no observer": (SMALL, False),
}


def switching() -> Evidence:
    """The sign with and without observer, and under cross-coupling."""
    metric = together(following, effort(), command_change, SIGNALS)
    cases = {
        name: _light(switched(name, None, sign_gains(*how), SWITCHED), metric)
        for name, how in SIGNS.items()
    }
    runs = simulate_all(cases)
    evidence: dict[str, Any] = {}
    for name, run in runs.items():
        evidence[name] = metrics_of(cases[name], run, run.report)
        evidence[f"{name}/signals"] = jax.tree.map(np.asarray, run.rows["signals"])
    whole = replace(SWITCHED, skip=None)
    axis, watched = values.nominal(), sign_gains(SMALL)
    coupled = values.coupled(watched, values.fuzzy_gains(), axis)
    return evidence | measure(
        {
            "sign, none": _light(switched("none", None, watched, whole)),
            "sign, af-pid-ccc": _light(switched("af", fuzzy_pid_contour(), coupled, whole)),
        }
    )


def estimate_error(evidence: Evidence) -> list[float]:
    """Largest |d - d^| over the amplitude of d, per axis, from 1 s on, small gain."""
    signals = evidence["small gain, observer/signals"]
    late = signals["time_s"] >= 1.0
    mass = np.asarray(values.plant().mass)
    true = signals["load_N"][late] / mass
    error = np.abs(true - signals["estimate_m_per_s2"][late]).max(axis=0)
    return (error * mass / np.asarray(values.load().amplitude)).tolist()


experiments: tuple[Experiment, ...] = (
    Experiment(
        name="coupling",
        text=f"with and without cross-coupling, other numbers, {DRAWS} other machines",
        measure=couplings,
    ),
    Experiment(name="pd", text="PD with and without the observer", measure=axis_laws),
    Experiment(
        name="switching",
        text="switching by the sign, with and without observer",
        measure=switching,
    ),
)
