"""Experimental designs: which points of the unit cube are run.

A design is a function (seed, runs, dimensions, start, stop) -> rows start..stop-1, (stop - start,
dimensions) in [0, 1]. Row i depends on (seed, runs, i) alone, for `random` and `sobol` on
(seed, i): never on how rows are grouped or where they are computed.
"""

import functools
import warnings
from collections.abc import Callable

import numpy as np
from scipy.stats import qmc

from jaxstage.model.fields import definition
from tuning.uncertainty.distributions import Distribution

#: corners of more uncertain values are not run
MOST_CORNERS = 20
_WORDS = 4  # numbers a step of the Philox counter gives


def random_rows(seed: int, runs: int, dimensions: int, start: int, stop: int) -> np.ndarray:
    """Simple random sample: row i has its own place in the Philox sequence of the seed
    (Salmon et al., SC 2011)."""
    steps = -(-dimensions // _WORDS)
    source = np.random.Generator(np.random.Philox(key=seed).advance(start * steps))
    return source.random((stop - start, steps * _WORDS))[:, :dimensions]


@functools.lru_cache(maxsize=2)
def _hypercube(seed: int, runs: int, dimensions: int) -> np.ndarray:
    return qmc.LatinHypercube(dimensions, rng=np.random.default_rng(seed)).random(runs)


def hypercube_rows(seed: int, runs: int, dimensions: int, start: int, stop: int) -> np.ndarray:
    """Latin hypercube: each value has one point in each of ``runs`` equal slices
    (McKay, Beckman and Conover, Technometrics 21, 1979)."""
    return _hypercube(seed, runs, dimensions)[start:stop]


def sobol_rows(seed: int, runs: int, dimensions: int, start: int, stop: int) -> np.ndarray:
    """Scrambled Sobol sequence (Owen, J. Complexity 14, 1998); balanced when ``runs`` is a power
    of 2."""
    source = qmc.Sobol(dimensions, scramble=True, rng=np.random.default_rng(seed))
    if start:
        source.fast_forward(start)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of numbers that are no power of 2
        return source.random(stop - start)


def corner_rows(seed: int, runs: int, dimensions: int, start: int, stop: int) -> np.ndarray:
    """Full factorial design of two levels: bit d of the row's number is value d."""
    bits = np.arange(start, stop)[:, None] >> np.arange(dimensions)
    return (bits & 1).astype(float)


@functools.lru_cache(maxsize=2)
def _saltelli(seed: int, base: int, dimensions: int) -> np.ndarray:
    """(base, dimensions + 2, dimensions): A, A with each column in turn of B, B."""
    both = sobol_rows(seed, base, 2 * dimensions, 0, base)
    a, b = both[:, :dimensions], both[:, dimensions:]
    mixed = np.repeat(a[:, None], dimensions, axis=1)
    each = np.arange(dimensions)
    mixed[:, each, each] = b
    return np.concatenate([a[:, None], mixed, b[:, None]], axis=1)


def saltelli_rows(seed: int, runs: int, dimensions: int, start: int, stop: int) -> np.ndarray:
    """Saltelli design: blocks of dimensions + 2 rows for Sobol indices, as SALib orders them
    (Saltelli et al., Comput. Phys. Commun. 181, 2010)."""
    base = runs // (dimensions + 2)
    return _saltelli(seed, base, dimensions).reshape(-1, dimensions)[start:stop]


def _any(runs: int, dimensions: int) -> None:
    """Every number of runs is fine."""


def _sobol_runs(runs: int, dimensions: int) -> None:
    if dimensions > qmc.Sobol.MAXDIM:
        raise ValueError(f"{dimensions} uncertain values: sobol has at most {qmc.Sobol.MAXDIM}")


def _corner_runs(runs: int, dimensions: int) -> None:
    if dimensions > MOST_CORNERS:
        raise ValueError(
            f"{dimensions} uncertain values have 2^{dimensions} corners: at most {MOST_CORNERS} "
            "values (shared = true draws one value for all axes)"
        )
    if runs != 2**dimensions:
        raise ValueError(f"-n {runs}: {dimensions} uncertain values have {2**dimensions} corners")


def _saltelli_runs(runs: int, dimensions: int) -> None:
    block = dimensions + 2
    base = runs // block
    if runs % block or base < 2 or base & (base - 1):
        near = 2 ** max(1, round(np.log2(max(runs / block, 1))))
        raise ValueError(
            f"-n {runs}: saltelli with {dimensions} uncertain values needs 2^k x {block} runs, "
            f"e.g. {near * block}"
        )


@definition
class Design:
    """A design of experiments.

    Attributes:
        rows: (seed, runs, dimensions, start, stop) -> points, see the module.
        allowed: (runs, dimensions); raises ValueError for a number of runs that does not fit.
        sample: Rows i with i % sample(dimensions) == 0 are a sample of the distribution; None where
            no rows are, so that no probability can be estimated.
        values: Values of a distribution at the numbers of the rows.
    """

    name: str
    rows: Callable[[int, int, int, int, int], np.ndarray]
    allowed: Callable[[int, int], None]
    sample: Callable[[int], int] | None
    values: Callable[[Distribution, np.ndarray], np.ndarray]


def _quantiles(distribution: Distribution, rows: np.ndarray) -> np.ndarray:
    return distribution.quantile(rows)


def _ends(distribution: Distribution, rows: np.ndarray) -> np.ndarray:
    return np.where(rows > 0.5, distribution.high, distribution.low)


def _every(dimensions: int) -> int:
    return 1


def _block(dimensions: int) -> int:
    return dimensions + 2


_FREE = {"sample": _every, "values": _quantiles}

_ALL = (
    Design(name="random", rows=random_rows, allowed=_any, **_FREE),
    Design(name="lhs", rows=hypercube_rows, allowed=_any, **_FREE),
    Design(name="sobol", rows=sobol_rows, allowed=_sobol_runs, **_FREE),
    Design(name="corners", rows=corner_rows, allowed=_corner_runs, sample=None, values=_ends),
    Design(
        name="saltelli",
        rows=saltelli_rows,
        allowed=_saltelli_runs,
        sample=_block,
        values=_quantiles,
    ),
)
#: by the names that ``--design`` takes
DESIGNS = {design.name: design for design in _ALL}
