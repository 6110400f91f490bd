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

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from jaxstage.model.settings import TomlFile, read_toml
from jaxstage.studies import Case
from tuning.uncertainty.scenario_blocks import with_blocks


class ScenarioFile(NamedTuple):
    """A scenario file, read once; without a file, what changes nothing.

    Attributes:
        toml: The file, for the places of errors; None where there is none.
        seed: Of the random key of a run, 0..2^32 - 1; None keeps that of the loop.
        values: Nominal values by dotted name, SI: numbers or nested lists.
        blocks: Part of the scenario -> name of the block that stands in for an ideal one.
        spreads, correlations: Their tables, in the order of the file.
    """

    toml: TomlFile | None = None
    seed: int | None = None
    values: Mapping[str, Any] = {}
    blocks: Mapping[str, str] = {}
    spreads: Sequence[Mapping[str, Any]] = ()
    correlations: Sequence[Mapping[str, Any]] = ()

    def place(self, name: str, number: int = 0) -> str:
        """``file:line: `` of a key, or of the ``number``-th table of that name, to begin an error
        with; empty without a file."""
        return f"{self.toml.place(name, number)}: " if self.toml else ""

    def with_blocks(self, case: Case) -> Case:
        """The case with the blocks of the file. Raises ValueError with its place."""
        for part, name in self.blocks.items():
            try:
                case = with_blocks(case, {part: name})
            except ValueError as error:
                raise ValueError(f"{self.place(f'blocks.{part}')}{error}") from None
        return case


#: nothing is said
NO_SCENARIO = ScenarioFile()


def read_scenario(file: Path | None) -> ScenarioFile:
    """Read a scenario file, or none. Raises ValueError in one line, with its place."""
    if file is None:
        return NO_SCENARIO
    toml = read_toml(file)
    values, blocks = dict(toml.values), {}
    lists = {name: values.pop(name, []) for name in ("spread", "correlation")}
    for name, tables in lists.items():
        inner = next((key for key in values if key.startswith(f"{name}.")), None)
        if inner or not isinstance(tables, list) or not all(isinstance(t, dict) for t in tables):
            raise ValueError(f"{toml.place(inner or name)}: write [[{name}]], a table for each")
    for name in [name for name in values if name.startswith("blocks.")]:
        blocks[name.removeprefix("blocks.")] = values.pop(name)
    if "blocks" in values:
        raise ValueError(
            f'{toml.place("blocks")}: write a table: [blocks], then drive = "current_drive"'
        )
    seed = values.pop("seed", None)
    if seed is not None and (type(seed) is not int or not 0 <= seed < 2**32):
        raise ValueError(
            f"{toml.place('seed')}: seed = {seed}: must be a whole number 0..{2**32 - 1}"
        )
    return ScenarioFile(toml, seed, values, blocks, lists["spread"], lists["correlation"])
