"""Replays: runs of a sweep redrawn from (seed, run), simulated, and held against their rows."""

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import tomli_w

from jaxstage.model.fields import replace
from jaxstage.model.settings import nearest_name
from jaxstage.studies import Case, find
from jaxstage.system.files import write_text
from tuning.store.prepare import Prepared, execute
from tuning.sweeps import store
from tuning.sweeps.analysis import choose_metric, worst_runs
from tuning.sweeps.configuration import SweepPlan, drawn_values
from tuning.sweeps.sweep import simulate_rows
from tuning.uncertainty.case_table import with_values
from tuning.uncertainty.metric_table import FLAGS
from tuning.uncertainty.uncertain_space import run_seed

#: a replay is filled up to so many lanes, so that all of them share one program
LANES = 64


def stored_devices(folder: Path) -> int:
    """The most devices that a chunk of a sweep was computed on. JAX need not have started."""
    devices = [1]
    for file in (folder / store.RUNS).glob("*/*.parquet"):
        with suppress(OSError, pa.ArrowInvalid):  # not whole: no row of it is read
            devices.append(int((pq.read_metadata(file).metadata or {}).get(b"devices", b"1")))
    return max(devices)


class RunSelection(NamedTuple):
    """Runs to replay: one by its number, or the ``worst`` by a metric; of one loop, or of all."""

    run: int | None = None
    worst: int | None = None
    loop: str | None = None
    metric: str | None = None


def select_runs(folder: Path, plan: SweepPlan, chosen: RunSelection) -> list[tuple[int, list[int]]]:
    """Loop and numbers of the selected runs. Raises ValueError for an unknown loop or count."""
    names, loop = [entry["name"] for entry in plan.table["loop"]], chosen.loop
    if loop is not None and loop not in names:
        raise ValueError(f"--loop {loop}: one of {', '.join(names)}{nearest_name(loop, names)}")
    if chosen.run is not None:
        return [(i, [chosen.run]) for i, name in enumerate(names) if loop in (None, name)]
    assert chosen.worst is not None
    if chosen.worst < 1:
        raise ValueError(f"--worst {chosen.worst}: must be >= 1")
    metric = choose_metric(plan, None, chosen.metric)
    runs: dict[int, list[int]] = {}
    for row in worst_runs(folder, plan, metric, chosen.worst, loop):
        runs.setdefault(names.index(row["loop"]), []).append(row["run"])
    return list(runs.items())


def replay(folder: Path, plan: SweepPlan, loop: int, runs: Sequence[int]) -> list[dict[str, Any]]:
    """Simulate some runs of a loop again.

    Returns:
        An object each: parameters and metrics as columns, what became of the run, and whether they
        are ``identical`` to the stored row: same numbers, bit for bit, where versions and devices
        are those of the sweep; None where the row is not there yet.

    Raises:
        ValueError: For a run that the sweep does not have.
    """
    for run in runs:
        if not 0 <= run < plan.table["runs"]:
            raise ValueError(f"--run {run}: must be 0..{plan.table['runs'] - 1}")
    rows = [_stored(folder, plan, loop, run) for run in runs]
    devices = min(jax.local_device_count(), max((row[1] for row in rows if row), default=1))
    lanes = max(len(runs), devices, min(LANES, plan.size))
    columns = simulate_rows(plan, loop, np.asarray(runs), lanes, devices)
    return [
        _object(plan, loop, run, {k: v[i] for k, v in columns.items()}, row)
        for i, (run, row) in enumerate(zip(runs, rows, strict=True))
    ]


def _stored(
    folder: Path, plan: SweepPlan, loop: int, run: int
) -> tuple[dict[str, Any], int] | None:
    """The row of a run and the devices that it was computed on."""
    index = loop * plan.chunks + run // plan.size
    if not store.is_whole(folder, plan, index):
        return None
    table = store.read_rows(store.chunk_file(folder, plan, index))
    devices = int((table.schema.metadata or {}).get(b"devices", b"1"))
    return table.slice(run % plan.size, 1).to_pylist()[0], devices


def _object(
    plan: SweepPlan,
    loop: int,
    run: int,
    columns: dict[str, Any],
    stored: tuple[dict[str, Any], int] | None,
) -> dict[str, Any]:
    plain = {name: _plain(name, value) for name, value in columns.items()}
    drawn = [c for item in plan.spaces[loop].uncertain for c in item.columns]
    return {
        "loop": plan.table["loop"][loop]["name"],
        "run": run,
        "parameters": {name: plain[name] for name in drawn},
        "figures": {k: v for k, v in plain.items() if k not in drawn and k not in FLAGS},
        **{name: plain[name] for name in FLAGS},
        "identical": None if stored is None else all(stored[0][k] == plain[k] for k in plain),
        "largest_difference": None if stored is None else _largest_difference(plain, stored[0]),
    }


def _plain(name: str, value: Any) -> float | int | bool | None:
    """A number as the table would hold it."""
    if name == "finite":
        return bool(value)
    if name.endswith("_at"):
        return int(value) if value >= 0 else None
    return float(value) if np.isfinite(value) else None


def _largest_difference(now: dict[str, Any], then: dict[str, Any]) -> float | None:
    """The largest relative difference of a number; None where one side has none."""
    largest = 0.0
    for name, value in now.items():
        if value == then[name]:
            continue
        if value is None or then[name] is None:
            return None
        largest = max(largest, abs(value - then[name]) / max(abs(value), abs(then[name])))
    return largest


def machine(plan: SweepPlan, loop: int, run: int) -> Case:
    """The case of one run: its plant, its random key."""
    case = plan.cases[loop]
    with jax.enable_x64(plan.table["precision"] == "double"):
        values = drawn_values(plan, loop, run, run + 1)
        case = with_values(case, {path: value[0] for path, value in values.items()})
        key = jax.random.key(run_seed(plan.table["seed"], run))
        return case._replace(scenario=replace(case.scenario, key=key))


def draw_run(plan: SweepPlan, loop: int, run: int, folder: Path) -> None:
    """Write pictures, run.json, gains.toml and scenario.toml of a run, as `jaxstage run` does."""
    case = machine(plan, loop, run)
    with jax.enable_x64(plan.table["precision"] == "double"):
        execute(Prepared(case, find(case.name), ()), folder)
    if plan.table["blocks"]:
        file = folder / "scenario.toml"
        blocks = tomli_w.dumps({"blocks": plan.table["blocks"]})
        write_text(file, file.read_text(encoding="utf-8") + "\n" + blocks)
