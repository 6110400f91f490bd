"""Configuration of a tuning: one table that says everything the tuned gains depend on.

It is plain data, written as TOML. A folder keeps it, and equal text means equal gains: loop, gains
before, what is searched and where, objective, goals, training and held-out runs, method, budget,
seed and the versions that compute.
"""

import functools
import tomllib
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax

from jaxstage import __version__
from jaxstage.metrics.table import key
from jaxstage.model.settings import nearest_name, plain_toml
from jaxstage.studies import Case
from tuning.store.gains_file import read_gains
from tuning.store.prepare import prepare
from tuning.store.work_folder import FolderKind
from tuning.tuner.options import default_objective, parse_gains, parse_objective, search_of
from tuning.tuner.problem.default_sets import LoopSpec, spreads_of
from tuning.tuner.problem.objective import RISKS, Objective, parse_goals
from tuning.tuner.problem.problem import WIDTH, Problem, RunGroup, make_group, make_problem
from tuning.tuner.problem.scenario_set import (
    MOST_RUNS,
    RunSet,
    SetSpec,
    SetTable,
    count_runs,
    run_sets,
    same_law,
    set_table,
)
from tuning.tuner.problem.search_space import (
    Search,
    SearchSpace,
    default_searches,
    search_space,
)
from tuning.tuner.problem.set_file import read_sets, refuse_overlap
from tuning.tuner.problem.surrogate import NONE, SURROGATES
from tuning.tuner.problem.training_metrics import available_columns
from tuning.tuner.search.cma_es import cma_es
from tuning.tuner.search.optimise import AMONG, METHODS, least_budget
from tuning.uncertainty.case_table import case_of, case_table
from tuning.uncertainty.scenario_file import read_scenario

KIND = FolderKind("tune.toml", "tuning", ("jaxstage", "loop"))
#: plants among which the worst are looked for
POOL = 64
#: other plants that gains must hold before the held-out ones are simulated
VALIDATION = 12
#: added to the seed of the training plants: for those that progress is shown on, pools, validation
FRESH_SEED, POOL_SEED, VALIDATION_SEED = 2_000_003, 3_000_017, 4_000_037
#: the method is chosen by the number of parameters and the gradient check
AUTO = "auto"
#: what the command may be off by, either way, in training: a stability margin
MARGIN = 0.5


class TuningRequest(NamedTuple):
    """What the user asked for; each attribute is an option of ``jaxstage tune``."""

    loop: str
    words: tuple[str, ...] = ()
    gains: tuple[str, ...] = ()
    scenario: Path | None = None
    objective: str | None = None
    goals: tuple[str, ...] = ()
    risk: str = "mean"
    margin: float = MARGIN
    surrogate: str = NONE
    train: Path | None = None
    method: str = AUTO
    starts: int = 2
    budget: float = 2000.0
    worst_case: int = 0
    seed: int = 0


class TuningPlan(NamedTuple):
    """A configuration, built, but for the runs: those are made where they are needed.

    Attributes:
        text: the configuration.
        table: the same, read.
        case: of the loop with its own timing.
        space: what is searched.
        objective: what matters.
    """

    text: str
    table: dict[str, Any]
    case: Case
    space: SearchSpace
    objective: Objective

    @property
    def blocks(self) -> Mapping[str, str]:
        """Part of the scenario -> name of the block that was added."""
        return self.table["blocks"]

    @property
    def metric(self) -> str:
        """The column that gains are judged by: the first of the objective."""
        return self.objective.terms[0].column


def configure_tuning(request: TuningRequest) -> str:
    """The configuration as text, everything in it checked but the runs themselves.

    Every file is read once.

    Args:
        request: what the user asked for.

    Raises:
        ValueError: in one line, for anything unknown, impossible or out of range.
    """
    _check_numbers(request)
    words = parse_gains(request.gains)
    gains, scenario = read_gains(words.file), read_scenario(request.scenario)
    prepared = prepare(request.loop, request.words, gains, scenario)
    spreads = tuple(spreads_of(request.loop, scenario))
    loop_spec = LoopSpec(request.loop, request.words, gains, scenario, spreads, request.seed)
    sets = read_sets(request.train, loop_spec, prepared.case)
    refuse_overlap(sets)
    train = _named_table("train", sets.train, loop_spec)
    case = case_of(train["case"][0], scenario.blocks)
    same_law(prepared.case, case)
    SURROGATES[request.surrogate](case)
    columns = available_columns(case)
    unit = key("", case.loop.plant.command_unit).removeprefix("_")
    objective = request.objective or default_objective(columns, unit)
    _objective(objective, request.goals, request.risk, columns)
    searches = words.searches or tuple(map(_plain_search, default_searches(prepared.case)))
    space = search_space(prepared.case, [search_of(dict(one)) for one in searches])
    _check_budget(request, space.size)
    return plain_toml(
        {
            "jaxstage": __version__,
            "jax": jax.__version__,
            "loop": request.loop,
            "method": request.method,
            "starts": request.starts,
            "budget": float(request.budget),
            "seed": request.seed,
            "worst_case": request.worst_case,
            "objective": objective,
            "goal": list(request.goals),
            "risk": request.risk,
            "margin": float(request.margin),
            "surrogate": request.surrogate,
            **({"refused": list(gains.refused)} if gains.refused else {}),
            "blocks": dict(scenario.blocks),
            "search": list(searches),
            "case": case_table(prepared.case),
            "train": train,
            "held_out": _named_table("held_out", sets.held_out, loop_spec),
        }
    )


