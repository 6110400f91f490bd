"""``jaxstage list``: the systems that can be simulated."""

from dataclasses import dataclass


@dataclass(frozen=True)
class ListOptions:
    """``jaxstage list`` takes no options."""


def list_loops(options: ListOptions) -> None:
    """Loops, references and verdicts of all systems, yours too."""
    from jaxstage.studies import known_studies, stored_verdicts
    from jaxstage.studies.claim import count
    from tuning.app.result_table import Column, ResultTable, say, show

    for study in known_studies():
        say(f"{study.name}  {study.title}", "bold")
        say(f"  {study.source}")
        if study.references:
            say(f"  references: {', '.join(study.references)}")
        if study.claims:
            verdicts = ", ".join(f"{n} {v}" for v, n in count(stored_verdicts(study)).items())
            say(f"  claims: {verdicts}  (jaxstage compare {study.name})")
        rows = [{"loop": entry.name, "summary": entry.summary} for entry in study.loops]
        show(ResultTable((Column("loop"), Column("summary")), rows))
