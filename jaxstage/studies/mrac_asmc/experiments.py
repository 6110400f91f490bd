"""What is simulated to judge the claims of the MRAC / ASMC paper."""

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxstage.controllers import position_input
from jaxstage.model.fields import replace
from jaxstage.numerics.smooth import Layer, implicit
from jaxstage.studies.case import Case
from jaxstage.studies.evidence import Evidence
from jaxstage.studies.experiment import Experiment, simulate_all
from jaxstage.studies.mrac_asmc import values
from jaxstage.studies.mrac_asmc.contouring import circles
from jaxstage.studies.mrac_asmc.loops import TIMING, version
from jaxstage.studies.mrac_asmc.traces import (
    CASCADE,
    adaptive_law,
    gains_of,
    run_metrics,
    stepped,
    switched_law,
    traced,
    window_metrics,
)

IDEAL, ROUGH = version(""), version("-r")
MOTOR, ROUGH_MOTOR = version("-motor"), version("-r-motor")
#: run times of Figure 14, in s
RUN_TIMES = (1.0, 2.0, 8.0)
#: switching gains in rad/s2 of the sweep, widths of the implicit switch (both chosen), and
#: switching gains that the printed step times imply
GAINS = (250, 500, 1000, 1500, 2000, 3000)
LAYERS = (1, 4, 8)
STEP_GAINS = (1087, 1500, 2778, 5000)
STEP_HEIGHT, STEP_DURATION, STEP_STEADY = 0.5e-3, 0.7, 0.6
#: starts in m beside the path: runs that switch are chaotic, and are judged by their mean (chosen)
STARTS = (0.0, 1e-7, 2e-7, 3e-7)
#: a step has arrived when this share of it is covered (chosen)
ARRIVED = 0.99


def several_starts(cases: Mapping[str, Case]) -> dict[str, Case]:
    """Each case from all `STARTS`: the first under its own name, the others as ``case/start1``."""
    every = dict(cases)
    for number, offset in enumerate(STARTS[1:], 1):
        for name, case in cases.items():
            start = replace(case.scenario.start, offset=jnp.full(1, offset))
            moved = case._replace(scenario=replace(case.scenario, start=start))
            every[f"{name}/start{number}"] = moved
    return every


def ideal_adaptive() -> tuple[dict[str, Case], dict[str, float]]:
    """The adaptive law on the ideal drive, and the cases with other run times."""
    law, asmc, caps = adaptive_law(), values.asmc(), values.asmc(True)
    ahead = values.FEEDFORWARD
    gains = {
        "sim1": gains_of(values.sim1()),
        "sim1-ahead": gains_of(values.sim1(), feedforward=ahead),
        "sim2": gains_of(values.sim2()),
        "asmc-mrac": gains_of(asmc, True),
        "asmc-mrac-caps": gains_of(caps, True),
        "asmc-mrac-caps-ahead": gains_of(caps, True, ahead),
        "asmc-caps": gains_of(caps),
        "sigmoid-mrac": gains_of(values.sigmoid(), True),
        "sigmoid-mrac-soft": gains_of(values.sigmoid(25), True),
    }
    cases = {name: traced(law, g, IDEAL) for name, g in gains.items()}
    periods = {f"{name}/{t:g}s": t for name in ("asmc-mrac-caps", "asmc-caps") for t in RUN_TIMES}
    cases |= {
        name: traced(law, gains[name.partition("/")[0]], IDEAL, time)
        for name, time in periods.items()
    }
    return cases, periods


def ideal_implicit() -> dict[str, Case]:
    """The implicit switch of one layer in the place of the sigmoid of ``sigmoid-mrac``."""
    fixed = values.sigmoid()
    law = replace(
        values.sliding_mode(0, Layer(layer=values.value(1))),
        slope=fixed.slope,
        switching_gain=fixed.switching_gain,
    )
    return {"implicit-mrac": traced(switched_law(implicit), gains_of(law, True), IDEAL)}


def ideal_cascade() -> tuple[dict[str, Case], dict[str, float]]:
    """The cascade on the ideal drive, with and without feed-forward, and other run times."""
    plain = values.cascade_gains()
    cases = {
        "cascade": traced(CASCADE, values.ahead(plain, 0.0), IDEAL),
        "cascade-ahead": traced(CASCADE, values.ahead(plain), IDEAL),
    }
    periods = {f"cascade/{time:g}s": time for time in RUN_TIMES}
    cases |= {
        name: traced(CASCADE, values.ahead(plain, 0.0), IDEAL, time)
        for name, time in periods.items()
    }
    return cases, periods


def printed_sign() -> dict[str, Case]:
    """The first simulation with the sign of (16) and (17) as printed."""
    return {"sim1-printed": traced(adaptive_law(position_input), gains_of(values.sim1()), IDEAL)}


