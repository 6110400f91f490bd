"""``python -m benchmarks.methods``: units that each method needs, on the linear-motor stage.

The stage with a current loop of 1 ms, an encoder with noise and plants that vary; gains of the
adaptive fuzzy law. For every seed other plants, noise and random numbers. The gradient method's
units to reach the best that CMA-ES finds in all of its budget, and the best at equal cost.
"""

import argparse
import json
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import jaxstage as js
from tuning.tuner.problem.objective import Objective, Term
from tuning.tuner.problem.problem import Problem, evaluate, make_problem
from tuning.tuner.problem.run_group import make_group
from tuning.tuner.problem.search_space import Search, search_space
from tuning.tuner.search.cma_es import cma_es
from tuning.tuner.search.cost_model import CostModel, measure_cost_model
from tuning.tuner.search.first_order import first_order
from tuning.tuner.search.lbfgs import lbfgs
from tuning.tuner.search.levenberg_marquardt import levenberg_marquardt
from tuning.tuner.search.optimise import SearchResult, tune
from tuning.tuner.search.random_search import random_search
from tuning.uncertainty.case_table import with_values
from tuning.uncertainty.scenario_blocks import with_blocks
from tuning.uncertainty.uncertain_space import draw, space, study_spreads

from .tables import table
from .timing import machine

LOOP = "af-pid-ccc"
TERMS = (Term("contour_rms_um"), Term("energy_copper_J", 0.1), Term("command_change_rms_A", 0.1))
AXES = ("gains.law.law.slope", "law.switch.width", "disturbance_gain", "velocity_gain")
SCALES = ("scales.deviation", "scales.rate", "scales.integral")
LEARNING = ("lam", "g_P", "g_I", "g_D")


def searches(few: bool) -> tuple[Search, ...]:
    """15 parameters: the axes' gains and the scales; or 158: all consequents, scales, learning and
    the axes' gains, each alike on all axes."""
    boxes = {
        "rules.proportional": (1.0, 4000.0),
        "rules.integral": (1.0, 20000.0),
        "rules.derivative": (0.01, 40.0),
    }
    axes = tuple(Search(name, tied=not few) for name in AXES)
    scales = tuple(map(Search, SCALES))
    if few:
        return axes + scales
    rules = tuple(Search(name, *box) for name, box in boxes.items())
    return rules + axes + scales + tuple(map(Search, LEARNING))


def stage(duration: float) -> js.Case:
    """The stage as it stands in a laboratory."""
    timing = js.replace(js.find(LOOP).timing, duration=duration)
    case = with_blocks(js.find(LOOP).build(timing), {"sensor": "noisy_encoder"})
    real = {
        "drive.lag": 1e-3,
        "sensor.sensor.resolution": 1e-7,
        "sensor.sensor.bandwidth": 1e3,
        "sensor.noise": 2e-8,
    }
    return with_values(case, real)


def training(case: js.Case, seed: int, runs: int) -> Any:
    """Plants and noise of a seed."""
    values = draw(space(case, study_spreads(LOOP), ()), "random", seed, runs, 0, runs)
    return make_group("helix", case, values, seed * runs + np.arange(runs))


def reseeded(problem: Problem, case: js.Case, seed: int, runs: int) -> Problem:
    """The problem on the plants of another seed; the compiled programs stay."""
    group = training(case, seed, runs)
    fresh = problem._replace(
        groups=(group,),
        data=((group.batch.scenario, group.batch.path),),
        scales=np.ones(len(TERMS)),
    )
    first = evaluate(fresh, problem.space.start()[None])
    scales = [math.sqrt(np.mean(first.columns[t.column] ** 2)) for t in TERMS]
    fresh = fresh._replace(scales=np.array(scales))
    return fresh._replace(before=evaluate(fresh, problem.space.start()[None]))


def units_to(result: SearchResult, target: float) -> float:
    """Units after which the best is at most ``target``, inf if it never is."""
    return next((p.simulations for p in result.history if p.best <= target), math.inf)


