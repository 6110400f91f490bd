"""``python -m tests.speed.tuned``: what tuning gives each controller, by the same budget.

Every loop is tuned as `jaxstage tune LOOP` does it, then judged on its held-out plants. The tables
of docs/tuning.md are these.
"""

import argparse
import json
import time
from pathlib import Path
from typing import Any

import jaxstage as js
from jaxstage.runtime import cpu_cores
from tuning.tuner import configuration
from tuning.tuner.report import held_out_object
from tuning.tuner.session import Outcome, run_tuning

from .tables import table
from .timing import machine

#: machine -> its controllers, an industrial cascade or PD among them
LOOPS = {
    "XY stage with dry friction": (
        "dfcmac-circle", "cmac-circle", "pi-circle", "cascade-circle",
    ),
    "three-axis linear-motor stage": ("af-pid-ccc", "pid-ccc", "none", "pd"),
    "lead-screw table, implicit switching": ("smc-s7-implicit", "asmc-floored-s7-implicit"),
    "two inertias with LuGre friction": ("smc500-mrac", "asmc-mrac-caps", "cascade"),
}  # fmt: skip


def _tuned(loop: str, budget: float, seed: int) -> tuple[Outcome, float, float]:
    """The outcome, seconds, and those of the processor."""
    begin, used = time.perf_counter(), time.process_time()
    text = configuration.configure_tuning(
        configuration.Request(loop=loop, budget=budget, seed=seed)
    )
    outcome = run_tuning(configuration.build(text))
    return outcome, time.perf_counter() - begin, time.process_time() - used


def _row(loop: str, budget: float, seed: int) -> tuple[list[str], dict[str, Any]]:
    outcome, wall, cpu = _tuned(loop, budget, seed)
    found, tuned = outcome.held_out, outcome.tuned
    energy = found.others["energy_J"]
    change, before, after = found.change, found.before, found.after
    texts = ["-", "-", "-", "-"]
    if change and before and after and energy[0] and energy[1] is not None:
        texts = [
            f"{before.value:.4g}", f"{after.value:.4g}",
            f"{change.value:+.1%} ({change.low:+.1%}..{change.high:+.1%})",
            f"{energy[1] / energy[0] - 1:+.1%}",
        ]  # fmt: skip
    verdict = "accepted" if not outcome.refused else f"refused: {outcome.refused[0]}"
    row = [
        loop, f"{tuned.method}, {tuned.n}", f"{outcome.units:.0f}", *texts,
        f"{found.lost} ({found.lost_before})", f"{cpu:.0f} s", verdict,
    ]  # fmt: skip
    kept = {
        "loop": loop, "method": tuned.method, "n": tuned.n, "units": outcome.units,
        "wall_s": wall, "processor_s": cpu, "refused": list(outcome.refused),
        "share": outcome.chosen.share, "held_out": held_out_object(found),
    }  # fmt: skip
    return row, kept


def main() -> None:
    """Tune what was asked for and print a table a machine."""
    parser = argparse.ArgumentParser(prog="python -m tests.speed.tuned", description=__doc__)
    parser.add_argument("loops", nargs="*", help="all of the tables if left out")
    parser.add_argument("--budget", type=float, default=200.0, help="units of each")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path, help="write all figures here, too")
    options = parser.parse_args()
    js.configure("double", cores=cpu_cores(), cache="default")
    for name, text in machine().items():
        print(f"{name:10} {text}")
    head = (
        "loop", "method, n", "units", "before", "after", "change", "energy", "lost", "processor",
        "verdict",
    )  # fmt: skip
    every = []
    tables = {"": tuple(options.loops)} if options.loops else LOOPS
    for title, loops in tables.items():
        rows = []
        for loop in loops:
            row, kept = _row(loop, options.budget, options.seed)
            print("  ".join(row), flush=True)
            rows.append(row)
            every.append(kept)
            if options.json:
                options.json.write_text(json.dumps(every, indent=1), encoding="utf-8")
        print(table(
            title, head, rows,
            "held-out plants, means; before, after: error in um, see docs/tuning.md; lost: after "
            "(before)",
        ), flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
