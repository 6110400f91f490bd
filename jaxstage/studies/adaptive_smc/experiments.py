"""What is simulated to judge the claims of the adaptive sliding-mode paper."""

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxstage.controllers import nonlinear_surface, per_axis
from jaxstage.controllers.parts import damping, error_rate, reaching
from jaxstage.controllers.parts.damping import FinalDamping
from jaxstage.controllers.parts.reaching import FixedGain
from jaxstage.hardware.drives import CurrentDrive, current_drive
from jaxstage.hardware.loads import no_load
from jaxstage.hardware.sensors import Encoder, Noisy, encoder, noisy
from jaxstage.metrics import (
    columns,
    contour,
    effort,
    energy,
    following,
    reaching_gain,
    together,
    variance_above,
    windowed,
)
from jaxstage.metrics.spectrum import HighFrequency
from jaxstage.metrics.tracking import following_error
from jaxstage.model.blocks import Loop, Metric
from jaxstage.model.fields import replace
from jaxstage.model.signals import Sample
from jaxstage.numerics.integrate import rk4
from jaxstage.plants import screw_table
from jaxstage.references import trifolium
from jaxstage.simulate.stability import spectral_radius, stability_limit, transition
from jaxstage.studies.adaptive_smc import values
from jaxstage.studies.adaptive_smc.loops import (
    CUTOFF,
    MATCHED,
    PATH_LIMIT,
    PRINTED,
    STIFF,
    TIMING,
    WIDE,
    ReachingLaw,
    Scene,
    build,
    gain_of,
    law,
    scene,
)
from jaxstage.studies.case import Case, with_metric
from jaxstage.studies.evidence import Evidence
from jaxstage.studies.experiment import Experiment, measure_windows, simulate_all, stored

#: slopes tried for the accuracy of ASMC, 1/s
SLOPES = {"s1": np.arange(40.0, 81.0, 5.0), "s7": np.arange(60.0, 121.0, 10.0)}
#: linear surfaces beside the nonlinear one: its slope at rest and at the commanded speed, 1/s
LINEAR = (40.0, 58.0)
#: trials of one experiment, and the noise of its position in m (chosen: one count)
TRIALS, NOISE = 5, values.RESOLUTION
#: machines drawn at random, each for one time round
MACHINES, ROUND = 48, replace(TIMING, duration=10.0)
#: the rows of the study's table: laws by scenario
ROWS = {
    "s0": ("smc",),
    "s1": ("smc", "smc-star", "smc-star-star", "asmc"),
    "s2": ("smc", "asmc"),
    "s3": ("smc", "asmc"),
    "s4": ("smc",),
    "s5": ("smc",),
    "s6": ("smc",),
    "s7": ("smc", "smc-star", "asmc"),
}


def _traced(sample: Sample) -> dict[str, Array]:
    return {
        "error": following_error(sample),
        "command": sample.command,
        "gain": gain_of(sample.memory),
    }


#: stores error, command and gain of every tick, each (ticks, axes)
trace = stored("trace", _traced)


def light(case: Case, *more: Metric) -> Case:
    """The case with the metrics that claims use: from 1 s on ("late") and of the whole run."""
    start, stop = case.window.start, case.window.stop
    late = together(following, contour, effort(CUTOFF), reaching_gain(gain_of))
    return with_metric(
        case,
        together(
            windowed(late, start, stop, name="late"),
            windowed(together(following, energy), 0, stop, name="whole"),
            *more,
        ),
    )


def evidence_of(cases: Mapping[str, Case], shown: tuple[str, ...] = ()) -> dict[str, Any]:
    """Metrics of both windows as ``case/late`` and ``case/whole``; for the cases in ``shown`` the
    stored signals too, as ``case/trace``."""
    runs = simulate_all(cases)
    evidence = measure_windows(runs, cases)
    for name, run in runs.items():
        if run.rows is None:
            continue
        case = cases[name]
        evidence[f"{name}/late"] |= _fast(case, run.rows["trace"]["command"])
        if name in shown:
            signals = {k: np.asarray(v) for k, v in run.rows["trace"].items()}
            time = np.arange(case.window.ticks) * case.loop.dt
            evidence[f"{name}/trace"] = signals | {"time": time}
    return evidence


def _fast(case: Case, command: Array) -> dict[str, Any]:
    """The metric of `high_frequency`, from the stored command: cheaper for many runs."""
    late = command[case.window.start : case.window.stop]
    above = HighFrequency(command_high_variance=variance_above(late, case.loop.dt, CUTOFF))
    return columns(above, case.loop.plant)


