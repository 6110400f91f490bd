"""jaxstage against C++: the same runs, the same results, timed in turn."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxstage.simulate.tiles import DEFAULT

from .cases import LAWS, Work, compiled, work
from .cxx_build import Kernel, Variant, build_all, widths
from .jax_runs import batched, tracking_error, vmapped
from .tables import rate, ratio, table
from .timing import Times, first_calls, in_turn

#: relative difference of the ATE of any run that is taken for agreement
AGREE = {"float64": 1e-9, "float32": 1e-3}
TICKS = {1: 10_000, 64: 5_000, 4096: 400}
#: a lap of 1 s, which only C++ and the compiled engine run in no time
LAP = 10_000


class Row(NamedTuple):
    """A configuration to time. lap: the runs last one, and scans are left out."""

    law: str
    dtype: str
    full: bool
    lanes: int
    lap: bool = False

    @property
    def ticks(self) -> int:
        return LAP if self.lap else TICKS[self.lanes]

    @property
    def work(self) -> Work:
        return work(self.law, self.dtype, self.lanes, self.ticks, self.full)


def rows(quick: bool) -> list[Row]:
    """The configurations of the main table."""
    if quick:
        return [Row("dfcmac", d, False, 64) for d in AGREE] + [Row("sliding", "float32", False, 64)]
    lean = [Row("dfcmac", d, False, n) for d in AGREE for n in (1, 64, 4096)]
    full = [Row("dfcmac", d, True, n) for d in AGREE for n in (1, 64, 4096)]
    laps = [Row(law, d, False, 4096, lap=True) for law in LAWS for d in AGREE]
    return lean + full + [Row("sliding", d, False, n) for d in AGREE for n in (64, 4096)] + laps


def variants() -> tuple[Variant, ...]:
    """What the kernels are built as; the fastest is the one compared with."""
    return tuple(Variant(w, b, s) for w in widths() for b, s in ((1, 1), (2, 1), (2, 0)))


def best_variants(seconds: float) -> tuple[dict[tuple[str, str], Variant], str]:
    """The fastest build of each kernel, and the table of all."""
    build_all(variants())
    best, cells = {}, []
    for law, dtype in ((law, dtype) for law in LAWS for dtype in AGREE):
        runs = work(law, dtype, 4096, 1000)
        kernels = {str(v): Kernel(runs, v) for v in variants()}
        times = in_turn(kernels, first_calls(kernels), seconds)
        rates = {v: runs.lane_steps / times[str(v)].cpu for v in variants()}
        best[law, dtype] = max(rates, key=lambda v: rates[v])
        cells.append([f"{law} {dtype}", *(rate(rates[v]) for v in variants())])
    head = ["kernel", *(f"{8 * v.width}x{v.block}{' skip' if v.skip else ''}" for v in variants())]
    note = (
        "lane-steps (2 axes) per second of one core, 4096 runs. 512x2: two vectors of 512 bit at\n"
        "a time. skip: rows of CMAC cells that no run of a vector is in are passed over (fast\n"
        "while runs stay together), else a select chain over all 36. The best one is 'C++' below."
    )
    return best, table("C++ kernels", head, cells, note)


def contenders(row: Row, variant: Variant) -> dict[str, Callable[[], Any]]:
    """Everything timed in turn for one configuration."""
    runs = row.work
    programs: dict[str, Callable[[], Any]] = {
        "C++": Kernel(runs, variant),
        "engine": batched(compiled(runs), runs.lanes, 1),
    }
    if not row.lap:
        programs["rollouts"] = batched(runs, min(DEFAULT, runs.lanes), 1)
        programs["vmap"] = vmapped(runs)
    if runs.lanes > 1 and jax.local_device_count() > 1:
        programs["C++ 2"] = Kernel(runs, variant, threads=2)
        programs["engine 2"] = batched(compiled(runs), runs.lanes // 2, 2)
        if not row.lap:
            programs["rollouts 2"] = batched(runs, min(DEFAULT, runs.lanes // 2), 2)
    return programs


def difference(results: dict[str, tuple[float, Any]]) -> float:
    """The largest relative difference of the ATE of any run from that of the C++ kernel."""
    errors = {
        name: np.asarray(r if name.startswith("C++") else tracking_error(r), float)
        for name, (_, r) in results.items()
    }
    # not the built-in max, which passes over NaN
    return float(np.max([np.max(np.abs(e / errors["C++"] - 1)) for e in errors.values()]))


class Result(NamedTuple):
    """Times of a row, and how far the results are apart."""

    row: Row
    times: dict[str, Times]
    difference: float

    @property
    def agrees(self) -> bool:
        return self.difference <= AGREE[self.row.dtype]


def measure(row: Row, variant: Variant, budget: float) -> Result:
    """Check and time one configuration."""
    programs = contenders(row, variant)
    first = first_calls(programs, workers=2)
    return Result(row, in_turn(programs, first, budget), difference(first))


def _cells(result: Result) -> list[str]:
    row, t = result.row, result.times
    steps = row.lanes * row.ticks
    names = ("engine", "rollouts", "vmap")
    one = {n: steps / t[n].cpu for n in ("C++", *names) if n in t}
    two = {n: steps / t[n].best for n in ("C++ 2", "engine 2", "rollouts 2") if n in t}
    apart = f"{result.difference:.0e}" + ("" if result.agrees else " DIFFERS")
    return [
        f"{row.law} {row.dtype} {'all' if row.full else 'ATE'} {row.lanes} x {row.ticks}",
        *(rate(one[n]) if n in one else "" for n in ("C++", *names)),
        *(ratio(one[n] / one["C++"]) if n in one else "" for n in names),
        *(rate(two[n]) if n in two else "" for n in ("C++ 2", "engine 2", "rollouts 2")),
        f"{t['engine'].best / t['engine 2'].best:.2f}" if two else "",
        apart,
        *(f"{t[n].compiling:.1f}" if n in t else "" for n in names),
    ]


def report(results: list[Result]) -> str:
    """The main table."""
    one = ["C++", "engine", "rollouts", "vmap", "eng./C++", "roll./C++", "vmap/C++"]
    two = ["C++ 2 thr.", "eng. 2 dev.", "roll. 2 dev.", "eng. x"]
    head = ["runs", *one, *two, "ATE diff.", *["comp. s"] * 3]
    note = (
        "lane-steps per processor second (one core), for two threads or devices per second of\n"
        "wall time; runs taken in turn, calls as a user makes them (checks of the input\n"
        "included). eng. x: two devices against one, by the clock. all: every default metric (C++\n"
        "keeps ATE only). ATE diff.: the largest relative difference of any run from C++. comp.:\n"
        "first call of engine, rollouts and vmap beyond a later one, two at a time. jaxstage also\n"
        "looks for lost runs at every tick; C++ does not."
    )
    return table("jaxstage against C++", head, [_cells(r) for r in results], note)
