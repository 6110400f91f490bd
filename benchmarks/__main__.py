"""``python -m benchmarks``: how fast jaxstage is here, and how fast it could be."""

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path

import jax

import jaxstage as js

from . import compare, costs, memory
from .build import compiler
from .timing import machine


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="under a minute: batch 64 only")
    parser.add_argument("--json", type=Path, help="write the times of the main table here, too")
    parser.add_argument("--gpu", action="store_true", help="only the portable engine on a GPU")
    parser.add_argument("--whole", action="store_true", help="memory of whole runs (minutes)")
    parser.add_argument("--child", help=argparse.SUPPRESS)
    return parser.parse_args()


def _against_c(quick: bool) -> list[compare.Result]:
    if compiler() is None:
        print("\njaxstage against C++: not measured, there is no g++ here")
        return []
    best, text = compare.best_variants(0.1 if quick else 1.0)
    print(text, flush=True)
    results = []
    for row in compare.rows(quick):
        results.append(compare.measure(row, best[row.law, row.dtype], 1.0 if quick else 2.0))
        print(f"  {'.' * len(results)}", end="\r", flush=True)
    print(compare.report(results), flush=True)
    return results


def _write(file: Path, results: list[compare.Result]) -> None:
    found = [
        {**r.row._asdict(), "ticks": r.row.ticks, "difference": r.difference,
         "seconds": {name: t._asdict() for name, t in r.times.items()}}
        for r in results
    ]  # fmt: skip
    file.write_text(json.dumps({"machine": machine(), "rows": found}, indent=1), encoding="utf-8")


def main() -> int:
    """Run what was asked for; 1 where jaxstage and C++ disagree."""
    options = _arguments()
    begin = time.perf_counter()
    js.configure(cores=2)
    if not options.gpu:
        jax.config.update("jax_platforms", "cpu")
    if options.child:
        memory.child(options.child)
        return 0
    for name, text in machine().items():
        print(f"{name:10} {text}")
    if options.gpu:
        print(costs.gpu(3.0))
        return 0
    results = _against_c(options.quick)
    tables: list[Callable[[], str]] = [lambda: costs.everyday(options.quick)]
    if not options.quick:
        tables += [
            lambda: costs.sizes(1.0), lambda: costs.shares(3.0),
            lambda: costs.gradient_costs(3.0),
        ]  # fmt: skip
    tables += [lambda: costs.memory_costs(options.quick, options.whole), lambda: costs.gpu(3.0)]
    for text in tables:
        print(text(), flush=True)
    if options.json:
        _write(options.json, results)
    print(f"\n{time.perf_counter() - begin:.0f} s in all")
    return int(not all(r.agrees for r in results))


if __name__ == "__main__":
    raise SystemExit(main())
