"""Claims on the law itself: its surface, its switching and adaptive gain, its proof."""

import numpy as np

from jaxstage.studies.adaptive_smc import values
from jaxstage.studies.adaptive_smc.reading import (
    FITTED,
    PUBLISHED,
    SMOOTH,
    SWITCHED,
    TABLE5,
    TEXT,
    cell,
    energy,
    total,
)
from jaxstage.studies.claim import Claim, Picked, at_least, at_most, claim, unchecked, within
from jaxstage.studies.figures import ratio, saving


def _saved(top: str, bottom: str) -> Picked:
    return lambda e: saving(energy(e, top), energy(e, bottom))


# --- the law itself --------------------------------------------------------------------------


def surface() -> list[Claim]:
    """What the nonlinear surface is said to do."""
    saving = TEXT["cited_surface_saving"]
    claims = [
        claim(
            f"surface-energy-{regime}-{slope}", "Section I, of [31]",
            f"{short}: the nonlinear surface saves energy against a linear one of {slope} 1/s",
            _saved(f"smc-{regime}", f"smc-{regime}/linear-{slope}"), at_least(saving / 2),
            f"{meaning}; holds if half the cited share is saved", saving,
        )
        for regime, short, meaning in (("s1", "smooth", SMOOTH), ("s7", "switching", SWITCHED))
        for slope in (40, 58)
    ]  # fmt: skip
    return [
        *claims,
        claim(
            "figure01-overshoot", "Figure 1", "nonlinear damping: overshoot of the step response",
            lambda e: e["step/nonlinear"]["overshoot"], at_most(0.05),
            "damping ratios 0.2 and 1.5 (chosen)",
        ),
        claim(
            "figure01-fast", "Figure 1", "nonlinear damping: rise time against low damping",
            lambda e: ratio(e["step/nonlinear"]["rise_s"], e["step/low"]["rise_s"]),
            at_most(1.25), "damping ratios 0.2 and 1.5 (chosen)",
        ),
        claim(
            "surface-fast-start", "Section III.A",
            "a small psi at the start speeds up the response: error of axis 2 from rest, against "
            "the linear surface of the final slope",
            lambda e: ratio(
                e["smc-s0/whole"]["following_mean_um"]["y"],
                e["smc-s0/linear-58/whole"]["following_mean_um"]["y"],
            ),
            at_most(1.0),
            "on the surface e' = -A e is of first order: it has no damping ratio, and a small A is "
            "a slow decay",
        ),
        claim(
            "surface-psi-printed", "(8)", "psi can be computed along (22): time until it cannot",
            lambda e: 20.0 if (at := e["smc-s1/psi-printed/late"]["lost_at_s"]) is None else at,
            at_least(20.0), "x_r1' = 0 at the start, and at each of the reversals", None, "s",
        ),
        claim(
            "surface-sign", "(12), (17)", "largest error with the printed sign of the psi' term "
            "against the consistent one",
            lambda e: ratio(cell(e, "smc-s6-printed", "max_x"), cell(e, "smc-s6", "max_x")),
            at_most(1.0), "the sign belongs to a convention with psi <= 0",
        ),
    ]  # fmt: skip


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
    q = PUBLISHED["table2"]["q"]
    gain = float(PUBLISHED["table2"]["gain_1_per_s"])
    needed = float(np.max(_bound_of_q() / values.inertia()))
    return [
        claim(
            "q-bounds-d-force", "(12), (13), Table 2",
            "q = 0.3 read as N, as (12) has it, bounds the disturbance (largest over q)",
            lambda e: _bound_of_q() / q, at_most(1.0), FITTED,
        ),
        claim(
            "q-bounds-d", "(13), Table 2",
            "q = 0.3 read as m/s2, as Table 2 has it, bounds the disturbance (largest over q)",
            lambda e: needed / q, at_most(1.0), FITTED,
        ),
        claim(
            "q-energy", "Table 2, Table 5", "q = 0.3 m/s2 with sign(s) draws the published energy",
            lambda e: _in_mwh(energy(e, "smc-s4")), within(0.5),
            f"{FITTED}; resistance, pitch and path chosen", TABLE5["energy_smc_mWh"], "mWh",
        ),
        claim(
            "q-makes-k-idle", "(13), (18)",
            "with (13) s reaches 0 whatever K: mean error at K = 120 against K = 80 1/s",
            lambda e: ratio(
                total(e, "smc-k120-s4", "following_mean_um"),
                total(e, "smc-s4", "following_mean_um"),
            ),
            within(0.05), "q = 0.3 m/s2 satisfies (13); the sampled law never reaches s = 0", 1.0,
        ),
        claim(
            "gain-stable", "Table 2, section IV.A",
            "K = 80 1/s is stable with differenced velocity at 5 ms: limit over gain",
            lambda e: e["limits"]["difference_1_per_s"] / gain, at_least(1.0),
            "lam + gam beta = 58 1/s, published inertia and damping",
        ),
        claim(
            "gain-margin", "Table 2, section IV.A",
            "and has a margin of 2 with one more period of dead time: limit over gain",
            lambda e: e["limits"]["difference_delay_1_per_s"] / gain, at_least(2.0),
            "dead time of computing and output (chosen); 2 is the usual 6 dB",
        ),
        claim(
            "closed-after-t", "(22)", "T is the time to complete the trajectory: time to close / T",
            lambda e: _closing_time(), within(0.01), "the curve closes earlier and is traced again",
            1.0,
        ),
        claim(
            "gain-adequate", "Section III.B",
            "switching: the adaptation keeps an adequate gain where it saves energy: mean gain "
            "over K(0)",
            lambda e: ratio(
                total(e, "asmc-s7", "reaching_gain_mean_1_per_s"),
                total(e, "smc-s7", "reaching_gain_mean_1_per_s"),
            ),
            at_least(0.5), f"{SWITCHED}; the saving is that of a gain that collapses",
        ),
        claim(
            "regeneration", "Section IV.C",
            "braking power does not matter: share of the energy that is not taken back",
            lambda e: saving(
                e["smc-s1/whole"]["energy_net_J"], e["smc-s1/whole"]["energy_J"]
            ),
            at_most(0.003), "viscous friction takes all of it",
        ),
    ]  # fmt: skip


def _in_mwh(joule: float | None) -> float | None:
    return None if joule is None else joule / 3.6


def theory() -> list[Claim]:
    """Statements on paper only."""
    return [
        unchecked(
            "stability-20", "(20)", "the printed bound of q makes V' negative for |s| < eps", None,
            "", "with k <= k* the printed bound is empty: the difference has the wrong sign",
        ),
        unchecked(
            "stability-18", "(18)", "V' along the closed loop", None, "",
            "misprints: -k s^2 has become -k |s|, d has lost the sign of s, and d and Q their 1/J",
        ),
        unchecked(
            "surface-loop", "(12)", "the law can be computed from x and x'", None, "",
            "psi' needs x'' and so u itself; the paper does not say how it was computed",
        ),
        unchecked(
            "stability-weights", "(15)", "V is a Lyapunov function", None, "",
            "it adds m2/s2 to 1/s2: a weight is missing; k <= k* is assumed, not shown",
        ),
    ]  # fmt: skip
