"""Configuration of a sweep: one table that says everything a run's numbers depend on.

It is plain data, written as TOML (`to_text`): workers rebuild the sweep from that text, a folder
keeps it, and its hash names it. Every gain, nominal value, spread and number of the timing is in
it, and the versions that computed, so that equal text means equal numbers.
"""

import functools
import math
import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxstage import __version__
from jaxstage.model.settings import plain_toml
from jaxstage.model.validate import check
from jaxstage.simulate.batch import spread_axes
from jaxstage.studies import Case, find
from tuning.store.gains_file import NO_GAINS, read_gains
from tuning.store.prepare import prepare
from tuning.uncertainty.case_table import case_of, case_table
from tuning.uncertainty.designs import DESIGNS
from tuning.uncertainty.scenario_blocks import with_max_delay
from tuning.uncertainty.scenario_file import NO_SCENARIO, ScenarioFile, read_scenario
from tuning.uncertainty.uncertain_space import (
    Batch,
    Space,
    batch,
    draw,
    longest_delay,
    run_seed,
    space,
    study_spreads,
)

#: runs of a sweep: every draw is checked before the first is simulated
MOST_RUNS = 20_000_000
#: values drawn at once where all are checked before a sweep
_BLOCK = 65536


class SweepRequest(NamedTuple):
    """A sweep as a user asks for it.

    Attributes:
        loops: Names, each on the same plants.
        runs: Plants to draw.
        design: Of `DESIGNS`.
        seed: Of the draws, 0..2^32 - 1.
        chunk: Most runs of one file of results.
        precision: double or single.
        words: As for ``--set``.
        gains: Loop -> file of gains.
        scenario: Scenario file.
    """

    loops: tuple[str, ...]
    runs: int
    design: str = "sobol"
    seed: int = 0
    chunk: int = 1024
    precision: str = "double"
    words: tuple[str, ...] = ()
    gains: Mapping[str, Path] = {}
    scenario: Path | None = None


class SweepPlan(NamedTuple):
    """A configuration, built.

    Attributes:
        text, table: The configuration, as TOML and as plain data.
        cases, spaces: Nominal plant and what is uncertain, one a loop.
        chunks: Files of results a loop.
        size: Runs of a chunk; the last one may have less.
    """

    text: str
    table: dict[str, Any]
    cases: tuple[Case, ...]
    spaces: tuple[Space, ...]
    chunks: int
    size: int

    def place(self, index: int) -> tuple[int, int, int]:
        """Loop, first run and end of a chunk."""
        loop, part = divmod(index, self.chunks)
        return loop, part * self.size, min((part + 1) * self.size, self.table["runs"])


def configure_sweep(
    request: SweepRequest, check: Callable[[SweepPlan], object] = lambda plan: None
) -> str:
    """The configuration as text, everything in it checked, all draws included.

    Args:
        request: what the user asked for.
        check: raises ValueError for a plan that is refused before anything is drawn.

    Raises:
        ValueError: in one line for anything unknown, impossible or out of range.
    """
    for name, value, low in (("-n", request.runs, 1), ("--chunk", request.chunk, 1)):
        if value < low:
            raise ValueError(f"{name} {value}: must be >= {low}")
    if not 0 <= request.seed < 2**32:
        raise ValueError(f"--seed {request.seed}: must be 0..{2**32 - 1}")
    if request.design not in DESIGNS:
        raise ValueError(f"--design {request.design}: must be one of {', '.join(DESIGNS)}")
    if len(set(request.loops)) < len(request.loops) or not request.loops:
        raise ValueError("a sweep needs loops, each named once")
    if request.runs * max(len(request.loops), 1) > MOST_RUNS:
        raise ValueError(f"-n {request.runs}: must be <= {MOST_RUNS} runs of all loops together")
    if request.precision not in ("single", "double"):
        raise ValueError(f"precision = '{request.precision}': must be single or double")
    with jax.enable_x64(request.precision == "double"):
        text = plain_toml(_table(request))
        plan = build(text)
        check(plan)
        _check_draws(plan)
    return text


def _table(request: SweepRequest) -> dict[str, Any]:
    scenario = read_scenario(request.scenario)
    spreads = scenario.spreads or study_spreads(find(request.loops[0]).name)
    gains = {loop: read_gains(file) for loop, file in request.gains.items()}
    loops = [
        prepare(name, request.words, gains.get(name, NO_GAINS), scenario).case
        for name in request.loops
    ]
    for case in loops:
        _check_space(case, spreads, scenario)
    refused = {loop: list(one.refused) for loop, one in gains.items() if one.refused}
    return {
        "jaxstage": __version__,
        "jax": jax.__version__,
        "runs": request.runs,
        "seed": request.seed,
        "design": request.design,
        "precision": request.precision,
        "chunk": min(request.chunk, request.runs),
        **({"refused": refused} if refused else {}),
        "blocks": scenario.blocks,
        "spread": spreads,
        "correlation": scenario.correlations,
        "loop": [case_table(case) for case in loops],
    }


