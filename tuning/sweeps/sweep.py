"""Monte-Carlo simulation: chunks of runs through the batch engine, on any executor.

A task is (configuration text, chunk number): nothing else travels to a worker, and the rows that
come back depend on nothing else. Chunks are written by the process that calls `sweep`, as each
comes back.
"""

import functools
import platform
from collections.abc import Callable, Iterable
from concurrent.futures import Executor, Future, ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import NamedTuple

import jax
import jaxlib.version
import numpy as np
import pyarrow as pa

from jaxstage.simulate.batch import rollouts
from jaxstage.studies.verdict import scored_columns
from jaxstage.system.runtime import configure, cpu_cores, processor
from tuning.store.work_folder import digest
from tuning.sweeps import store
from tuning.sweeps.configuration import SweepPlan, batch_of, build, drawn_values
from tuning.uncertainty.metric_table import flag_columns, metric_columns, parameter_columns

#: bytes that the results of one chunk may take before it is refused
CHUNK_MEMORY = 2e9


@functools.cache
def start_worker(cores: int) -> None:
    """Start JAX in a worker with one device a core; 0 takes all cores the worker may use."""
    configure(cores=cores or cpu_cores(), cache="default")


def run_chunk(text: str, index: int, cores: int | None = None) -> pa.Table:
    """The rows of one chunk of a configuration.

    Args:
        text: Of `configure_sweep`.
        index: Number of the chunk.
        cores: For a worker, which starts JAX with them (0: all it may use); None leaves JAX as it
            is.
    """
    if cores is not None:
        start_worker(cores)
    return chunk_rows(build(text), index)


def chunk_rows(plan: SweepPlan, index: int) -> pa.Table:
    """The rows of a chunk. It is filled up with its last run, so that all share one program."""
    loop, start, stop = plan.place(index)
    runs = np.arange(start, stop)
    return _table(plan, loop, runs, simulate_rows(plan, loop, runs, plan.size))


def simulate_rows(
    plan: SweepPlan,
    loop: int,
    runs: np.ndarray,
    lanes: int,
    devices: int | None = None,
) -> dict[str, np.ndarray]:
    """Simulate some runs of a loop in one batch.

    Args:
        plan: The sweep.
        loop: Number of the loop.
        runs: Numbers of the runs, (n,), any of the sweep.
        lanes: Size of the batch, >= n: it is filled up with the last run.
        devices: How many share the batch; None for all.

    Returns:
        Column -> (n,): parameters in SI, metrics in display units, what became of the run.
    """
    case, index = plan.cases[loop], np.minimum(np.arange(lanes), len(runs) - 1)
    values = _values(plan, loop, runs)
    with jax.enable_x64(plan.table["precision"] == "double"):
        filled = {path: value[index] for path, value in values.items()}
        batch = batch_of(plan, loop, runs[index], filled)
        run = rollouts(
            case.loop,
            batch.gains,
            batch.scenario,
            batch.path,
            case.window.ticks,
            in_axes=batch.in_axes,
            memory=CHUNK_MEMORY,
            devices=devices,
        )
        columns = metric_columns(run.report, case.loop.plant) | flag_columns(run, case.loop.dt)
    simulated = {name: column[: len(runs)] for name, column in columns.items()}
    return parameter_columns(plan.spaces[loop].uncertain, values) | simulated


def _values(plan: SweepPlan, loop: int, runs: np.ndarray) -> dict[str, np.ndarray]:
    """Uncertain values of runs, path -> (n, *shape), drawn once for each row of neighbours."""
    parts = np.split(runs, np.flatnonzero(np.diff(runs) != 1) + 1)
    drawn = [drawn_values(plan, loop, int(part[0]), int(part[-1]) + 1) for part in parts]
    return {path: np.concatenate([values[path] for values in drawn]) for path in drawn[0]}


def _table(
    plan: SweepPlan, loop: int, runs: np.ndarray, columns: dict[str, np.ndarray]
) -> pa.Table:
    name = plan.table["loop"][loop]["name"]
    arrays = {"loop": pa.array([name] * len(runs)).dictionary_encode(), "run": pa.array(runs)}
    for key, column in columns.items():
        missing = column < 0 if key.endswith("_at") else ~np.isfinite(column)
        arrays[key] = pa.array(column, mask=missing)
    return pa.table(arrays).replace_schema_metadata(_metadata(plan, loop))


def _metadata(plan: SweepPlan, loop: int) -> dict[str, str]:
    """What computed these rows. ``devices`` may change the last digits, see `rollouts`."""
    return {
        "configuration": plan.text,
        "configuration_sha256": digest(plan.text),
        "jaxstage": plan.table["jaxstage"],
        "jax": jax.__version__,
        "jaxlib": jaxlib.version.__version__,
        "numpy": np.__version__,
        "python": platform.python_version(),
        "machine": platform.machine(),
        "processor": processor(),
        "devices": str(min(jax.local_device_count(), plan.size)),
        "seed": str(plan.table["seed"]),
        **{key: repr(value) for key, value in scored_columns(plan.cases[loop]).items()},
    }


class SweepProgress(NamedTuple):
    """How far a sweep is, in runs. written: rows of the chunk that has just been kept."""

    done: int
    runs: int
    written: pa.Table


def sweep(
    text: str,
    folder: Path,
    executor: Executor | None = None,
    watch: Callable[[SweepProgress], None] = lambda progress: None,
    cores: int | None = None,
) -> int:
    """Run what is missing of a sweep.

    Stopped at any moment, by a signal, a full disk or a lost machine, the next call does what is
    missing: chunks are whole or absent. Raises what a chunk raised, after keeping those that were
    done.

    Args:
        text: Of `configure_sweep`.
        folder: Made by `store.create`.
        executor: Any; its workers must have jaxstage installed. This process if left out.
        watch: Hears of every chunk that is kept.
        cores: Devices of a worker, see `run_chunk`.

    Returns:
        The number of runs that were missing.
    """
    plan = build(text)
    with store.locked(folder):
        store.remove_leftovers(folder)
        todo = store.missing(folder, plan)
        rows = [stop - start for _, start, stop in map(plan.place, todo)]
        total = plan.table["runs"] * len(plan.cases)
        done = total - sum(rows)
        own = ThreadPoolExecutor(1) if executor is None else None
        pool = executor or own
        assert pool is not None
        futures = {pool.submit(run_chunk, text, index, cores): index for index in todo}
        try:
            for table in _each_done(futures):
                store.write(folder, plan, table.index, table.rows)
                done += table.rows.num_rows
                watch(SweepProgress(done, total, table.rows))
        finally:
            for future in futures:
                future.cancel()
            if own is not None:
                own.shutdown(cancel_futures=True)
    return sum(rows)


class Finished(NamedTuple):
    """A chunk that came back."""

    index: int
    rows: pa.Table


def _each_done(futures: dict[Future[pa.Table], int]) -> Iterable[Finished]:
    """Chunks as they come back; what was handed out is no longer held."""
    for future in as_completed(list(futures)):
        yield Finished(futures.pop(future), future.result())
