"""Stored tool path: the setpoint of every tick of a lap, and the curve for the contour error.

The contour error is the distance to the nearest point of the continuous curve on the local branch:
commanded arc length within a window around the commanded point. Newton along the smooth pieces
that the window touches gives it (see `segments`).
"""

# pyright: reportArgumentType=false
# (numpy leaves on the host, JAX arrays once cast)

import functools
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import DTypeLike

from jaxstage.model.blocks import Reference
from jaxstage.model.fields import part, pytree, replace, signal
from jaxstage.model.signals import Nearest, Setpoint
from jaxstage.numerics.geometry import norm, projection_step
from jaxstage.references.arc import ArcTable, arc_table, as_double, moving_spans
from jaxstage.references.frame import Frame, host_frame
from jaxstage.references.nearest import settled
from jaxstage.references.nurbs import Nurbs, in_span, is_closed
from jaxstage.references.segments import (
    LapTable,
    SearchWindows,
    Segments,
    lap_table,
    search_windows,
)
from jaxstage.references.timing import LapTiming, Ticks

STEPS = 3  # Newton steps of the nearest point: exact for errors below 1 mm on these contours
WINDOW = 0.01  # of the lap, either side


@pytree
class Path:
    """One lap of a tool path, sampled. ``length / lap_time`` is the mean feed."""

    setpoint: Setpoint = part("commanded motion, leading axis ticks")
    segments: Segments = part("the curve")
    search: SearchWindows = part("where the nearest point is searched, each tick")
    lap_time: Array = signal("s", "T", "duration of a lap")
    length: Array = signal("m", "L", "length of a lap", shown="mm")
    window: Array = signal("m", "", "arc length searched either side", shown="mm")
    closed: Array = signal("1", "", "true when the lap ends where it starts")
    table_error: Array = signal("m", "", "largest distance of the segments from the curve")


def make_path(
    curve: Nurbs, timing: LapTiming, dtype: DTypeLike | None = None, window: float = WINDOW
) -> Path:
    """Sample one lap, in double precision on the host, then cast.

    Args:
        curve: the tool path.
        timing: from `uniform_parameter` or `constant_feed`.
        dtype: of the floats; JAX's default when left out.
        window: share of the lap, in arc length, searched for the nearest point on either side of
            the commanded point; in (0, 0.25].

    Raises:
        ValueError: for a window out of range, or a timing that the curve does not allow.
    """
    if not 0 < window <= 0.25:
        raise ValueError(f"window must be in (0, 0.25] of a lap; got {window!r}")
    curve = as_double(curve)
    leaves, structure = jax.tree.flatten(curve)
    key = (structure, tuple((leaf.shape, leaf.tobytes()) for leaf in leaves))
    lap, moments, closed = _tables(key)[1], _ticks(key, timing), is_closed(curve)
    path = Path(
        setpoint=_setpoints(curve, moments),
        segments=lap.segments,
        search=search_windows(lap, moments.arc, window, closed),
        lap_time=moments.lap_time,
        length=lap.length,
        window=np.asarray(window * lap.length),
        closed=np.asarray(closed),
        table_error=lap.error,
    )
    real = jnp.zeros(()).dtype if dtype is None else np.dtype(dtype)
    return jax.tree.map(
        lambda x: jnp.asarray(x, real if np.issubdtype(x.dtype, np.floating) else x.dtype), path
    )


#: structure of a curve, and the shape and the bytes of each of its arrays
_Key = tuple[jax.tree_util.PyTreeDef, tuple[tuple[tuple[int, ...], bytes], ...]]


def _curve(key: _Key) -> Nurbs:
    arrays = [np.frombuffer(data).reshape(shape) for shape, data in key[1]]
    return jax.tree.unflatten(key[0], arrays)


@functools.lru_cache(maxsize=32)
def _tables(key: _Key) -> tuple[ArcTable, LapTable]:
    """What depends on a float64 curve alone, made once for equal curves."""
    curve = _curve(key)
    table = arc_table(curve)
    return table, lap_table(curve, table)


@functools.lru_cache(maxsize=8)
def _ticks(key: _Key, timing: LapTiming) -> Ticks:
    """The ticks of a lap, made once for equal curves and the same timing."""
    return timing(_curve(key), _tables(key)[0])


def mean_feed(path: Path) -> Array:
    """Mean feed, length over lap time, () m/s: the actual feed of `constant_feed`."""
    return path.length / path.lap_time


def _setpoints(curve: Nurbs, moments: Ticks) -> Setpoint:
    """r' = C' u', r'' = C'' u'^2 + C' u''; with a constant feed where C' -> 0, r' = v t and
    r'' = v^2 kappa n."""
    position, first, second = in_span(curve, moments.span, moments.u)
    frame, rate = _frame(curve, moments), moments.rate[:, None]
    by_arc = (frame.near_zero & np.isfinite(moments.feed))[:, None]
    return Setpoint(
        position=position,
        velocity=np.where(by_arc, moments.feed * frame.tangent, first * rate),
        acceleration=np.where(
            by_arc,
            moments.feed**2 * frame.bend,
            second * rate**2 + first * moments.acceleration[:, None],
        ),
        tangent=frame.tangent,
        curvature=frame.curvature,
    )


