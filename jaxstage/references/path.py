"""A lap stored in memory: the setpoint of every tick, and the curve for the contour error.

The contour error is the distance to the nearest point of the continuous curve on the local branch:
commanded arc length within a window around the commanded point. It is found by Newton along the
smooth pieces that the window touches (see `segments`).
"""

# pyright: reportArgumentType=false
# (numpy leaves on the host, JAX arrays once cast)

import functools
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import DTypeLike

from jaxstage.model.blocks import Reference
from jaxstage.model.fields import part, pytree, replace, signal
from jaxstage.model.signals import Nearest, Setpoint
from jaxstage.numerics.geometry import norm, projection_step
from jaxstage.references.arc import ArcTable, arc_at, arc_table, as_double, host_frame, spans
from jaxstage.references.nurbs import Nurbs, in_span, is_closed
from jaxstage.references.segments import (
    Seats,
    Segments,
    lap_seats,
    lap_segments,
    smooth_pieces,
)
from jaxstage.references.timing import LapTiming, Ticks

STEPS = 3  # Newton steps of the nearest point: exact for errors below 1 mm on these contours
WINDOW = 0.01  # of the lap, either side


@pytree
class Path:
    """One lap, sampled. ``length / lap_time`` is the mean feed."""

    setpoint: Setpoint = part("commanded motion, leading axis ticks")
    segments: Segments = part("the curve")
    seats: Seats = part("where each tick sits on it")
    lap_time: Array = signal("s", "T", "duration of a lap")
    length: Array = signal("m", "L", "length of a lap", shown="mm")
    window: Array = signal("m", "", "arc length searched either side", shown="mm")
    closed: Array = signal("1", "", "true when the lap ends where it starts")
    table_error: Array = signal("m", "", "largest distance of the segments from the curve")


def make_path(
    curve: Nurbs, timing: LapTiming, dtype: DTypeLike | None = None, window: float = WINDOW
) -> Path:
    """Sample one lap, in double precision on the host, then cast.

    timing: from `uniform_parameter` or `constant_feed`. dtype: of the floats, JAX's default when
    left out. window: share of the lap, in arc length, searched for the nearest point on either
    side of the commanded point; in (0, 0.25], else ValueError.
    """
    if not 0 < window <= 0.25:
        raise ValueError(f"window must be in (0, 0.25] of a lap; got {window!r}")
    curve = as_double(curve)
    leaves, structure = jax.tree.flatten(curve)
    key = (structure, tuple((leaf.shape, leaf.tobytes()) for leaf in leaves))
    table, segments, unrolled, rows, error, endless = _cut(key)
    moments = _ticks(key, timing)
    shifts = (-1, 0, 1) if is_closed(curve) and not endless else (0,)
    seats = lap_seats(segments, unrolled, rows, moments.arc, table.arc[-1], window, shifts)
    path = Path(
        setpoint=_setpoints(curve, moments), segments=segments,
        seats=seats, lap_time=moments.lap_time,
        length=table.arc[-1], window=np.asarray(window * table.arc[-1]),
        closed=np.asarray(is_closed(curve)), table_error=error,
    )  # fmt: skip
    real = jnp.zeros(()).dtype if dtype is None else np.dtype(dtype)
    return jax.tree.map(
        lambda x: jnp.asarray(x, real if np.issubdtype(x.dtype, np.floating) else x.dtype), path
    )


class _Cut(NamedTuple):
    """What depends on the curve alone. unrolled, rows, error: see `lap_segments`."""

    table: ArcTable
    segments: Segments
    unrolled: np.ndarray
    rows: np.ndarray
    error: np.ndarray
    endless: bool


#: structure of a curve, and the shape and the bytes of each of its arrays
_Key = tuple[Any, tuple[tuple[tuple[int, ...], bytes], ...]]


def _curve(key: _Key) -> Nurbs:
    arrays = [np.frombuffer(data).reshape(shape) for shape, data in key[1]]
    return jax.tree.unflatten(key[0], arrays)


@functools.lru_cache(maxsize=32)
def _cut(key: _Key) -> _Cut:
    """The table and the segments of a float64 curve, made once for equal curves."""
    curve = _curve(key)
    table = arc_table(curve)
    bounds = arc_at(curve, table, curve.knots[np.append(spans(curve), len(curve.weights))])
    pieces, endless = smooth_pieces(curve)
    return _Cut(table, *lap_segments(curve, table, bounds, pieces), endless)


@functools.lru_cache(maxsize=8)
def _ticks(key: _Key, timing: LapTiming) -> Ticks:
    """The ticks of a lap, made once for equal curves and the same timing."""
    return timing(_curve(key), _cut(key).table)


def mean_feed(path: Path) -> Array:
    """Length over lap time in m/s: the actual feed of `constant_feed`."""
    return path.length / path.lap_time


