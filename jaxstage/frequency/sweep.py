"""Sine sweep of the full loop: what a spectrum analyser on the drive would measure.

    S^(j w) = sum_k (u_k(a) - u_k(0)) e^{-2 pi j n k/M} / sum_k a sin(2 pi n k/M) e^{-2 pi j n k/M}

over the last M control periods; u is what reaches the plant, w = 2 pi n/(M dt). The run without
the sine is subtracted, since a law that still adapts drifts. The amplitude matters where the loop
is not linear (a describing function): dry friction at rest, switching, quantisation, limits.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxstage.frequency.wrappers import Oscillating, oscillating
from jaxstage.model.blocks import Loop, Metric, scan
from jaxstage.model.fields import replace
from jaxstage.model.signals import Sample, Scenario
from jaxstage.simulate.rollout import lost, simulate

#: control periods of a window, and before it
WINDOW = 2000
SETTLE = 2000


class SineResponse(NamedTuple):
    """What a sine sweep of one axis measured.

    Attributes:
        amplitude: (a,) in the unit of the command.
        omega: (w,) rad/s.
        sensitivity: (a, w) complex, S of that axis; NaN where the run was lost.
        harmonics: (a, w) RMS of the second and third harmonic over the fundamental: 0 where the
            loop is linear.
        lost: (a, w) whether the run left its path or stopped being finite.
    """

    amplitude: np.ndarray
    omega: np.ndarray
    sensitivity: np.ndarray
    harmonics: np.ndarray
    lost: np.ndarray


def whole_turns(low: float, high: float, count: int, dt: float, window: int = WINDOW) -> np.ndarray:
    """Turns in a window for up to ``count`` frequencies from ``low`` to ``high`` in Hz."""
    turns = np.geomspace(low, high, count) * window * dt
    return np.unique(np.clip(np.round(turns), 1, window // 2 - 1).astype(np.int32))


def sine_sweep(
    loop: Loop,
    gains: Any,
    scenario: Scenario,
    path: Any,
    axis: int,
    amplitudes: Sequence[float],
    turns: Sequence[int] | np.ndarray,
    window: int = WINDOW,
    settle: int = SETTLE,
) -> SineResponse:
    """Simulate the loop with a sine added to what reaches the plant, for every amplitude and turn.

    Args:
        loop: the loop.
        gains: of its controller.
        scenario: its uncertain part.
        path: the motion during the sweep, for example of `straight`.
        axis: number of the axis that is excited and measured.
        amplitudes: (a,) in the unit of the command, > 0.
        turns: (w,) whole periods in the window, 1 .. window/2 - 1.
        window: control periods that are analysed.
        settle: control periods before them.

    Returns:
        The measured sensitivities. All runs are one batch.

    Raises:
        ValueError: for an amplitude that is not > 0 or a number of turns out of range.
    """
    a, n = np.asarray(amplitudes, float), np.asarray(turns, np.int32)
    if a.size and not (np.isfinite(a).all() and a.min() > 0):
        raise ValueError(f"amplitudes {a.tolist()}: must be > 0")
    if not n.size or n.min() < 1 or n.max() >= window / 2:
        raise ValueError(f"turns must be 1..{window // 2 - 1} in a window of {window} periods")
    axes = len(loop.plant.axes)
    excited = replace(loop, drive=oscillating(loop.drive), metric=_applied(axis), engine=scan)

    def run(amplitude: jax.Array, turn: jax.Array) -> tuple[jax.Array, jax.Array]:
        drive = Oscillating(
            amplitude=jnp.zeros(axes).at[axis].set(amplitude),
            turns=turn,
            window=jnp.asarray(window, jnp.int32),
            drive=scenario.drive,
        )
        done = simulate(excited, gains, replace(scenario, drive=drive), path, settle + window)
        return done.rows[-window:], lost(done.final)

    pairs = np.array([(x, k) for x in (0.0, *a) for k in (n if x else n[:1])])
    rows, gone = jax.vmap(run)(jnp.asarray(pairs[:, 0]), jnp.asarray(pairs[:, 1], jnp.int32))
    difference = np.asarray(rows[1:] - rows[:1]).reshape(len(a), len(n), window)
    bad = np.asarray(gone[1:] | gone[0]).reshape(len(a), len(n))
    tick = (np.arange(settle, settle + window)[None] * n[:, None].astype(np.int64)) % window
    angle = 2 * np.pi * tick / window

    def bin_of(harmonic: int) -> np.ndarray:
        return (difference * np.exp(-1j * harmonic * angle)).sum(-1)

    driven = a[:, None] * (np.sin(angle) * np.exp(-1j * angle)).sum(-1)
    first = np.where(bad, np.nan, bin_of(1))
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.sqrt(np.abs(bin_of(2)) ** 2 + np.abs(bin_of(3)) ** 2) / np.abs(first)
    omega = 2 * np.pi * n / (window * loop.dt)
    return SineResponse(a, omega, first / driven, share, bad)


def _applied(axis: int) -> Metric:
    def update(acc: tuple[()], sample: Sample, dt: float) -> tuple[tuple[()], jax.Array]:
        return (), sample.applied[axis]

    return Metric(
        name="applied", init=lambda first: (), update=update, finish=lambda acc: jnp.zeros(())
    )