def best_at(result: SearchResult, simulations: float) -> float:
    """The best after so many units."""
    return min((p.best for p in result.history if p.simulations <= simulations), default=math.inf)


def compare(
    few: bool, seeds: int, budget: float, duration: float, runs: int, others: bool
) -> dict[str, Any]:
    """All methods on all seeds; without the ``others`` only CMA-ES and the gradient method."""
    case = stage(duration)
    problem = make_problem(
        search_space(case, searches(few)), (training(case, 0, runs),), Objective(TERMS)
    )
    own, needs = (levenberg_marquardt(), "gauss_newton") if few else (lbfgs(), "gradient")
    cost_model = measure_cost_model(problem, needs)
    print(f"n = {problem.space.size}, {cost_model}", flush=True)
    if few and others:
        gradient = measure_cost_model(problem, "gradient").gradient
        cost_model = CostModel(gradient, cost_model.gauss_newton, cost_model.simulation_s)
    share = 3 if few else 10
    methods: dict[str, Callable[[], Any]] = {
        own.name: lambda: own,
        "cma": cma_es,
        "random": random_search,
        "adam": first_order,
    }
    if not others:
        methods = {name: methods[name] for name in (own.name, "cma")}
    rows = []
    for seed in range(seeds):
        own_problem = reseeded(problem, case, seed, runs)
        results = {}
        for name, make in methods.items():
            spent = budget if name in ("cma", "random") else budget / share * 2
            begin = time.perf_counter()
            results[name] = tune(
                own_problem, make(), seed=seed, budget=spent, cost_model=cost_model
            )
            print(
                f"  seed {seed} {name}: {results[name].after:.4f} after "
                f"{results[name].simulations:.0f} units, {time.perf_counter() - begin:.0f} s",
                flush=True,
            )
        target = results["cma"].after
        rows.append(
            {
                "seed": seed,
                "target": target,
                "own": units_to(results[own.name], target),
                **{
                    f"{name} at {at:g}": best_at(result, at)
                    for name, result in results.items()
                    for at in (budget / share, budget)
                },
                **{f"{name} end": result.after for name, result in results.items()},
            }
        )
    median = float(np.median([row["own"] for row in rows]))
    return {
        "n": problem.space.size,
        "method": own.name,
        "budget": budget,
        "runs": runs,
        "duration_s": duration,
        "prices": cost_model._asdict(),
        "rows": rows,
        "median_units": median,
        "share": median / budget,
        "wanted": 1 / share,
    }


def show(summary: dict[str, Any]) -> str:
    """A table, one line a seed."""
    names = [name for name in summary["rows"][0] if name != "seed"]
    body = [[str(row["seed"]), *(f"{row[name]:.4g}" for name in names)] for row in summary["rows"]]
    head = (
        f"n = {summary['n']}: {summary['method']} reaches the best of {summary['budget']:g} units "
        f"of CMA-ES in {summary['median_units']:.0f} units (median), {summary['share']:.3f} of "
        f"them; prices {summary['prices']}"
    )
    return table(head, ["seed", *names], body)


def main() -> None:
    """Measure and print; with ``--json`` write it, too."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.methods", description=__doc__)
    parser.add_argument("--few", action="store_true", help="15 parameters in place of 158")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--budget", type=float, default=1500.0, help="units of CMA-ES")
    parser.add_argument("--duration", type=float, default=0.2, help="s of a training run")
    parser.add_argument("--runs", type=int, default=32, help="training runs")
    parser.add_argument("--cores", type=int, default=2)
    parser.add_argument("--others", action="store_true", help="random search and Adam, too")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    js.configure(cores=options.cores, cache="default")
    print(machine())
    summary = compare(
        options.few, options.seeds, options.budget, options.duration, options.runs, options.others
    )
    print(show(summary))
    if options.json:
        options.json.write_text(json.dumps(summary, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
