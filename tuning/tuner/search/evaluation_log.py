"""Every evaluation of a tuning, kept: what was asked, what came back, how long it took.

A method depends on nothing but the answers that it gets. So a tuning that was stopped, by whatever,
is taken up by running it again with the answers that are kept: it asks the same questions, gets the
same answers without simulating, and goes on where none is kept. One file an answer, whole or
absent:

    FOLDER/00000.npz    what is tuned
    FOLDER/00001.npz    the first answer
"""

import hashlib
import io
import time
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxstage.system.files import write_whole
from tuning.tuner.problem.problem import Problem

Answer = dict[str, np.ndarray]


def keep(
    folder: Path | None, index: int, question: str, ask: Callable[[], Mapping[str, Any]]
) -> tuple[Answer, float]:
    """The kept answer to the index-th question, or a new one, and the seconds that it took.

    Raises ValueError when the folder holds the answer to another question.
    """
    file = None if folder is None else folder / f"{index:05d}.npz"
    kept = None if file is None else _read(file)
    if kept is not None:
        if str(kept.pop("question")) != question:
            raise ValueError(
                f"{folder} holds the evaluations of another tuning (the first that differs is "
                f"{index}): give another folder"
            )
        return kept, float(kept.pop("seconds"))
    begin = time.perf_counter()
    answer = {name: np.asarray(value) for name, value in ask().items()}
    seconds = time.perf_counter() - begin
    if file is not None:
        file.parent.mkdir(parents=True, exist_ok=True)
        data = io.BytesIO()
        record: dict[str, Any] = {"question": question, "seconds": seconds, **answer}
        np.savez(data, **record)
        write_whole(file, data.getvalue())
    return answer, seconds


def _read(file: Path) -> Answer | None:
    try:
        with np.load(file, allow_pickle=False) as found:
            return {name: found[name] for name in found.files}
    except (FileNotFoundError, zipfile.BadZipFile, ValueError, OSError):
        return None


def digest(*parts: Any) -> str:
    """The name of a question: of texts, numbers and arrays."""
    total = hashlib.sha256()
    for part in parts:
        raw = part.tobytes() if isinstance(part, np.ndarray) else repr(part).encode()
        total.update(len(raw).to_bytes(8, "little") + raw)
    return total.hexdigest()[:32]


def fingerprint(problem: Problem) -> str:
    """The name of a problem: what is searched, in what runs, for what."""
    space = [
        (e.path, e.transform.name, e.tied, part.tobytes())
        for e in problem.space.entries
        for part in (e.low, e.high, e.before)
    ]
    runs = [
        (g.name, g.case.name, g.case.loop.dt, g.case.window, g.weights.tobytes(), g.runs)
        for g in problem.groups
    ]
    goals = [goal.text for goal in problem.goals]
    return digest(
        space,
        runs,
        problem.terms,
        goals,
        problem.risk.name,
        problem.weights,
        problem.scales,
        *(_plain(leaf) for leaf in jax.tree.leaves((problem.space.gains, problem.data))),
    )


def _plain(leaf: Any) -> np.ndarray:
    key = jnp.issubdtype(jnp.asarray(leaf).dtype, jax.dtypes.prng_key)
    return np.ascontiguousarray(jax.random.key_data(leaf) if key else leaf)
