"""A claim of a paper as a predicate with a threshold on computed metrics.

A `Claim` says where it stands, what is printed, which metric of ours it is held against and by
which `Bound`. Its verdict is computed by `judge` from the evidence of a study's experiments; what
no simulation can decide is `unchecked`, with the reason.
"""

import functools
from collections.abc import Callable, Mapping
from operator import getitem
from typing import Any, NamedTuple, cast

from jaxstage.model.fields import definition, replace
from jaxstage.studies.evidence import Evidence, Pick
from jaxstage.studies.packaged import packaged_toml

HOLDS, FAILS, UNCHECKED = "holds", "fails", "unchecked"


@definition
class Bound:
    """When a metric agrees with a claim: ``holds(ours, published)``; ``text`` says it in words."""

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
    our words. published: the printed number, or None where only words are printed. unit: of both
    numbers, empty for a pure number. ours: picks the metric out of the evidence; None for what
    cannot be checked. bound: when ours agrees, None with ``ours``. reason: what the metric rests
    on (published values, or which chosen one), or why it cannot be checked.
    """

    id: str
    where: str
    text: str
    published: float | None
    unit: str
    ours: Pick | None
    bound: Bound | None
    reason: str


#: the key of an entry that holds a bound -> how it is made
BOUNDS: dict[str, Callable[[float], Bound]] = {
    "within": within,
    "at_most": at_most,
    "at_least": at_least,
    "printed": printed,
}


@definition
class PaperClaims:
    """The claims of one paper, as the file ``claims.toml`` of its study states them.

    An entry holds ``where``, ``text``, ``reason`` and, where there is one, ``unit``; ``published``,
    a number or its place in ``published.toml``; and one of `BOUNDS`: a number, the name of a term,
    ``published`` or ``published / 2``. Names in braces, in keys too, stand for terms and words.
    """

    entries: Mapping[str, Mapping[str, Any]]
    numbers: Mapping[str, Any]
    terms: Mapping[str, Any]

    def about(self, **words: object) -> "PaperClaims":
        """The same claims with more words for the names in braces."""
        return replace(self, terms={**self.terms, **words})

    def claim(
        self, id: str, ours: Pick, bound: Bound | None = None, published: float | None = None
    ) -> Claim:
        """A claim that the evidence decides.

        Args:
            id: Key of the entry.
            ours: Picks the metric out of the evidence.
            bound: When ours agrees, if the entry has none of `BOUNDS`.
            published: The printed number, if the entry has none.
        """
        stated = self.unchecked(id, published)
        number = stated.published or 0.0
        limits = {**self.terms, "published": number, "published / 2": number / 2}
        for key, make in BOUNDS.items():
            if (limit := self.entries[id].get(key)) is not None:
                bound = make(limits[limit] if isinstance(limit, str) else limit)
        assert bound is not None, id
        return replace(stated, ours=ours, bound=bound)

    def unchecked(self, id: str, published: float | None = None) -> Claim:
        """A claim that no simulation can decide; arguments as of `claim`."""
        entry = self.entries[id]
        where, text, unit, reason = (
            entry.get(key, "").format(**self.terms) for key in ("where", "text", "unit", "reason")
        )
        number = entry.get("published", published)
        if isinstance(number, str):
            place = number.format(**self.terms).split(".")
            number = functools.reduce(getitem, place, cast(Any, self.numbers))
        return Claim(
            id=id.format(**self.terms).replace("_", "-"),
            where=where,
            text=text,
            published=None if number is None else float(number),
            unit=unit,
            ours=None,
            bound=None,
            reason=reason,
        )


def paper_claims(study: str, **terms: object) -> PaperClaims:
    """The claims of a study's ``claims.toml``; terms: numbers and words that its texts name."""
    entries = dict(packaged_toml(study, "claims.toml"))
    for name, value in entries.pop("terms").items():
        terms[name] = value.format(**terms) if isinstance(value, str) else value
    numbers = packaged_toml(study, "published.toml")
    return PaperClaims(entries=entries, numbers=numbers, terms=terms)


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
        id=claim.id,
        where=claim.where,
        text=claim.text,
        published=claim.published,
        ours=ours,
        unit=claim.unit,
        difference=difference,
        verdict=verdict,
        reason=reason,
    )


def count(verdicts: Mapping[str, str] | tuple[Judgement, ...]) -> dict[str, int]:
    """How many claims hold, fail and are unchecked."""
    if isinstance(verdicts, Mapping):
        values = list(verdicts.values())
    else:
        values = [judged.verdict for judged in verdicts]
    return {verdict: values.count(verdict) for verdict in (HOLDS, FAILS, UNCHECKED)}