def _objective(text: str, goals: Sequence[str], risk: str, columns: Collection[str]) -> Objective:
    terms = parse_objective(text, columns)
    every = tuple(goal for one in goals for goal in parse_goals(one, columns))
    return Objective(terms, every, RISKS[risk]())


def _check_numbers(request: TuningRequest) -> None:
    if request.method not in (AUTO, *METHODS):
        hint = nearest_name(request.method, METHODS)
        known = ", ".join((AUTO, *METHODS))
        raise ValueError(f"--method {request.method}{hint}: must be one of {known}")
    for name, known in (("risk", RISKS), ("surrogate", SURROGATES)):
        value = getattr(request, name)
        if value not in known:
            raise ValueError(f"--{name} {value}: must be one of {', '.join(known)}")
    if not 0 <= request.margin < 1:
        raise ValueError(f"--margin {request.margin:g}: must be in 0..1")
    if not 1 <= request.budget <= 1e6:
        raise ValueError(f"--budget {request.budget:g}: must be 1..1e6 simulations")
    if not 0 <= request.seed < 2**32:
        raise ValueError(f"--seed {request.seed}: must be 0..{2**32 - 1}")
    for name, value, least, most in (
        ("--starts", request.starts, 1, AMONG),
        ("--worst-case", request.worst_case, 0, 20),
    ):
        if not least <= value <= most:
            raise ValueError(f"{name} {value}: must be {least}..{most}")


def _check_budget(request: TuningRequest, n: int) -> None:
    method = METHODS.get(request.method, cma_es)()
    rounds = request.worst_case + 1
    least = rounds * least_budget(method, n, request.starts)
    if request.budget < least:
        several = f", {rounds} rounds" if rounds > 1 else ""
        raise ValueError(
            f"--budget {request.budget:g}: must be {least}..1e6 simulations for a first step with "
            f"{n} numbers, --starts {request.starts}{several}"
        )


def _named_table(name: str, spec: SetSpec, loop_spec: LoopSpec) -> SetTable:
    """The table of a set; an error says of which."""
    try:
        table = set_table(spec, loop_spec.gains, loop_spec.scenario)
    except ValueError as error:
        raise ValueError(f"[{name}] {error}") from None
    if count_runs(table) > MOST_RUNS:
        raise ValueError(f"[{name}] {count_runs(table)} runs: must be <= {MOST_RUNS}")
    return table


def _plain_search(search: Search) -> dict[str, Any]:
    """A search as plain data: what is said of it, the transform by name."""
    table = {k: v for k, v in search._asdict().items() if v is not None and v is not False}
    return table | ({"transform": search.transform.name} if search.transform else {})


@functools.lru_cache(maxsize=2)
def build(text: str) -> TuningPlan:
    """The plan of a configuration.

    Args:
        text: of `configure_tuning`.

    Raises:
        ValueError: it is of another version.
    """
    table = tomllib.loads(text)
    for name, version in (("jaxstage", __version__), ("jax", jax.__version__)):
        if table[name] != version:
            raise ValueError(f"this was tuned with {name} {table[name]}, here is {version}")
    case = case_of(table["case"], table["blocks"])
    space = search_space(case, [search_of(one) for one in table["search"]])
    columns = available_columns(case)
    objective = _objective(table["objective"], table["goal"], table["risk"], columns)
    return TuningPlan(text, table, case, space, objective)


def runs_of(plan: TuningPlan, name: str) -> list[RunSet]:
    """The runs of a set: ``train`` or ``held_out``."""
    return run_sets(plan.table[name], plan.blocks)


def fresh_runs(plan: TuningPlan) -> list[RunSet]:
    """Training runs on other plants: what progress is shown on, and used for nothing."""
    return run_sets(_other_plants(plan, FRESH_SEED), plan.blocks)


def pool(plan: TuningPlan, number: int) -> list[RunSet]:
    """Training runs on `POOL` plants among which the worst are looked for. number: of the pool."""
    table = _other_plants(plan, POOL_SEED + number)
    return run_sets({**table, "plants": POOL, "nominal": False, "noise_seeds": 1}, plan.blocks)


def validation_table(plan: TuningPlan) -> SetTable:
    """The table of training runs on other plants, at least `VALIDATION` of them."""
    table = _other_plants(plan, VALIDATION_SEED)
    return {**table, "plants": max(VALIDATION, table["plants"]), "noise_seeds": 1}


def _other_plants(plan: TuningPlan, apart: int) -> SetTable:
    train = plan.table["train"]
    return {**train, "seed": (train["seed"] + apart) % 2**32}


def groups_of(plan: TuningPlan, every: list[RunSet], surrogate: str = NONE) -> list[RunGroup]:
    """Runs as `make_problem` takes them, with the stability margin that was asked for.

    Args:
        plan: that was asked for.
        every: the runs.
        surrogate: of `SURROGATES`, in place of the exact machine.
    """
    smoother, margin = SURROGATES[surrogate], plan.table["margin"]
    return [
        make_group(one.case.name, smoother(one.case), one.values, one.seeds, margin)
        for one in every
    ]


def problem_of(
    plan: TuningPlan, groups: list[RunGroup], like: Problem | None = None, width: int = WIDTH
) -> Problem:
    """The tuning problem on some training runs.

    Args:
        plan: that was asked for.
        groups: the runs.
        like: takes over its scales, so that objectives can be compared.
        width: candidates of one call.

    Raises:
        ValueError: the gains before fail.
    """
    objective = plan.objective
    if like is not None:
        scales = map(float, like.scales)
        pairs = zip(objective.terms, scales, strict=True)
        objective = objective._replace(terms=tuple(t._replace(scale=s) for t, s in pairs))
    return make_problem(plan.space, groups, objective, width)