def rough_adaptive() -> tuple[dict[str, Case], dict[str, float]]:
    """The adaptive law in scenario R, with the printed damping and a hundredth of it."""
    law, caps = adaptive_law(), values.asmc(True)
    ahead = values.FEEDFORWARD
    gains = {
        "asmc-mrac-caps-r": gains_of(caps, True),
        "asmc-caps-r": gains_of(caps),
        "sigmoid-r": gains_of(values.sigmoid()),
        "asmc-mrac-r": gains_of(values.asmc(), True),
        "asmc-mrac-caps-ahead-r": gains_of(caps, True, ahead),
        "sigmoid-mrac-r": gains_of(values.sigmoid(), True),
    }
    cases = {name: traced(law, g, ROUGH) for name, g in gains.items()}
    judged = {name: cases[name] for name in gains if name != "asmc-mrac-r"}
    for name in ("asmc-mrac-caps-r", "asmc-caps-r"):
        soft = judged[name]._replace(scenario=values.softer(judged[name].scenario))
        judged[f"{name.removesuffix('-r')}-soft-r"] = soft
    cases |= several_starts(judged)
    periods = {f"asmc-mrac-caps-r/{time:g}s": time for time in RUN_TIMES}
    cases |= {
        name: traced(law, gains["asmc-mrac-caps-r"], ROUGH, time) for name, time in periods.items()
    }
    return cases, periods


def rough_switched() -> dict[str, Case]:
    """Sliding mode in scenario R: with and without MRAC, and over its switching gain."""
    law = switched_law()
    cases = {
        f"smc{gain}-r": traced(law, gains_of(values.sliding_mode(gain)), ROUGH) for gain in GAINS
    }
    for gain in (500, 1500):
        with_mrac = gains_of(values.sliding_mode(gain), True)
        cases[f"smc{gain}-mrac-r"] = traced(law, with_mrac, ROUGH)
    judged = ("smc500-r", "smc1500-r", "smc500-mrac-r")
    return cases | several_starts({name: cases[name] for name in judged})


def rough_implicit() -> dict[str, Case]:
    """Sliding mode with implicit switching in scenario R, over the width of its layer."""
    law = switched_law(implicit)
    gains = {
        f"smc1500-layer{width}-r": values.sliding_mode(1500, Layer(layer=values.value(width)))
        for width in LAYERS
    }
    return {name: traced(law, gains_of(g), ROUGH) for name, g in gains.items()}


def rough_cascade() -> dict[str, Case]:
    """The cascade in scenario R."""
    gains = values.ahead(values.cascade_gains(), 0.0)
    return several_starts({"cascade-r": traced(CASCADE, gains, ROUGH)})


def motor_switched() -> dict[str, Case]:
    """Sliding mode in scenario R with the friction on the motor."""
    law, slow = switched_law(), values.sliding_mode(500)
    return several_starts(
        {
            "smc1500-r-motor": traced(law, gains_of(values.sliding_mode(1500)), ROUGH_MOTOR),
            "smc500-r-motor": traced(law, gains_of(slow), ROUGH_MOTOR),
            "smc500-mrac-r-motor": traced(law, gains_of(slow, True), ROUGH_MOTOR),
        }
    )


def motor_adaptive() -> dict[str, Case]:
    """The adaptive law in scenario R with the friction on the motor."""
    gains = gains_of(values.asmc(True), True)
    case = traced(adaptive_law(), gains, ROUGH_MOTOR)
    return several_starts({"asmc-mrac-caps-r-motor": case})


def steps() -> Evidence:
    """The step of Figures 10 and 11 in scenario R: time of arrival, and the steady error."""
    law = switched_law()
    cases = {
        f"step{gain}": stepped(
            law, gains_of(values.sliding_mode(gain)), ROUGH, STEP_HEIGHT, STEP_DURATION
        )
        for gain in STEP_GAINS
    }
    evidence: dict[str, Any] = {}
    for name, run in simulate_all(cases).items():
        rows = {key: np.asarray(row)[:, 0] for key, row in run.rows.items()}
        error, steady = rows["error"] * 1e6, round(STEP_STEADY / TIMING.dt)
        short = np.abs(error) <= (1 - ARRIVED) * STEP_HEIGHT * 1e6
        measured = window_metrics(error[steady:], rows["command"][steady:])
        measured |= {"arrived_s": int(short.argmax()) * TIMING.dt if short.any() else None}
        evidence[name] = measured | {"trace": {"error_um": error, "command_Nm": rows["command"]}}
    return evidence


def _experiment(name: str, text: str, cases: Any) -> Experiment:
    """cases(): the cases, or the cases and the run times of some of them."""

    def measure() -> Evidence:
        built = cases()
        every, periods = built if isinstance(built, tuple) else (built, {})
        return run_metrics(every, periods)

    return Experiment(name=name, text=text, measure=measure)


experiments: tuple[Experiment, ...] = (
    _experiment("ideal-adaptive", "adaptive sliding mode, ideal measurement", ideal_adaptive),
    _experiment("ideal-cascade", "PID with rate feed-forward, ideal measurement", ideal_cascade),
    _experiment("ideal-implicit", "implicit switching, ideal measurement", ideal_implicit),
    _experiment("printed-sign", "adaptive laws with the printed sign", printed_sign),
    _experiment("rough-switched", "sliding mode, scenario R", rough_switched),
    _experiment("rough-implicit", "implicit switching, scenario R", rough_implicit),
    _experiment("rough-adaptive", "adaptive sliding mode, scenario R", rough_adaptive),
    _experiment("rough-cascade", "PID with rate feed-forward, scenario R", rough_cascade),
    _experiment("motor-switched", "sliding mode, friction on the motor", motor_switched),
    _experiment("motor-adaptive", "adaptive sliding mode, friction on the motor", motor_adaptive),
    Experiment(name="steps", text="steps of 0.5 mm", measure=steps),
    Experiment(name="xy", text="circle of two axes, ideal measurement", measure=circles),
)
