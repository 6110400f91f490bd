"""``python -m benchmarks``: how fast jaxstage is here, and how fast it could be."""

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path

import jax

import jaxstage as js

from . import against_cxx, costs, memory
from .cxx_build import compiler
from .timing import machine


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="under a minute: batch 64 only")
    parser.add_argument("--json", type=Path, help="write the times of the main table here, too")
    parser.add_argument("--gpu", action="store_true", help="only the portable engine on a GPU")
    parser.add_argument("--whole", action="store_true", help="memory of whole runs (minutes)")
    return parser.parse_args()


def _against_c(quick: bool) -> list[against_cxx.Result]:
    if compiler() is None:
        print("\njaxstage against C++: not measured, there is no g++ here")
        return []
    best, text = against_cxx.best_variants(0.1 if quick else 1.0)
    print(text, flush=True)
    results = []
    for row in against_cxx.rows(quick):
        results.append(against_cxx.measure(row, best[row.law, row.dtype], 1.0 if quick else 2.0))
        print(f"  {'.' * len(results)}", end="\r", flush=True)
    print(against_cxx.report(results), flush=True)
    return results


def _write(file: Path, results: list[against_cxx.Result]) -> None:
    rows = []
    for result in results:
        seconds = {name: times._asdict() for name, times in result.times.items()}
        own = {"ticks": result.row.ticks, "difference": result.difference, "seconds": seconds}
        rows.append(result.row._asdict() | own)
    file.write_text(json.dumps({"machine": machine(), "rows": rows}, indent=1), encoding="utf-8")


def main() -> int:
    """Print the tables; 1 where jaxstage and C++ disagree."""
    options = _arguments()
    begin = time.perf_counter()
    js.configure(cores=2)
    if not options.gpu:
        jax.config.update("jax_platforms", "cpu")
    for name, text in machine().items():
        print(f"{name:10} {text}")
    if options.gpu:
        print(costs.gpu(3.0))
        return 0
    results = _against_c(options.quick)
    tables: list[Callable[[], str]] = [lambda: costs.everyday(options.quick)]
    if not options.quick:
        tables += [lambda: costs.sizes(1.0), lambda: costs.shares(3.0)]
        tables += [lambda: costs.gradient_costs(3.0)]
    tables += [lambda: memory.peaks(options.quick, options.whole), lambda: costs.gpu(3.0)]
    for text in tables:
        print(text(), flush=True)
    if options.json:
        _write(options.json, results)
    print(f"\n{time.perf_counter() - begin:.0f} s in all")
    return int(not all(r.agrees for r in results))


if __name__ == "__main__":
    raise SystemExit(main())
