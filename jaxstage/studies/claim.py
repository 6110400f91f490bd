"""A claim of a paper as a predicate with a threshold on computed figures.

A `Claim` says where it stands, what is printed, which figure of ours it is held against and by
which `Bound`. Its verdict is computed by `judge` from the evidence of a study's experiments; what
no simulation can decide is `unchecked`, with the reason.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from jaxstage.model.fields import definition

#: name of a simulated case -> its figures, as `columns` gives them
Evidence = Mapping[str, Mapping[str, Any]]

#: picks a figure out of the evidence, None where a run it needs was lost
Picked = Callable[[Evidence], float | None]

HOLDS, FAILS, UNCHECKED = "holds", "fails", "unchecked"


@definition
class Bound:
    """When a figure agrees with a claim: ``holds(ours, published)``; ``text`` says it in words."""

    text: str
    holds: Callable[[float, float], bool]


def within(share: float) -> Bound:
    """|ours - published| <= share |published|."""
    return Bound(
        text=f"within {share * 100:.3g} %",
        holds=lambda ours, published: abs(ours - published) <= share * abs(published),
    )


def at_most(limit: float) -> Bound:
    """ours <= limit."""
    return Bound(text=f"at most {limit:g}", holds=lambda ours, published: ours <= limit)


def at_least(limit: float) -> Bound:
    """ours >= limit."""
    return Bound(text=f"at least {limit:g}", holds=lambda ours, published: ours >= limit)


def printed(step: float) -> Bound:
    """|ours - published| <= step, the last printed digit (some are cut off, not rounded)."""
    return Bound(
        text=f"equal to the last printed digit, {step:g}",
        holds=lambda ours, published: abs(ours - published) <= step * (1 + 1e-9),
    )


@definition
class Claim:
    """One claim.

    id: short name, unique in the study. where: place in the paper. text: what the paper says, in
    our words. published: the printed figure, or None where only words are printed. unit: of both
    figures, empty for a pure number. ours: picks the figure out of the evidence; None for what
    cannot be checked. bound: when ours agrees, None with ``ours``. reason: what the figure rests
    on (published values, or which chosen one), or why it cannot be checked.
    """

    id: str
    where: str
    text: str
    published: float | None
    unit: str
    ours: Picked | None
    bound: Bound | None
    reason: str


def claim(
    id: str, where: str, text: str, ours: Picked, bound: Bound, reason: str,
    published: float | None = None, unit: str = "",
) -> Claim:  # fmt: skip
    """A claim that the evidence decides, with what most of them lack left out."""
    return Claim(
        id=id, where=where, text=text, published=published, unit=unit, ours=ours, bound=bound,
        reason=reason,
    )  # fmt: skip


def unchecked(
    id: str, where: str, text: str, published: float | None, unit: str, reason: str
) -> Claim:
    """A claim that no simulation can decide."""
    return Claim(
        id=id, where=where, text=text, published=published, unit=unit, ours=None, bound=None,
        reason=reason,
    )  # fmt: skip


class Judgement(NamedTuple):
    """A claim with its computed verdict. difference: (ours - published)/|published|, or None."""

    id: str
    where: str
    text: str
    published: float | None
    ours: float | None
    unit: str
    difference: float | None
    verdict: str
    reason: str


def judge(claim: Claim, evidence: Evidence) -> Judgement:
    """The verdict on one claim: holds, fails (also where a run it needs was lost), unchecked."""
    if claim.ours is None or claim.bound is None:
        return _judgement(claim, None, UNCHECKED, claim.reason)
    ours = claim.ours(evidence)
    if ours is None:
        return _judgement(claim, None, FAILS, f"a run it needs was lost; {claim.reason}")
    printed = float("nan") if claim.published is None else claim.published
    verdict = HOLDS if claim.bound.holds(ours, printed) else FAILS
    return _judgement(claim, float(ours), verdict, f"holds if {claim.bound.text}; {claim.reason}")


def _judgement(claim: Claim, ours: float | None, verdict: str, reason: str) -> Judgement:
    difference = None
    if ours is not None and claim.published:
        difference = (ours - claim.published) / abs(claim.published)
    return Judgement(
        id=claim.id, where=claim.where, text=claim.text, published=claim.published, ours=ours,
        unit=claim.unit, difference=difference, verdict=verdict, reason=reason,
    )  # fmt: skip


def count(verdicts: Mapping[str, str] | tuple[Judgement, ...]) -> dict[str, int]:
    """How many claims hold, fail and are unchecked."""
    values = list(verdicts.values()) if isinstance(verdicts, Mapping) else [
        judged.verdict for judged in verdicts
    ]  # fmt: skip
    return {verdict: values.count(verdict) for verdict in (HOLDS, FAILS, UNCHECKED)}
