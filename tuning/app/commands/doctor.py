"""``jaxstage doctor``: what this machine gives."""

from dataclasses import dataclass
from typing import Annotated

import typer

from tuning.app.shared_options import AsJson, Precision


@dataclass(frozen=True)
class DoctorOptions:
    """What ``jaxstage doctor`` takes."""

    loop: Annotated[
        str | None, typer.Argument(help="A loop: is it compiled for this processor, and why not?")
    ] = None
    as_json: AsJson = False
    precision: Precision = "double"


def doctor(options: DoctorOptions) -> None:
    """What this machine gives, and a one-second speed test.

    With a loop: the kernels that the engine builds of it, or the reason why it does not.
    """
    from jaxstage.system.runtime import configure, cpu_cores

    configure(precision=options.precision, cores=cpu_cores(), cache="default")
    from tuning.app import doctor as machine
    from tuning.app.messages import print_json

    if options.loop is None:
        answer = machine.examine()
        text = machine.text(answer)
    else:
        answer, text = machine.explained(options.loop)
    if options.as_json:
        print_json(answer)
    else:
        print(text)
