"""Result store of a sweep: its configuration, and one Parquet file a chunk, whole or absent.

    DIR/sweep.toml                            the configuration
    DIR/runs/dfcmac-circle/00000.parquet      one row a run; Parquet readers take DIR/runs/LOOP

A chunk is written beside its place, flushed to the disk and renamed: whatever stops the process,
files are whole. A checksum covers the file, and one each page: what the disk spoilt counts as
missing. Nothing but this module writes there.
"""

import functools
import hashlib
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
#: in the metadata of a chunk: SHA-256 of the rest of the file
SEAL = b"file_sha256"


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


def remove_leftovers(folder: Path) -> None:
    """Remove what killed writers left unfinished. Only for who holds the lock."""
    for file in folder.rglob(".*.partial"):
        file.unlink(missing_ok=True)


def missing(folder: Path, plan: SweepPlan) -> list[int]:
    """The chunks that are not there, or not whole, or of another configuration."""
    every = range(plan.chunks * len(plan.cases))
    return [index for index in every if not is_whole(folder, plan, index)]


def is_whole(folder: Path, plan: SweepPlan, index: int) -> bool:
    """Whether a chunk is there with all its rows, as they were written, of this configuration."""
    _, start, stop = plan.place(index)
    file = chunk_file(folder, plan, index)
    try:
        status = file.stat()
    except OSError:
        return False
    content = _content(file, status.st_size, status.st_mtime_ns)
    return content == (digest(plan.text), stop - start)


@functools.lru_cache(maxsize=65536)
def _content(file: Path, size: int, changed: int) -> tuple[str, int] | None:
    """Configuration and number of rows of a file that is as it was written; None for any other.
    size, changed: of the file, which is read again when they differ."""
    try:
        data = file.read_bytes()
        if data != _sealed(data):
            return None
        footer = pq.read_metadata(pa.BufferReader(data))
    except (OSError, ValueError):
        return None
    name = (footer.metadata or {}).get(b"configuration_sha256", b"")
    return name.decode(errors="replace"), footer.num_rows


def _sealed(data: bytes) -> bytes:
    """A Parquet file with the SHA-256 of itself, that number left out, in its metadata. Raises
    ValueError for one without a place for it."""
    begin = data.rindex(SEAL) + len(SEAL)
    begin = data.index(b"0x", begin) + 2
    end = begin + 64
    sum_ = hashlib.sha256(data[:begin] + data[end:]).hexdigest()
    return data[:begin] + sum_.encode() + data[end:]


def read_rows(file: Path, columns: Sequence[str] | None = None) -> pa.Table:
    """The rows of a file, its checksums verified. columns: only these, where it has them."""
    with pq.ParquetFile(file, page_checksum_verification=True) as parquet:
        return parquet.read(None if columns is None else list(columns))


def write(folder: Path, plan: SweepPlan, index: int, rows: pa.Table) -> None:
    """Keep a chunk."""
    data = pa.BufferOutputStream()
    seal = {SEAL: b"0x" + 64 * b"0"}
    rows = rows.replace_schema_metadata({**(rows.schema.metadata or {}), **seal})
    pq.write_table(rows, data, compression="zstd", write_page_checksum=True)
    file = chunk_file(folder, plan, index)
    file.parent.mkdir(parents=True, exist_ok=True)
    write_whole(file, _sealed(data.getvalue().to_pybytes()))


def present(folder: Path, plan: SweepPlan) -> list[Path]:
    """The files of the chunks that are there, by loop and run."""
    every = range(plan.chunks * len(plan.cases))
    return [chunk_file(folder, plan, i) for i in every if is_whole(folder, plan, i)]


def read(folder: Path, plan: SweepPlan, columns: Sequence[str] | None = None) -> pa.Table:
    """The rows of all chunks that are there, by loop and run. columns: only these.

    Raises ValueError where there are none.
    """
    tables = [read_rows(file, columns) for file in present(folder, plan)]
    if not tables:
        raise ValueError(f"{folder} has no runs yet: sweep with --resume goes on with it")
    # laws have metrics of their own: null in the rows of the others
    return pa.concat_tables(tables, promote_options="default").combine_chunks()