def rows() -> dict[str, Case]:
    """Every row of the study's table, by the name of its loop; fixed gains in the form of adaptive
    ones with kbar = 0, which is the same and shares their compiled program."""
    pairs = [(law(name), scene(s)) for s, names in ROWS.items() for name in names]
    pairs += [(law("smc"), MATCHED), (STIFF, scene("s1")), (STIFF, scene("s4"))]
    pairs += [(law("asmc"), WIDE), (law("smc"), PRINTED)]
    return {f"{a.name}-{b.name}": build(_shared(a), b, TIMING) for a, b in pairs}


def _shared(law: ReachingLaw) -> ReachingLaw:
    if law.form is not reaching.fixed:
        return law
    return law._replace(
        form=reaching.adaptive, gains=lambda scene: values.steady_gain(law.gains(scene).start)
    )


def _with_slope(case: Case, slope: float, damping_slope: float | None = None) -> Case:
    gains = replace(case.gains, slope=jnp.full(2, slope))
    if damping_slope is not None:
        gains = replace(gains, damping_slope=jnp.full(2, damping_slope))
    return case._replace(gains=gains)


def table() -> Evidence:
    """The rows; SMC with other slopes and with linear surfaces; psi as printed; rho in SI."""
    cases = rows()
    smc = {s: cases[f"smc-{s}"] for s in ("s0", "s1", "s7")}
    for name, slopes in SLOPES.items():
        cases |= {f"smc-{name}/slope-{v:g}": _with_slope(smc[name], v) for v in slopes}
    for v in LINEAR:
        for name, case in smc.items():
            cases[f"smc-{name}/linear-{v:g}"] = _with_slope(case, v, 0.0)
    integral = cases["smc-star-star-s1"]
    literal = replace(integral.gains, reaching=values.integral_gain(rate=0.8))
    cases["smc-star-star-s1/literal"] = integral._replace(gains=literal)
    rubbing = replace(smc["s1"].scenario, plant=values.plain_friction())
    cases["smc-s1/coulomb"] = smc["s1"]._replace(scenario=rubbing)
    cases["smc-s1/psi-printed"] = _with_psi_as_printed(smc["s1"])
    shown = ("smc-s1", "asmc-s1", "smc-star-star-s1", "asmc-s7")
    return evidence_of({name: light(case, trace) for name, case in cases.items()}, shown)


def _with_psi_as_printed(case: Case) -> Case:
    gains = replace(case.gains, damping=FinalDamping(final=jnp.full(2, 10.0)))
    controller = per_axis(nonlinear_surface(damping.raw, reaching.adaptive))
    return case._replace(gains=gains, loop=replace(case.loop, controller=controller))


#: the two regimes of the experiment: as published, and the one in which switching dominates
REGIMES = ("s3", "s7")


def _trial(law: ReachingLaw, regime: str, seed: int) -> Case:
    """A run with the encoder of the paper and noise."""
    seen = Noisy(
        noise=jnp.asarray(NOISE),
        sensor=Encoder(resolution=jnp.asarray(values.RESOLUTION), bandwidth=jnp.asarray(np.inf)),
    )
    where: Scene = scene(regime)._replace(
        sensor=noisy(encoder), encoder=lambda: seen, error_rate=error_rate.differenced
    )
    case = build(law, where, TIMING)
    return case._replace(scenario=replace(case.scenario, key=jax.random.key(seed)))


def trials() -> Evidence:
    """SMC, ASMC and SMC* with noise, five seeds each, in both regimes."""
    cases = {
        f"{name}-{regime}/trial-{seed}": light(_trial(_shared(law(name)), regime, seed), trace)
        for name in ("smc", "asmc", "smc-star")
        for regime in REGIMES
        for seed in range(TRIALS)
    }
    return evidence_of(cases, tuple(name for name in cases if name.endswith("trial-0")))


def over_trials(evidence: Evidence, name: str, window: str, metric: str) -> list[Any]:
    """A metric of every trial of ``name`` (law and regime, e.g. ``smc-s3``)."""
    return [evidence[f"{name}/trial-{seed}/{window}"][metric] for seed in range(TRIALS)]


def _machine(draw: np.random.Generator, case: Case) -> tuple[Case, float, float]:
    """A case with another machine and switching gain; kbar and eps to go with it."""

    def between(low: float, high: float) -> float:
        return float(np.exp(draw.uniform(np.log(low), np.log(high))))

    plant, gains = case.scenario.plant, case.gains
    dry = jnp.asarray(values.inertia() * between(3e-4, 3e-3))
    friction = replace(plant.friction, coulomb=dry, static=dry * between(1.0, 36.0))
    mass = gains.nominal.mass * draw.uniform(0.7, 1.0)
    q = between(1e-4, 0.03)
    gains = replace(gains, switching_gain=jnp.full(2, q), nominal=replace(gains.nominal, mass=mass))
    scenario = replace(case.scenario, plant=replace(plant, friction=friction))
    return case._replace(gains=gains, scenario=scenario), between(1e5, 1e6), between(5e-6, 1e-3)


