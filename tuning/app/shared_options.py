"""Options that several commands share, and commands that take theirs as one dataclass."""

import inspect
from collections.abc import Callable
from dataclasses import MISSING, Field, fields
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_type_hints

import typer

from tuning.app import completion

Request = TypeVar("Request", bound=tuple)

Loop = Annotated[
    str,
    typer.Argument(
        help="A loop of `jaxstage list`, e.g. dfcmac-circle.", autocompletion=completion.loops
    ),
]
Settings = Annotated[
    list[str],
    typer.Option("--set", metavar="NAME=VALUE", help="As for `jaxstage run`. Repeatable."),
]
GainsFile = Annotated[Path | None, typer.Option(help="TOML file of gains.")]
ScenarioFile = Annotated[Path | None, typer.Option(help="TOML file of a scenario.")]
Precision = Annotated[str, typer.Option(help="double or single.")]
Force = Annotated[
    bool, typer.Option("--force", help="Single precision also where it is off by over 1 %.")
]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]


def add_command(app: typer.Typer, name: str, body: Callable[[Any], None], example: str) -> None:
    """Add a command to the command line.

    Args:
        app: gets it.
        name: of the command.
        body: what it does; its only argument is a dataclass, whose fields are the options.
        example: a call that works, shown at the end of its help.
    """
    (kind,) = (hint for role, hint in get_type_hints(body).items() if role != "return")
    hints = get_type_hints(kind, include_extras=True)

    def command(**values: Any) -> None:
        body(kind(**{name: value for name, value in values.items() if value is not None}))

    command.__doc__ = body.__doc__
    command.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        [_parameter(field, hints[field.name]) for field in fields(kind)]
    )
    command.__annotations__ = hints
    app.command(name, epilog=f"Example: {example}")(command)


def _parameter(field: Field[Any], annotation: Any) -> inspect.Parameter:
    """A field as Typer reads an option: None stands for a default that is made anew."""
    required = field.default is MISSING and field.default_factory is MISSING
    default = None if field.default is MISSING else field.default
    return inspect.Parameter(
        field.name,
        inspect.Parameter.KEYWORD_ONLY,
        default=inspect.Parameter.empty if required else default,
        annotation=annotation,
    )


def picked(options: Any, request: type[Request]) -> Request:
    """A request that is made of the options of the same names.

    Args:
        options: the dataclass of a command.
        request: a NamedTuple; a name that no option has keeps its default.
    """
    names = request._fields  # type: ignore[attr-defined]
    values = {name: getattr(options, name) for name in names if hasattr(options, name)}
    return request(**{k: tuple(v) if isinstance(v, list) else v for k, v in values.items()})
