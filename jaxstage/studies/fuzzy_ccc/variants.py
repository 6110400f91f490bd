"""The study's laws with other numbers: what the experiments run beside the laws themselves."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxstage.controllers import fuzzy_pid_contour, pid_contour, scalar
from jaxstage.controllers.parts.contour_error import Rounding
from jaxstage.model.fields import replace
from jaxstage.studies.case import Case
from jaxstage.studies.fuzzy_ccc import values
from jaxstage.studies.fuzzy_ccc.loops import TIMING, build, coupling, coupling_gains, law
from jaxstage.studies.law import StudyLaw

#: learning rates tried, as multiples of the study's
RATES = (0.25, 0.5, 2.0, 4.0, 8.0)
#: rate in 1/s at which rules return to those of the start
LEAK = 0.2
#: larger constant K_P tried, 1/s2
PROPORTIONAL = (1500.0, 2000.0, 4000.0)
#: mass assumed by the laws over the true one
MASS_ERROR = (1.2, 0.9, 1.1)
#: switching gain of a boundary layer without observer, m/s2; above every |d|
BLIND_GAIN = 2.5


def coupled_to(case: Case, **changes: Any) -> Case:
    """The case with other gains of its contour law."""
    return case._replace(gains=replace(case.gains, extra=replace(case.gains.extra, **changes)))


def learning(case: Case, factor: float, leak: float = 0.0) -> Case:
    """The adaptive case with other learning rates."""
    a = case.gains.extra.adaptation
    rates = ("proportional_rate", "integral_rate", "derivative_rate")
    changes = {name: factor * getattr(a, name) for name in rates}
    return coupled_to(case, adaptation=replace(a, leak=jnp.asarray(leak), **changes))


def blind(observed: Any) -> Any:
    """Gains of a law whose observer is next to 0."""
    extra = replace(observed.extra, disturbance_gain=np.full(3, 1e-30))
    return replace(observed, extra=extra)


def _arrays(gains: Any) -> Any:
    return jax.tree.map(jnp.asarray, gains)


def of_any(name: str, case: Case) -> dict[str, Case]:
    """Laws that assume other masses; a start at rest on the path. name: of a law."""
    axis = values.nominal(np.array(MASS_ERROR))
    start = replace(case.scenario.start, offset=jnp.zeros(3), velocity=jnp.zeros(3))
    return {
        f"{name}/mass": case._replace(gains=_arrays(law(name).gains(axis))),
        f"{name}/rest": case._replace(scenario=replace(case.scenario, start=start)),
    }


def of_none(case: Case) -> dict[str, Case]:
    """A boundary layer with a large gain in place of the observer."""
    axis = values.nominal()
    gains = blind(values.observed(values.sliding_gains(axis, BLIND_GAIN), axis))
    return {"none/blind": case._replace(gains=_arrays(gains))} | of_any("none", case)


def of_pid(case: Case) -> dict[str, Case]:
    """Constant contour gains of other sizes."""
    return (
        {"pid-ccc/no-integral": coupled_to(case, integral_gain=jnp.zeros(()))}
        | {
            f"pid-ccc/K_P-{gain:g}": coupled_to(case, proportional_gain=jnp.asarray(gain))
            for gain in PROPORTIONAL
        }
        | of_any("pid-ccc", case)
    )


def of_adaptive(case: Case) -> dict[str, Case]:
    """Other learning rates, none, and a leak."""
    return (
        {"fuzzy-frozen": learning(case, 0.0), "af-pid-ccc/leak": learning(case, 1.0, LEAK)}
        | {f"af-pid-ccc/rates-{factor:g}": learning(case, factor) for factor in RATES}
        | of_any("af-pid-ccc", case)
    )


def scalar_forms() -> dict[str, Case]:
    """Both contour laws on the magnitude of the contour error and its integral."""
    forms = {
        "pid-ccc": (pid_contour(scalar), values.pid_gains()),
        "af-pid-ccc": (fuzzy_pid_contour(scalar), values.fuzzy_gains()),
    }
    rounding = Rounding(rounding=values.fuzzy_gains().rounding)
    laws = [
        StudyLaw(
            f"{name}/scalar",
            "",
            coupling(contour),
            partial(coupling_gains, replace(gains, form=rounding)),
        )
        for name, (contour, gains) in forms.items()
    ]
    return {one.name: build(one, one.name, TIMING) for one in laws}