def _frame(curve: Nurbs, moments: Ticks) -> Frame:
    """Frame of each tick; on a span without length that of the next one that has one."""
    moving, last = moving_spans(curve), curve.knots[-1]
    place = np.searchsorted(moving, moments.span)
    still = ~np.isin(moments.span, moving)
    span = np.where(still, moving[place % len(moving)], moments.span)
    u = np.where(still, curve.knots[span], moments.u)
    frame = host_frame(curve, span, u)
    after = still & (place == len(moving))
    if after.any() and not is_closed(curve):
        frame.tangent[after] = host_frame(curve, moving[-1:], np.array([last]), side=-1).tangent
        frame.bend[after] = 0.0
    frame.near_zero[still] = True
    return frame


def sample(path: Path, tick: Array) -> Setpoint:
    """Setpoint of tick mod n. tick: () integer."""
    row = tick % path.search.corner.shape[0]
    return jax.tree.map(lambda x: _row(x, row), path.setpoint)


def nearest(path: Path, tick: Array, position: Array) -> Nearest:
    """Nearest point of the curve within the window around the commanded point of a tick.

    By `STEPS` Newton steps along the smooth piece of the tick, and of each piece that begins in
    the window. They settle for errors up to about half the smallest radius of curvature; beyond,
    where the last one still lowers the distance, `reach` is 0.

    Args:
        path: the stored lap.
        tick: () integer.
        position: of the tool, (axes,) m.

    Returns:
        The point; `reach`: the window. Differentiable in ``position``, with gradient 0 at
        distance 0.
    """
    row = tick % path.search.corner.shape[0]
    stretch = _Stretch(
        path.segments, *(_row(getattr(path.search, name), row) for name in _Stretch._fields[1:])
    )

    # only the choice is under the condition, and it has no derivative: JAX cannot transpose the
    # derivative of a condition that differs from run to run
    near = partial(_near, *jax.lax.stop_gradient((stretch, position)))
    if stretch.base.shape[0] == 1:
        piece, y = near(1)
    else:
        everything = partial(near, stretch.base.shape[0])
        corner = _row(path.search.corner, row)
        piece, y = jax.lax.cond(corner, everything, partial(near, 1))
    point = _arrive(stretch.on(piece), position, y)
    return replace(point, reach=jnp.minimum(point.reach, path.window))


class _Stretch(NamedTuple):
    """The search window of a tick: fields of `SearchWindows`, (pieces,) each."""

    segments: Segments
    base: Array
    start: Array
    low: Array
    high: Array

    def on(self, piece: Array | int) -> "_Stretch":
        """The window on one piece, () each."""
        return _Stretch(self.segments, *(x[piece] for x in self[1:]))


def period(path: Path) -> Array:
    """Time between two ticks, () s."""
    return path.lap_time / path.search.corner.shape[0]


def _row(x: Array, row: Array) -> Array:
    return jax.lax.dynamic_index_in_dim(x, row, keepdims=False, allow_negative_indices=False)


def _near(stretch: _Stretch, position: Array, count: int) -> tuple[Array, Array]:
    """Which of the first pieces is the closest, and the coordinate on it before the last step."""

    def on(i: int) -> tuple[Array, Array]:
        own = stretch.on(i)
        y = own.start
        for _ in range(STEPS - 1):
            y, *_ = _step(own, position, y)
        return _arrive(own, position, y).distance, y

    piece = jnp.zeros((), jnp.int32)
    distance, y = on(0)
    for i in range(1, count):
        other, there = on(i)
        closer = other < distance
        piece, distance = jnp.where(closer, i, piece), jnp.where(closer, other, distance)
        y = jnp.where(closer, there, y)
    return piece, y


def _step(own: _Stretch, position: Array, y: Array) -> tuple[Array, Array, Array, Array, Array]:
    """A Newton step in the coordinate y, clamped to the window; and where it began: the index of
    the segment, its coefficients and its start, and the offset of the tool (axes,) m.

    Offsets are taken from the start of the segment, so single precision loses nothing.
    """
    whole = jnp.clip(jnp.floor(y), jnp.floor(own.low), jnp.ceil(own.high) - 1)
    index = own.base + whole.astype(jnp.int32)
    c = own.segments.cubic.at[index].get(mode="clip")
    f = y - whole
    offset = (position - c[0]) - f * (c[1] + f * (c[2] + f * c[3]))
    first = c[1] + f * (2 * c[2] + 3 * f * c[3])
    new = y + projection_step(offset, first, 2 * c[2] + 6 * f * c[3])
    return jnp.clip(new, own.low, own.high), index, c, whole, offset


def _arrive(own: _Stretch, position: Array, y: Array) -> Nearest:
    """The last step, which carries the gradient, and the point that it leads to."""
    y, index, c, whole, offset = _step(own, position, y)
    f = y - whole
    along = f * (c[1] + f * (c[2] + f * c[3]))
    distance = norm((position - c[0]) - along)
    reached = settled(norm(offset), distance, position)
    return Nearest(
        point=c[0] + along,
        distance=distance,
        arc=own.segments.arc.at[index].get(mode="clip")
        + f * own.segments.length.at[index].get(mode="clip"),
        reach=jnp.where(reached, jnp.inf, jnp.zeros_like(distance)),
    )


#: follows a stored lap; parameters `Path`
sampled = Reference(name="sampled", sample=sample, nearest=nearest, period=period)
