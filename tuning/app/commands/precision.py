"""``jaxstage precision``: single precision beside double."""

from dataclasses import dataclass, field
from typing import Annotated

import typer

from tuning.app import completion


@dataclass(frozen=True)
class PrecisionOptions:
    """What ``jaxstage precision`` takes."""

    loops: Annotated[
        list[str],
        typer.Argument(help="Loops to compare; all if left out.", autocompletion=completion.loops),
    ] = field(default_factory=list)


def precision(options: PrecisionOptions) -> None:
    """How far single precision moves the metrics, as TOML."""
    import tomli_w

    from jaxstage.studies import build, find, loop_names
    from jaxstage.studies.precision import compare_precision
    from jaxstage.system.runtime import configure

    configure(precision="double", cache="default")
    for name in options.loops:
        find(name)
    for name in options.loops or loop_names():
        table = {k: float(f"{v:.2e}") for k, v in compare_precision(build(name)).items()}
        print(tomli_w.dumps({name: table}), flush=True)
