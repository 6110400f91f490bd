"""What survives of the claims of the fuzzy cross-coupling paper: what each is judged by.

Its tables, equations and parameters are lost in the text at hand, units of the errors included. So
the printed errors are no target; shares and directions are, and hold or fail for the chosen values.
"""

from jaxstage.studies.claim import Claim, paper_claims
from jaxstage.studies.evidence import (
    Evidence,
    Pick,
    always,
    applied,
    largest_of,
    of,
    over,
    ratio,
    saved,
)
from jaxstage.studies.fuzzy_ccc.experiments import DRAWS, LARGE, SMALL, estimate_error
from jaxstage.studies.fuzzy_ccc.variants import BLIND_GAIN, MASS_ERROR, RATES
from jaxstage.studies.packaged import packaged_toml

PUBLISHED = packaged_toml("fuzzy-ccc", "published.toml")
TABLE4, TABLE5 = PUBLISHED["table4"], PUBLISHED["table5"]
RMS = "contour_rms_um"

paper = paper_claims(
    "fuzzy-ccc",
    large=LARGE,
    small=SMALL,
    blind_gain=BLIND_GAIN,
    draws=DRAWS,
    fastest=max(RATES),
    mass_error=", ".join(map(str, MASS_ERROR)),
)


def _saved(
    metric: str, axis: str | None = None, by: str = "af-pid-ccc", than: str = "pid-ccc"
) -> Pick:
    """What the first law saves of a metric of the second, in %."""
    share = saved(of(by, metric, axis), of(than, metric, axis))
    return applied(lambda part: 100 * part, share)


def _over(metric: str, top: str, bottom: str) -> Pick:
    """A metric of one case over that of another."""
    return over(of(top, metric), of(bottom, metric))


def _over_axes(metric: str, top: str, bottom: str) -> Pick:
    """The largest ratio over the axes."""
    return largest_of([over(of(top, metric, axis), of(bottom, metric, axis)) for axis in "xyz"])


def _arithmetic() -> list[Claim]:
    """The printed shares against the printed errors."""
    return [
        paper.about(
            table=table, where=PUBLISHED[table]["where"], name=name, words=name.replace("_", " ")
        ).claim("arithmetic-{name}", always(100 * (1 - row["fuzzy"] / row["pid"])))
        for table in ("table4", "table5")
        for name, row in PUBLISHED[table].items()
        if "saved_percent" in row
    ]


BLIND, OBSERVED, WEAK = "large gain, no observer", "small gain, observer", "small gain, no observer"


def _observer() -> list[Claim]:
    return [
        paper.claim("figure6-chattering", _over_axes("command_variation_A_per_s", OBSERVED, BLIND)),
        paper.claim(
            "figure5-large-gain",
            over(always(1.0), _over_axes("following_rms_um", BLIND, WEAK)),
        ),
        paper.claim("figure6-error", _over_axes("following_rms_um", OBSERVED, BLIND)),
        paper.claim("figure6-error-layer", _over(RMS, "none", "none/blind")),
        paper.claim("figure6d", lambda evidence: 100 * max(estimate_error(evidence))),
        paper.claim("figure7", _over_axes("following_rms_um", "none", "pd")),
        paper.claim("figure7-cause", _over(RMS, "pd-observed", "none")),
        paper.unchecked("stability"),
    ]


def _tables() -> list[Claim]:
    claims = []
    for axis in "xyz":
        for name, words in (("max", "largest error"), ("mean", "mean error"), ("rms", "RMS error")):
            pick = _saved(f"following_{name}_um", axis)
            start = "; that of x and z is the error at the start" if name == "max" else ""
            told = paper.about(axis=axis, name=name, words=words, start=start)
            claims.append(told.claim("table4-{axis}-{name}", pick))
            if f"{axis}_{name}" in TABLE4:
                claims.append(told.claim("table4-{axis}-{name}-size", pick))
    for name in ("max", "mean", "rms"):
        row, pick = TABLE5[f"contour_{name}"], _saved(f"contour_{name}_um")
        start = "here it is the error at the start, which no law can change" * (name == "max")
        claims += [
            paper.about(name=name, capitals=name.upper(), why=start and f"; {start}").claim(
                "table5-{name}", pick
            ),
            paper.about(name=name, why=start or "the learning rates decide").claim(
                "table5-{name}-size",
                pick,
                published=row.get("saved_percent", 100 * (1 - row["fuzzy"] / row["pid"])),
            ),
        ]
    return claims


def _coupling() -> list[Claim]:
    tangent = over(of("af-pid-ccc", "contour_tangent_rms_um"), of("af-pid-ccc", RMS))
    faster = [_saved(RMS, by=f"af-pid-ccc/rates-{factor:g}") for factor in RATES]
    adaptive, pid = (
        [of(f"{name}/machine-{seed}", RMS) for seed in range(DRAWS)]
        for name in ("af-pid-ccc", "pid-ccc")
    )
    return [
        paper.claim("coupling", _over(RMS, "pid-ccc", "none")),
        paper.claim("coupling-sign", _over("contour_mean_um", "sign, af-pid-ccc", "sign, none")),
        paper.claim("estimate", applied(lambda share: 100 * abs(share - 1), tangent)),
        paper.claim("rates", largest_of(faster)),
        paper.claim(
            "table5-rest", _saved("contour_max_um", by="af-pid-ccc/rest", than="pid-ccc/rest")
        ),
        paper.claim("table5-scalar", _saved(RMS, by="af-pid-ccc/scalar", than="pid-ccc/scalar")),
        paper.claim("schedule", _over(RMS, "fuzzy-frozen", "pid-ccc")),
        paper.claim("adaptation-cause", _over(RMS, "af-pid-ccc", "pid-ccc/mean-gains")),
        paper.claim("mismatch", _influence),
        paper.claim("robust", over(largest_of(adaptive), of("af-pid-ccc", RMS))),
        paper.claim("robust-better", largest_of(list(map(over, adaptive, pid)))),
        paper.claim("robust-mass", _over(RMS, "af-pid-ccc/mass", "pid-ccc/mass")),
    ]


def _influence(evidence: Evidence) -> float | None:
    """Rise of the contour RMS from equal to unequal axes, over that without coupling."""
    rises = []
    for name in ("af-pid-ccc", "none"):
        unequal, equal = (evidence[case][RMS] for case in (name, f"{name}/matched"))
        if unequal is None or equal is None:
            return None
        rises.append(abs(unequal - equal))
    return ratio(*rises)


def _lost() -> list[Claim]:
    ids = ("table1", "table2", "table3", "table4-level", "table5-level", "two-motors")
    return [paper.unchecked(id) for id in ids]


claims: tuple[Claim, ...] = (
    *_observer(),
    *_tables(),
    *_coupling(),
    *_arithmetic(),
    *_lost(),
)
