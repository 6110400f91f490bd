"""Claims on the law itself: its surface, its switching and adaptive gain, its proof."""

import numpy as np

from jaxstage.studies.adaptive_smc import values
from jaxstage.studies.adaptive_smc.reading import (
    PUBLISHED,
    cell,
    energy,
    paper,
    total,
)
from jaxstage.studies.claim import Claim
from jaxstage.studies.evidence import always, applied, of, over, saved


def surface() -> list[Claim]:
    """What the nonlinear surface is said to do."""
    savings = [
        paper.about(regime=regime, slope=slope, short=short, meaning=paper.terms[short]).claim(
            "surface-energy-{regime}-{slope}",
            saved(energy(f"smc-{regime}"), energy(f"smc-{regime}/linear-{slope}")),
        )
        for regime, short in (("s1", "smooth"), ("s7", "switching"))
        for slope in (40, 58)
    ]
    return [
        *savings,
        paper.claim("figure01-overshoot", of("step/nonlinear", "overshoot")),
        paper.claim(
            "figure01-fast", over(of("step/nonlinear", "rise_s"), of("step/low", "rise_s"))
        ),
        paper.claim(
            "surface-fast-start",
            over(
                *(
                    of(f"{run}/whole", "following_mean_um", "y")
                    for run in ("smc-s0", "smc-s0/linear-58")
                )
            ),
        ),
        paper.claim(
            "surface-psi-printed",
            lambda e: 20.0 if (at := e["smc-s1/psi-printed/late"]["lost_at_s"]) is None else at,
        ),
        paper.claim("surface-sign", over(cell("smc-s6-printed", "max_x"), cell("smc-s6", "max_x"))),
    ]


def _bound_of_q() -> float:
    """Largest disturbance in N: the break-away force, the most that the friction can be."""
    return float(np.max(np.asarray(values.fitted_friction().friction.static)))


def _closing_time() -> float:
    """Share of T after which (22) as printed repeats itself."""
    th = 2 * np.pi * np.arange(720) / 720
    leaf = np.cos(th) * (4 * np.sin(th) ** 2 - 1)
    curve = np.stack([leaf * np.cos(th), leaf * np.sin(th)])
    same = [np.allclose(curve, np.roll(curve, k, axis=1), atol=1e-12) for k in range(1, 721)]
    return (1 + int(np.argmax(same))) / 720


def switching() -> list[Claim]:
    """Switching gain, reaching gain, reference and supply."""
    q, gain = PUBLISHED["table2"]["q"], always(float(PUBLISHED["table2"]["gain_1_per_s"]))
    needed = float(np.max(_bound_of_q() / values.inertia()))
    mean_gain = "reaching_gain_mean_1_per_s"
    return [
        paper.claim("q-bounds-d-force", always(_bound_of_q() / q)),
        paper.claim("q-bounds-d", always(needed / q)),
        paper.claim("q-energy", applied(lambda joule: joule / 3.6, energy("smc-s4"))),
        paper.claim("q-makes-k-idle", over(total("smc-k120-s4"), total("smc-s4"))),
        paper.claim("gain-stable", over(of("limits", "difference_1_per_s"), gain)),
        paper.claim("gain-margin", over(of("limits", "difference_delay_1_per_s"), gain)),
        paper.claim("closed-after-t", lambda evidence: _closing_time()),
        paper.claim("gain-adequate", over(total("asmc-s7", mean_gain), total("smc-s7", mean_gain))),
        paper.claim("regeneration", saved(of("smc-s1/whole", "energy_net_J"), energy("smc-s1"))),
    ]


def theory() -> list[Claim]:
    """Statements on paper only."""
    ids = ("stability-20", "stability-18", "surface-loop", "stability-weights")
    return [paper.unchecked(id) for id in ids]