def _setpoints(curve: Nurbs, moments: Ticks) -> Setpoint:
    """r' = C' u', r'' = C'' u'^2 + C' u''."""
    _, first, second = in_span(curve, moments.span, moments.u)
    position, tangent, curvature = host_frame(curve, moments.span, moments.u)
    rate = moments.rate[:, None]
    return Setpoint(
        position=position, velocity=first * rate, tangent=tangent, curvature=curvature,
        acceleration=second * rate**2 + first * moments.acceleration[:, None],
    )  # fmt: skip


def sample(path: Path, tick: Array) -> Setpoint:
    """The setpoint of tick mod n. tick: () integer."""
    row = tick % path.seats.corner.shape[0]
    return jax.tree.map(lambda x: _row(x, row), path.setpoint)


def nearest(path: Path, tick: Array, position: Array) -> Nearest:
    """The nearest point of the curve within the window around the commanded point of a tick.

    By `STEPS` Newton steps along the smooth piece of the tick, and of each piece that begins in
    the window. Differentiable in ``position`` (axes,) m, with gradient 0 at distance 0. Valid
    for errors up to about half the smallest radius of curvature. tick: () integer.
    """
    row = tick % path.seats.corner.shape[0]
    base, start, low, high = (
        _row(x, row) for x in (path.seats.base, path.seats.start, path.seats.low, path.seats.high)
    )

    # only the choice is under the condition, and it has no derivative: JAX cannot transpose the
    # derivative of a condition that differs from run to run
    near = partial(_near, *jax.lax.stop_gradient((path.segments, base, start, low, high, position)))
    if base.shape[0] == 1:
        piece, y = near(1)
    else:
        everything = partial(near, base.shape[0])
        corner = _row(path.seats.corner, row)
        piece, y = jax.lax.cond(corner, everything, partial(near, 1))
    found = _arrive(path.segments, base[piece], low[piece], high[piece], position, y)
    return replace(found, reach=path.window)


def period(path: Path) -> Array:
    """Time between two ticks in s."""
    return path.lap_time / path.seats.corner.shape[0]


def _row(x: Array, row: Array) -> Array:
    return jax.lax.dynamic_index_in_dim(x, row, keepdims=False, allow_negative_indices=False)


def _near(
    segments: Segments, base: Array, start: Array, low: Array, high: Array, position: Array,
    count: int,
) -> tuple[Array, Array]:  # fmt: skip
    """Which of the first pieces is the closest, and the coordinate on it before the last step."""

    def on(i: int) -> tuple[Array, Array]:
        y = start[i]
        for _ in range(STEPS - 1):
            y, *_ = _step(segments, base[i], low[i], high[i], position, y)
        distance = _arrive(segments, base[i], low[i], high[i], position, y).distance
        return distance, y

    piece = jnp.zeros((), jnp.int32)
    distance, y = on(0)
    for i in range(1, count):
        other, there = on(i)
        closer = other < distance
        piece, distance = jnp.where(closer, i, piece), jnp.where(closer, other, distance)
        y = jnp.where(closer, there, y)
    return piece, y


def _step(
    segments: Segments, base: Array, low: Array, high: Array, position: Array, y: Array
) -> tuple[Array, Array, Array, Array]:
    """A Newton step in the coordinate y, clamped to [low, high]; and where it began: the index of
    the segment, its coefficients and its start.

    Offsets are taken from the start of the segment, so single precision loses nothing.
    """
    whole = jnp.clip(jnp.floor(y), jnp.floor(low), jnp.ceil(high) - 1)
    index = base + whole.astype(jnp.int32)
    c = segments.cubic.at[index].get(mode="clip")
    f = y - whole
    offset = (position - c[0]) - f * (c[1] + f * (c[2] + f * c[3]))
    first = c[1] + f * (2 * c[2] + 3 * f * c[3])
    new = y + projection_step(offset, first, 2 * c[2] + 6 * f * c[3])
    return jnp.clip(new, low, high), index, c, whole


def _arrive(
    segments: Segments, base: Array, low: Array, high: Array, position: Array, y: Array
) -> Nearest:
    """The last step, which carries the gradient, and the point that it leads to."""
    y, index, c, whole = _step(segments, base, low, high, position, y)
    f = y - whole
    along = f * (c[1] + f * (c[2] + f * c[3]))
    return Nearest(
        point=c[0] + along,
        distance=norm((position - c[0]) - along),
        arc=segments.arc.at[index].get(mode="clip")
        + f * segments.length.at[index].get(mode="clip"),
        reach=jnp.full_like(position[0], jnp.inf),
    )


sampled = Reference(name="sampled", sample=sample, nearest=nearest, period=period)