def machines() -> Evidence:
    """SMC, ASMC and SMC* on machines drawn at random; SMC is ASMC with kbar = 0."""
    base = light(build(law("asmc"), scene("s1"), ROUND))
    draw = np.random.default_rng(0)
    cases = {}
    for number in range(MACHINES):
        case, rate, dead_zone = _machine(draw, base)
        fixed = replace(case.gains, reaching=values.steady_gain())
        adapts = replace(case.gains, reaching=values.adaptive_gain(rate, dead_zone))
        cases[f"machine-{number}/asmc"] = case._replace(gains=adapts)
        cases[f"machine-{number}/smc"] = case._replace(gains=fixed)
        cases[f"machine-{number}/smc-star"] = _with_slope(case._replace(gains=fixed), 80.0)
    return evidence_of(cases)


def limits() -> Evidence:
    """Largest stable K with differenced velocity, without and with one period of dead time."""
    loop = Loop(
        plant=screw_table(),
        controller=per_axis(nonlinear_surface(damping.constant)),
        reference=trifolium(values.DT),
        load=no_load,
        sensor=encoder,
        drive=current_drive(1),
        metric=following,
        dt=values.DT,
        path_limit=PATH_LIMIT,
    )
    exact_encoder = Encoder(resolution=jnp.zeros(()), bandwidth=jnp.asarray(np.inf))
    scenario = values.scenario(values.frictionless(), exact_encoder)
    gains = values.gains(values.fixed_gain(), q=0.0)
    gains = replace(gains, damping=FinalDamping(final=jnp.full(2, 10.0)))

    def phi(gain: Array, delay: Array) -> Array:
        drive = CurrentDrive(limit=jnp.full(2, jnp.inf), delay=delay, lag=jnp.zeros(()))
        same = replace(gains, reaching=FixedGain(start=gain))
        return transition(loop, same, replace(scenario, drive=drive), values.path())

    each = jax.jit(jax.vmap(phi, (0, None)))

    def limit(delay: float) -> float:
        return stability_limit(
            lambda gain: spectral_radius(each(np.stack([gain, gain], axis=1), delay)),
            1.0,
            1000.0,
            1e-7,
        )

    return {"limits": {"difference_1_per_s": limit(0.0), "difference_delay_1_per_s": limit(1.0)}}


#: damping ratios of Figure 1 (chosen; none is printed)
LOW, HIGH = 0.2, 1.5


def step_response() -> Evidence:
    """Figure 1: x'' + 2 zeta x' + x = 1 from rest, zeta low, high, and rising from one to the other
    with psi / beta, where psi takes the share of the way made in place of the velocity ratio."""
    params = FinalDamping(final=jnp.ones(()))

    def slope(state: Any, fraction: float) -> Any:
        x, v = state
        psi = np.asarray(damping.raw.apply(params, jnp.ones(()), jnp.asarray(x[2])))
        zeta = np.array([LOW, HIGH, LOW + (HIGH - LOW) * psi])
        return np.stack([v, 1 - x - 2 * zeta * v])

    state, step, way = np.zeros((2, 3)), 0.02, [np.zeros(3)]
    for _ in range(1000):
        state = rk4(slope, state, step)
        way.append(state[0])
    x = np.array(way)
    time = np.arange(len(x)) * step
    names = ("low", "high", "nonlinear")
    evidence: dict[str, Any] = {"step/trace": dict(zip(names, x.T, strict=True)) | {"time": time}}
    for name, response in zip(names, x.T, strict=True):
        evidence[f"step/{name}"] = {
            "overshoot": float(max(response.max() - 1, 0)),
            "rise_s": float(time[np.argmax(response >= 0.9)]),
        }
    return evidence


experiments: tuple[Experiment, ...] = (
    Experiment(
        name="step", text="step response at low, high and nonlinear damping", measure=step_response
    ),
    Experiment(
        name="table",
        measure=table,
        text="SMC, SMC*, SMC** and ASMC in eight scenarios, other slopes, linear surfaces",
    ),
    Experiment(
        name="trials",
        measure=trials,
        text=f"SMC, ASMC and SMC* with noise, {TRIALS} trials in two regimes",
    ),
    Experiment(
        name="machines",
        measure=machines,
        text=f"SMC, ASMC and SMC* on {MACHINES} machines drawn at random",
    ),
    Experiment(name="limits", text="stability limits of the sampled loop", measure=limits),
)
