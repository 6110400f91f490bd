"""``python -m benchmarks.sweep``: what a sweep costs beside the batch engine, and how it grows."""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

import jaxstage as js
from jaxstage.system.runtime import cpu_cores
from tuning.sweeps import store
from tuning.sweeps.configuration import SweepRequest, batch_of, build, configure_sweep, drawn_values
from tuning.sweeps.sweep import sweep

from .memory import forget_peak, status
from .tables import rate, ratio, table
from .timing import machine

ROOT = Path(__file__).parents[1]
LAP = ("lap_time=1",)
#: 200 ticks: here the host's work counts most
SHORT = ("lap_time=0.02", "laps=1", "scored=0")
WHOLE = ("lap_time=1", "laps=1", "scored=0")
CHUNK = 1024


def _request(loops: tuple[str, ...], runs: int, words: tuple[str, ...]) -> str:
    return configure_sweep(SweepRequest(loops=loops, runs=runs, chunk=CHUNK, words=words))


class Spent(NamedTuple):
    """Seconds by the clock, and of the processor over all threads, which other programs on the
    machine disturb less."""

    wall: float
    cpu: float


def _spent(action: Callable[[], Any]) -> Spent:
    begin, used = time.perf_counter(), time.process_time()
    action()
    return Spent(time.perf_counter() - begin, time.process_time() - used)


def _swept(text: str) -> Spent:
    """A whole sweep into an empty folder."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out"

        def whole() -> None:
            store.create(out, text, resume=False)
            sweep(text, out)

        return _spent(whole)


def throughput(loop: str, chunks: int, rounds: int) -> list[str]:
    """The batch engine on one chunk and a sweep of some, in turn."""
    text = _request((loop,), CHUNK * chunks, LAP)
    plan = build(text)
    case = plan.cases[0]
    batch = batch_of(plan, 0, np.arange(CHUNK), drawn_values(plan, 0, 0, CHUNK))

    def engine() -> None:
        for _ in range(chunks):
            run = js.rollouts(
                case.loop,
                batch.gains,
                batch.scenario,
                batch.path,
                case.window.ticks,
                in_axes=batch.in_axes,
            )
            jax.block_until_ready(run.report)

    engine()
    pairs = [(_spent(engine), _swept(text)) for _ in range(rounds)]
    bare, whole = (Spent(*map(min, zip(*times, strict=True))) for times in zip(*pairs, strict=True))
    steps = CHUNK * chunks * case.window.ticks
    return [
        loop,
        rate(steps / bare.wall),
        rate(steps / whole.wall),
        ratio(bare.wall / whole.wall),
        ratio(bare.cpu / whole.cpu),
    ]


def growth(loop: str, runs: int, timing: tuple[str, ...]) -> None:
    """In a process of its own: seconds and peak memory of a sweep of so many runs."""
    size = build(_request((loop,), runs, timing)).size
    _swept(_request((loop,), size, timing))  # the same program, compiled
    base = status("VmRSS")
    forget_peak()
    begin = time.perf_counter()
    text = _request((loop,), runs, timing)
    configured = time.perf_counter() - begin
    seconds = _swept(text).wall
    print(json.dumps([configured, seconds, status("VmHWM") - base]))


def _grown(loop: str, runs: int, timing: tuple[str, ...]) -> list[str]:
    child = ["--child", loop, str(runs), *timing]
    command = [sys.executable, "-m", "benchmarks.sweep", *child]
    answer = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    configured, seconds, peak = json.loads(answer.stdout.splitlines()[-1])
    each = (configured + seconds) / runs
    return [
        str(runs),
        f"{configured:.2f} s",
        f"{seconds:.2f} s",
        f"{each * 1e6:.0f} us",
        f"{peak:.0f} MB",
    ]


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.sweep", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a minute: fewer and shorter")
    parser.add_argument(
        "--large",
        action="store_true",
        help="10 000 plants under three laws; growth by whole laps",
    )
    parser.add_argument("--child", nargs="+", help=argparse.SUPPRESS)
    options = parser.parse_args()
    js.configure("double", cores=cpu_cores(), cache="default")
    if options.child:
        loop, runs, *words = options.child
        growth(loop, int(runs), tuple(words))
        return
    for name, text in machine().items():
        print(f"{name:10} {text}")
    rows = [
        throughput(name, 2, 2 if options.quick else 4)
        for name in (("cascade-circle",) if options.quick else ("cascade-circle", "dfcmac-circle"))
    ]
    head = ("loop", "engine", "sweep", "wall", "processor")
    print(
        table(
            f"Lane-steps per second, chunks of {CHUNK} runs of 2 laps of 1 s, all default metrics, "
            "double precision",
            head,
            rows,
            "engine: rollouts alone; sweep: draws, checks, Parquet too; shares of the engine's",
        )
    )
    sizes = (1000, 10_000) if options.quick else (1000, 10_000, 100_000)
    for ticks, timing in ((200, SHORT), (10_000, WHOLE))[: 2 if options.large else 1]:
        rows = [_grown("pi-circle", runs, timing) for runs in sizes]
        head = ("plants", "configured", "swept", "a plant", "peak")
        print(
            table(
                f"How a sweep grows: pi-circle, {ticks} ticks a run",
                head,
                rows,
                "peak: memory above that of the process after a first sweep",
            )
        )
    if options.large:
        loops = ("cmac-circle", "dfcmac-circle", "cascade-circle")
        spent = _swept(_request(loops, 10_000, LAP))
        print(
            f"\n10 000 plants under {', '.join(loops)}, 2 laps of 1 s: {spent.wall:.0f} s "
            f"({spent.cpu:.0f} s of processor time)"
        )


if __name__ == "__main__":
    main()
