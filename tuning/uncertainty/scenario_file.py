"""A scenario file: nominal values as `jaxstage run` takes them, blocks to add, and spreads.

    [blocks]                        # in place of ideal ones, see `scenario_blocks`
    drive = "current_drive"

    [plant]                         # nominal values, SI
    mass = [3.5e-3, 3.0e-3]

    [[spread]]                      # any one: the spreads of the study no longer count
    path = "plant.mass"             # as in --set
    distribution = "normal"         # uniform, triangular, lognormal, discrete
    mean = 1.0                      # the numbers of the distribution
    deviation = 0.1
    low = 0.5                       # cut off there
    relative = true                 # factors on the nominal value (default), or values in SI
    shared = false                  # true: one draw for all axes

    [[correlation]]                 # of the normal scores (Gaussian copula)
    between = ["plant.mass.x", "plant.mass.y"]
    value = 0.8

`jaxstage run` takes the same file and runs its nominal values.
"""

from pathlib import Path
from typing import Any, NamedTuple

from jaxstage.model.settings import line_of, read_toml
from jaxstage.studies import Case
from tuning.uncertainty.scenario_blocks import named_blocks, with_blocks, with_max_delay

#: what is not a nominal value
NOT_VALUES = ("blocks", "spread", "correlation")


class ScenarioFile(NamedTuple):
    """What only a sweep reads: tables of spreads and correlations, and the blocks."""

    blocks: dict[str, str]
    spreads: list[dict[str, Any]]
    correlations: list[dict[str, Any]]


def read_scenario(file: Path) -> ScenarioFile:
    """Spreads, correlations and blocks of a file. Raises ValueError, one line with its place."""
    content = read_toml(file)
    tables = {name: content.get(name, []) for name in ("spread", "correlation")}
    for name, value in tables.items():
        whole = isinstance(value, list) and all(isinstance(table, dict) for table in value)
        inner = next((key for key in content if key.startswith(f"{name}.")), name)
        if not whole or inner != name:
            raise ValueError(f"{file}:{line_of(file, inner)}: write [[{name}]], a table for each")
    return ScenarioFile(named_blocks(content), tables["spread"], tables["correlation"])


def with_file_blocks(case: Case, file: Path) -> Case:
    """The case with the blocks that a scenario file adds. Raises ValueError with its place."""
    content = read_toml(file)
    blocks = named_blocks(content)
    try:
        case = with_blocks(case, blocks)
    except ValueError as error:
        raise ValueError(f"{file}:{line_of(file, next(iter(blocks)))}: {error}") from None
    delay = content.get("drive.delay", 0.0)
    return with_max_delay(case, delay) if isinstance(delay, int | float) else case


def place(file: Path, table: str, number: int) -> str:
    """``file:line`` of the ``number``-th [[table]], counted from 0."""
    lines = file.read_text(encoding="utf-8").splitlines()
    found = [i for i, line in enumerate(lines, 1) if line.strip().startswith(f"[[{table}]]")]
    return f"{file}:{found[number] if number < len(found) else 1}"
