"""Names that the shell completes to."""


def loops(incomplete: str) -> list[str]:
    """Loops whose name begins so."""
    from jaxstage.studies import loop_names

    return [name for name in loop_names() if name.startswith(incomplete)]


def studies(incomplete: str) -> list[str]:
    """Studies with claims whose name begins so."""
    from jaxstage.studies import known_studies

    names = [study.name for study in known_studies() if study.claims]
    return [name for name in names if name.startswith(incomplete)]
