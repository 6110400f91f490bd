"""Evaluation log: every evaluation of a search on disk, so that a stopped search can go on.

A method depends on nothing but the answers of its oracle (deterministic replay). A search that was
stopped, by whatever, is run again: it asks the same questions, gets the logged answers without
simulating, and simulates from where the log ends. One file an answer, whole or absent:

    FOLDER/00000.npz    what is tuned
    FOLDER/00001.npz    the cost model
    FOLDER/00002.npz    the first answer

A file that cannot be read, or whose checksum is not that of its arrays, counts as absent: its
answer is computed again.
"""

import hashlib
import io
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxstage.system.files import write_whole
from tuning.tuner.problem.problem import Problem

Answer = dict[str, np.ndarray]
#: name of the checksum among the arrays of a file
CHECKSUM = "checksum"


def logged(
    folder: Path | None, index: int, question: str, compute: Callable[[], Mapping[str, Any]]
) -> tuple[Answer, float]:
    """The logged answer to a question, else a new one, which is logged.

    Args:
        folder: of the log; None keeps nothing.
        index: of the question in the search, from 0.
        question: its `digest`.
        compute: gives a new answer: arrays by name.

    Returns:
        The answer, and the seconds that it took when it was computed.

    Raises:
        ValueError: the folder holds the answer to another question.
    """
    file = None if folder is None else folder / f"{index:05d}.npz"
    record = None if file is None else _read(file)
    if record is not None:
        if str(record.pop("question")) != question:
            raise ValueError(
                f"{folder} holds the evaluations of another tuning (the first that differs is "
                f"{index}): give another folder"
            )
        return record, float(record.pop("seconds"))
    begin = time.perf_counter()
    answer = {name: np.asarray(value) for name, value in compute().items()}
    seconds = time.perf_counter() - begin
    if file is not None:
        file.parent.mkdir(parents=True, exist_ok=True)
        data = io.BytesIO()
        record = {"question": np.array(question), "seconds": np.array(seconds), **answer}
        written: dict[str, Any] = {**record, CHECKSUM: np.array(_checksum(record))}
        np.savez(data, **written)
        write_whole(file, data.getvalue())
    return answer, seconds


def _read(file: Path) -> Answer | None:
    """The record of a file; None where there is none, or it is damaged."""
    try:
        with np.load(file, allow_pickle=False) as arrays:
            record = {name: arrays[name] for name in arrays.files}
            whole = str(record.pop(CHECKSUM)) == _checksum(record)
    except Exception:  # of a damaged archive nearly any: of the zip, of its codecs, of the header
        return None
    return record if whole else None


def _checksum(record: Answer) -> str:
    """`digest` of the arrays of a record, their names, types and shapes."""
    parts = [(n, str(a.dtype), a.shape, np.ascontiguousarray(a)) for n, a in sorted(record.items())]
    return digest(*(part for parts_of_one in parts for part in parts_of_one))


def digest(*parts: Any) -> str:
    """SHA-256 (first 128 bits) of texts, numbers and arrays: the name of a question."""
    total = hashlib.sha256()
    for part in parts:
        raw = part.tobytes() if isinstance(part, np.ndarray) else repr(part).encode()
        total.update(len(raw).to_bytes(8, "little") + raw)
    return total.hexdigest()[:32]


def fingerprint(problem: Problem) -> str:
    """`digest` of a problem: what is searched, in what runs, for what objective."""
    space = [
        (e.path, e.transform.name, e.tied, part.tobytes())
        for e in problem.space.entries
        for part in (e.low, e.high, e.before)
    ]
    runs = [
        (g.name, g.case.name, g.case.loop.dt, g.case.window, g.weights.tobytes(), g.runs)
        for g in problem.groups
    ]
    terms, goals, risk = problem.objective
    numbers = problem.weights, problem.scales
    leaves = map(_plain, jax.tree.leaves((problem.space.gains, problem.data)))
    return digest(space, runs, terms, [goal.text for goal in goals], risk.name, *numbers, *leaves)


def _plain(leaf: Any) -> np.ndarray:
    key = jnp.issubdtype(jnp.asarray(leaf).dtype, jax.dtypes.prng_key)
    return np.ascontiguousarray(jax.random.key_data(leaf) if key else leaf)