def _check_space(case: Case, spreads: Sequence[Mapping[str, Any]], scenario: ScenarioFile) -> None:
    """Check spreads and correlations one by one, so that an error names its line."""
    of_file = NO_SCENARIO if spreads is not scenario.spreads else scenario
    for number in range(len(spreads)):
        try:
            space(case, spreads[: number + 1], ())
        except ValueError as error:
            raise ValueError(f"{of_file.place('spread', number)}{error} ({case.name})") from None
    for number in range(len(scenario.correlations)):
        try:
            space(case, spreads, scenario.correlations[: number + 1])
        except ValueError as error:
            raise ValueError(f"{scenario.place('correlation', number)}{error}") from None


@functools.lru_cache(maxsize=4)
def build(text: str) -> SweepPlan:
    """The plan of a configuration, in the precision it asks for; the identical one again for equal
    text, so that nothing is compiled twice. Raises ValueError for one of another version."""
    try:
        return _build(text, tomllib.loads(text))
    except (LookupError, TypeError, AttributeError, ArithmeticError, OSError) as error:
        raise ValueError(
            f"the configuration of the sweep is damaged ({type(error).__name__}: {error})"
        ) from None


def _build(text: str, table: dict[str, Any]) -> SweepPlan:
    for name, version in (("jaxstage", __version__), ("jax", jax.__version__)):
        if table[name] != version:
            raise ValueError(
                f"the sweep was configured with {name} {table[name]}, here is {version}"
            )
    for name, least in (("runs", 1), ("chunk", 1), ("seed", 0)):
        if type(table[name]) is not int or table[name] < least:
            raise ValueError(f"the configuration of the sweep is damaged: {name} = {table[name]}")
    with jax.enable_x64(table["precision"] == "double"):
        cases = tuple(case_of(loop, table["blocks"]) for loop in table["loop"])
    spaces = tuple(space(case, table["spread"], table["correlation"]) for case in cases)
    cases = tuple(
        with_max_delay(case, longest_delay(uncertain))
        for case, uncertain in zip(cases, spaces, strict=True)
    )
    _check_design(table, spaces)
    chunks = math.ceil(table["runs"] / table["chunk"])
    return SweepPlan(text, table, cases, spaces, chunks, math.ceil(table["runs"] / chunks))


def _check_design(table: Mapping[str, Any], spaces: tuple[Space, ...]) -> None:
    design, dimensions = DESIGNS[table["design"]], spaces[0].dimensions()
    columns = [tuple(c for item in s.uncertain for c in item.columns) for s in spaces]
    if any(other != columns[0] for other in columns):
        raise ValueError("these loops do not have the same uncertain values: sweep them apart")
    if not dimensions:
        raise ValueError("nothing is uncertain: give --scenario FILE with [[spread]] tables")
    if spaces[0].mixing is not None and design.name in ("corners", "saltelli"):
        raise ValueError(f"--design {design.name}: the uncertain values must be independent")
    design.allowed(table["runs"], dimensions)


def _check_draws(plan: SweepPlan) -> None:
    """Refuse a sweep that would meet an impossible value: every draw is checked."""
    runs = plan.table["runs"]
    for loop in range(len(plan.cases)):
        for start in range(0, runs, _BLOCK):
            numbers = np.arange(start, min(start + _BLOCK, runs))
            drawn = batch_of(plan, loop, numbers, drawn_values(plan, loop, start, numbers[-1] + 1))
            trees = (drawn.gains, drawn.scenario, drawn.path)
            try:
                check(plan.cases[loop].loop, *trees, spread_axes(drawn.in_axes, trees))
            except ValueError as error:
                told = re.sub(r"of run (\d+)", lambda m: f"of run {int(m[1]) + start}", str(error))  # noqa: B023
                raise ValueError(f"{told} (a draw: bound the spread with low and high)") from None


def drawn_values(plan: SweepPlan, loop: int, start: int, stop: int) -> dict[str, np.ndarray]:
    """Uncertain values of runs start..stop-1 of a loop: path -> (stop - start, *shape), SI."""
    table = plan.table
    return draw(plan.spaces[loop], table["design"], table["seed"], table["runs"], start, stop)


def batch_of(
    plan: SweepPlan, loop: int, runs: np.ndarray, values: Mapping[str, np.ndarray]
) -> Batch:
    """Runs of a loop by number, with their values, ready for `rollouts`."""
    seeds = np.array([run_seed(plan.table["seed"], int(run)) for run in runs], np.uint32)
    return batch(plan.cases[loop], values, seeds)


def precision_of(text: str) -> str:
    """The precision that a configuration asks for; JAX need not have started."""
    precision = tomllib.loads(text)["precision"]
    if precision not in ("single", "double"):
        raise ValueError(f"precision = {precision!r}: must be single or double")
    return precision
