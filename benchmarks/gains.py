"""``python -m benchmarks.gains``: single gains tuned on the systems that they come from.

Each line is a `jaxstage tune` with its 100 held-out plants: metric before and after with interval,
lost runs, energy, units and seconds. Minutes a line.
"""

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

from .tables import table
from .timing import machine

ROOT = Path(__file__).parents[1]


class TunedRow(NamedTuple):
    """What is tuned: a name for it, the loop, and further words of the command."""

    name: str
    loop: str
    words: tuple[str, ...]


ROWS = (
    TunedRow("c1", "dfcmac-circle", ("--gains", "c1")),
    TunedRow("r1", "dfcmac-circle", ("--gains", "r1")),
    TunedRow("sigma", "dfcmac-circle", ("--gains", "sigma")),
    TunedRow("eta", "dfcmac-circle", ("--gains", "eta")),
    TunedRow("all of it", "dfcmac-circle", ()),
    TunedRow("all of it", "cmac-circle", ()),
    TunedRow("all of it", "pi-circle", ()),
    TunedRow("cascade", "cascade-circle", ()),
    TunedRow("kappa", "smc-s7-implicit", ("--gains", "kappa")),
    TunedRow("lambda", "smc-s7-implicit", ("--gains", "lam")),
    TunedRow("beta", "smc-s7-implicit", ("--gains", "beta")),
    TunedRow("all of it", "smc-s7-implicit", ()),
    TunedRow("all, margin 0.25", "smc-s7-implicit", ("--margin", "0.25")),
    TunedRow("all of it", "asmc-floored-s7-implicit", ()),
    TunedRow("rules", "af-pid-ccc", ("--gains", "rules")),
    TunedRow("all but rules", "pid-ccc", ()),
    TunedRow("all of it", "af-pid-ccc", ()),
    TunedRow("all of it", "pd", ()),
    TunedRow("all of it", "asmc-mrac-caps", ()),
    TunedRow("cascade", "cascade", ()),
)


def tuned(row: TunedRow, more: list[str]) -> dict[str, Any]:
    """The JSON object of a command; what it refuses is in it, too."""
    program = "from tuning.app.main import main; main()"
    command = [sys.executable, "-c", program, "tune", row.loop, *row.words, *more, "--json"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        command, capture_output=True, text=True, cwd=ROOT, env=environment, check=False
    )
    if done.returncode:
        raise RuntimeError(f"{row.loop}: {done.stderr.strip().splitlines()[-1]}")
    return json.loads(done.stdout)


def cells(row: TunedRow, result: dict[str, Any]) -> list[str]:
    """A line of the table."""
    held, energy = result["held_out"], result["held_out"]["figures"].get("energy_J", {})
    change = held["change"] or {}
    saved = energy and 100 * (energy["after"] / energy["before"] - 1)
    interval = [change.get(name) for name in ("value", "low", "high")]
    told = " ".join("-" if x is None else f"{100 * x:.1f}" for x in interval)
    before, after = (f"{held[name]['value']:.4g}" for name in ("before", "after"))
    cost = [str(result["n"]), f"{result['units']:.0f}", f"{result['seconds']:.0f}"]
    outcome = [f"{saved:+.2f}" if energy else "", str(held["lost"])]
    accepted = "yes" if result["accepted"] else "no"
    return [row.name, row.loop, result["method"], *cost, before, after, told, *outcome, accepted]


def main() -> None:
    """Tune and print, line by line; with ``--json`` keep everything."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.gains", description=__doc__)
    parser.add_argument("--only", nargs="*", help="names of lines")
    parser.add_argument("--json", type=Path)
    options, more = parser.parse_known_args()
    print(machine())
    kept, lines = [], []
    for row in ROWS:
        if options.only and row.name not in options.only:
            continue
        result = tuned(row, more)
        kept.append({"row": row._asdict(), "found": result})
        lines.append(cells(row, result))
        print("  ".join(lines[-1]), flush=True)
        if options.json:
            options.json.write_text(json.dumps(kept, indent=1), encoding="utf-8")
    head = ["gain", "loop", "method", "n", "units", "s", "before um", "after um"]
    head += ["change % (95 %)", "energy %", "lost", "accepted"]
    print(table("held-out plants", head, lines))


if __name__ == "__main__":
    main()
