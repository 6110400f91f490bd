"""Result store of a sweep: its configuration, and one Parquet file a chunk, whole or absent.

    DIR/sweep.toml                            the configuration
    DIR/runs/dfcmac-circle/00000.parquet      one row a run; Parquet readers take DIR/runs/LOOP

A chunk is written beside its place, flushed to the disk and renamed: whatever stops the process,
files are whole. Nothing but this module writes there.
"""

from collections.abc import Sequence
from contextlib import AbstractContextManager
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from jaxstage.system.files import write_whole
from tuning.store import work_folder as folders
from tuning.store.work_folder import digest
from tuning.sweeps.configuration import SweepPlan

KIND = folders.FolderKind("sweep.toml", "sweep", ("jaxstage", "precision", "runs", "loop"))
RUNS = "runs"


def create(folder: Path, text: str, resume: bool) -> None:
    """Make the folder of a sweep, or take one that holds the same sweep when ``resume``.

    Raises ValueError for a folder that holds something else, another configuration (with what
    differs), or this one without ``resume``; nothing is touched then.
    """
    folders.create(folder, KIND, text, resume)


def read_configuration(folder: Path) -> str:
    """The configuration of a sweep. Raises ValueError where there is none, or a foreign one."""
    return folders.read_configuration(folder, KIND)


def locked(folder: Path) -> AbstractContextManager[None]:
    """Keep other processes from sweeping into the folder. Raises ValueError where one does."""
    return folders.locked(folder, "sweeping")


def chunk_file(folder: Path, plan: SweepPlan, index: int) -> Path:
    """Where a chunk stands."""
    loop, part = divmod(index, plan.chunks)
    return folder / RUNS / plan.table["loop"][loop]["name"] / f"{part:05d}.parquet"


def missing(folder: Path, plan: SweepPlan) -> list[int]:
    """The chunks that are not there, or not whole, or of another configuration."""
    every = range(plan.chunks * len(plan.cases))
    return [index for index in every if not is_whole(folder, plan, index)]


def is_whole(folder: Path, plan: SweepPlan, index: int) -> bool:
    """Whether a chunk is there with all its rows, of this configuration."""
    _, start, stop = plan.place(index)
    try:
        footer = pq.read_metadata(chunk_file(folder, plan, index))
    except (OSError, pa.ArrowInvalid):
        return False
    same = (footer.metadata or {}).get(b"configuration_sha256") == digest(plan.text).encode()
    return same and footer.num_rows == stop - start


def write(folder: Path, plan: SweepPlan, index: int, rows: pa.Table) -> None:
    """Keep a chunk."""
    data = pa.BufferOutputStream()
    pq.write_table(rows, data, compression="zstd")
    file = chunk_file(folder, plan, index)
    file.parent.mkdir(parents=True, exist_ok=True)
    write_whole(file, data.getvalue().to_pybytes())


def present(folder: Path, plan: SweepPlan) -> list[Path]:
    """The files of the chunks that are there, by loop and run."""
    every = range(plan.chunks * len(plan.cases))
    return [chunk_file(folder, plan, i) for i in every if is_whole(folder, plan, i)]


def read(folder: Path, plan: SweepPlan, columns: Sequence[str] | None = None) -> pa.Table:
    """The rows of all chunks that are there, by loop and run. columns: only these.

    Raises ValueError where there are none.
    """
    names = None if columns is None else list(columns)
    tables = [pq.read_table(file, columns=names) for file in present(folder, plan)]
    if not tables:
        raise ValueError(f"{folder} has no runs yet: sweep with --resume goes on with it")
    # laws have metrics of their own: null in the rows of the others
    return pa.concat_tables(tables, promote_options="default").combine_chunks()
