"""What is refused before a run: shapes, types and ranges, each named with its allowed range."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from jaxstage.model.blocks import Loop, Plant, Reference, unlimited
from jaxstage.model.fields import Quantity, in_units_of, leaves
from jaxstage.model.signals import Scenario

#: in a tree of batch axes: a leaf that all runs share
SHARED = -1


def check(
    loop: Loop, gains: Any, scenario: Scenario, path: Any, in_axes: Any = None
) -> tuple[Any, Scenario, Any]:
    """Validate the inputs of a run and make every number a strong array of the path's type.

    Values under a trace (``jit``, ``vmap``, ``grad``) are checked for shape only. in_axes: the
    three trees of batch axes (0 or `SHARED` a leaf) of a batch of runs, None for one run. Raises
    ValueError naming the value, where it stands and what is allowed.
    """
    _check_kinds(loop, scenario)
    path = jax.tree.map(jnp.asarray, path)
    dtype = float_type(path)
    _check_key(scenario)
    gains = strong(gains, dtype, "gains")
    scenario = strong(scenario, dtype, "scenario")
    check_loop(loop)
    axes = loop.plant.axes
    if in_axes is None:
        in_axes = jax.tree.map(lambda _: SHARED, (gains, scenario, path))
    one_path = jax.tree.map(
        lambda x, a: x if a == SHARED else jax.ShapeDtypeStruct(x.shape[1:], x.dtype),
        path, in_axes[2],
    )  # fmt: skip
    shapes, structure = jax.tree.flatten(one_path)
    sampled = _sampled(loop.reference, structure, tuple((x.shape, x.dtype) for x in shapes))
    if sampled != (len(axes),):
        raise ValueError(
            f"the path has {sampled[-1]} axes, "
            f"but {loop.plant.name} has {len(axes)} ({', '.join(axes)})"
        )
    _check_period(loop, path, in_axes[2])
    check_leaves(loop.plant, gains, "gains", in_axes[0], per_axis=True)
    _check_law(loop, gains, in_axes[0])
    for name in ("plant", "load", "sensor", "drive", "start"):
        batch = getattr(in_axes[1], name)
        check_leaves(loop.plant, getattr(scenario, name), name, batch, per_axis=name == "sensor")
    _check_delay(loop, scenario)
    return gains, scenario, path


@functools.cache
def _sampled(reference: Reference, structure: Any, shapes: Any) -> tuple[int, ...]:
    """The shape of the positions that a path of such leaves gives."""
    leaves = [jax.ShapeDtypeStruct(*x) for x in shapes]
    path = jax.tree.unflatten(structure, leaves)
    tick = jax.ShapeDtypeStruct((), jnp.int32)
    return jax.eval_shape(reference.sample, path, tick).position.shape


def float_type(tree: Any) -> Any:
    """The type of the first floating-point leaf, JAX's default without one.

    The precision of a run is that of its path. Raises ValueError for double precision where JAX
    does not have it.
    """
    default = jnp.zeros(()).dtype
    for leaf in jax.tree.leaves(tree):
        if jnp.issubdtype(leaf.dtype, jnp.floating):
            if leaf.dtype == jnp.float64 and default == jnp.float32:
                raise ValueError(
                    "the path is in double precision, but JAX runs in single: configure("
                    'precision="double"), or build the case again'
                )
            return leaf.dtype
    return default


def strong(tree: Any, dtype: Any, root: str = "input") -> Any:
    """The tree with Python numbers and floats as arrays of one type, so nothing retraces.

    root: begins the names. Raises ValueError for what is no number.
    """

    def convert(place: Any, leaf: Any) -> Any:
        if isinstance(leaf, jax.Array) and jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
            return leaf
        try:
            return jnp.asarray(leaf, dtype=dtype)
        except (TypeError, ValueError):
            name = f"{root}{jax.tree_util.keystr(place)}"
            raise ValueError(f"{name} = {leaf!r}: must be a number or an array") from None

    return jax.tree_util.tree_map_with_path(convert, tree)


def _check_kinds(loop: Any, scenario: Any) -> None:
    for name, value, kind in (("loop", loop, Loop), ("scenario", scenario, Scenario)):
        if not isinstance(value, kind):
            raise ValueError(
                f"{name} is a {type(value).__name__}, must be a {kind.__name__}: "
                "simulate(loop, gains, scenario, path, ticks), all parts of js.build(name)"
            )


def _check_period(loop: Loop, path: Any, batch: Any) -> None:
    if all(a == SHARED for a in jax.tree.leaves(batch)):
        period = loop.reference.period(path)
    else:
        lanes = jax.tree.map(lambda a: None if a == SHARED else a, batch)
        period = jax.vmap(lambda one: jnp.asarray(loop.reference.period(one)), (lanes,))(path)
    if isinstance(period, Tracer):
        return
    wrong = np.abs(np.asarray(period, float) / loop.dt - 1) > 1e-5
    if np.any(wrong):
        raise ValueError(
            f"loop.dt = {loop.dt:g} s, but the path has a tick every "
            f"{float(np.max(np.asarray(period))):g} s: make it for the dt of the loop"
        )


def _check_law(loop: Loop, gains: Any, batch: Any) -> None:
    if loop.controller.longest_period is unlimited:
        return
    if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(gains)):
        return

    def longest(one: Any) -> jax.Array:
        return jnp.min(jnp.asarray(loop.controller.longest_period(one)))

    pairs = zip(jax.tree.leaves(gains), jax.tree.leaves(batch), strict=True)
    sizes = {leaf.shape[0] for leaf, axis in pairs if axis != SHARED}
    if len(sizes) > 1:
        return  # no batch: refused where batches are made
    with jax.ensure_compile_time_eval():  # what else is under a trace does not matter here
        if not sizes:
            limit = float(longest(gains))
        else:
            lanes = jax.tree.map(lambda a: None if a == SHARED else a, batch)
            limit = float(jnp.min(jax.vmap(longest, (lanes,))(gains)))
    if loop.dt > limit * (1 + 1e-6):
        raise ValueError(
            f"loop.dt = {loop.dt:g} s: must be <= {limit:g} s, or {loop.controller.name} is "
            "unstable with these gains"
        )


def _check_key(scenario: Scenario) -> None:
    if not jnp.issubdtype(jnp.asarray(scenario.key).dtype, jax.dtypes.prng_key):
        raise ValueError("scenario.key must be a key of jax.random.key(seed)")


def check_loop(loop: Loop) -> None:
    """Refuse impossible numbers in the definition of a loop."""
    for name, value, ok, allowed in (
        ("dt", loop.dt, np.isfinite(loop.dt) and loop.dt > 0, "> 0 s"),
        ("substeps", loop.substeps, loop.substeps >= 1, ">= 1"),
        ("segment", loop.segment, loop.segment >= 0, ">= 0"),
        ("path_limit", loop.path_limit, loop.path_limit > 0, "> 0 m"),
    ):
        if not ok:
            raise ValueError(f"loop.{name} = {value}: must be {allowed}")
    for name in ("substeps", "segment"):
        if not isinstance(getattr(loop, name), int):
            raise ValueError(f"loop.{name} = {getattr(loop, name)}: must be a whole number")


def check_leaves(plant: Plant, tree: Any, root: str, batch: Any, per_axis: bool = False) -> None:
    """Check shape and range of every field below ``tree``; ``root`` begins the names.

    plant: gives the names of the axes and the unit of the command. batch: the same tree with 0
    where a leaf has a leading batch axis, else `SHARED`. per_axis: fields described for one axis
    may carry a leading (axes,).
    """
    axes = plant.axes
    values = {path: value for path, _, value in leaves(tree, root)}
    batched = {path: axis != SHARED for path, _, axis in leaves(batch, root)}
    for path, general, value in leaves(tree, root):
        quantity = in_units_of(general, plant.command_unit)
        shape = np.shape(value)[1:] if batched[path] else np.shape(value)
        _check_shape(path, quantity, shape, axes, per_axis)
        if isinstance(value, Tracer):
            continue
        array = np.asarray(value)
        bad = _out_of_range(quantity, array)
        allowed = quantity.range_text()
        if quantity.at_least and not bad.any():
            other = values[path.rsplit(".", 1)[0] + "." + quantity.at_least]
            if not isinstance(other, Tracer):
                bad = array < np.asarray(other)
                allowed = f">= {quantity.at_least}"
        if bad.any():
            if bad.ndim > array.ndim:
                array = np.broadcast_to(array, bad.shape)
            lanes = bad.ndim > len(shape)
            raise ValueError(_message(path, quantity, array, bad, allowed, axes, lanes))


def _check_shape(
    path: str, quantity: Quantity, shape: tuple[int, ...], axes: tuple[str, ...], per_axis: bool
) -> None:
    described = [d.strip() for d in quantity.shape.strip("()").split(",") if d.strip()]
    if any(not d.isdigit() and d != "axes" for d in described):
        return  # a symbolic size: the array itself sets it
    base = tuple(len(axes) if d == "axes" else int(d) for d in described)
    allowed = [base, (len(axes), *base)] if per_axis else [base]
    if shape not in allowed:
        expected = " or ".join(str(s) for s in allowed)
        raise ValueError(f"{path} has shape {shape}, expected {expected}")


def _out_of_range(quantity: Quantity, array: np.ndarray) -> np.ndarray:
    allowed = ~np.isnan(array) if quantity.infinite else np.isfinite(array)
    above = (array > quantity.above) | (quantity.above == -np.inf)
    return ~(allowed & above & (array >= quantity.low) & (array <= quantity.high))


def _message(
    path: str, quantity: Quantity, array: np.ndarray, bad: np.ndarray, allowed: str,
    axes: tuple[str, ...], lanes: bool,
) -> str:  # fmt: skip
    index = tuple(int(i) for i in np.argwhere(bad)[0])
    inner, sizes = (index[1:], array.shape[1:]) if lanes else (index, array.shape)
    where = f" of run {index[0]}" if lanes else ""
    if inner and sizes[0] == len(axes):
        rest = "".join(f"[{i}]" for i in inner[1:])
        where += f" ({axes[inner[0]]}){rest}"
    elif inner:
        where += f"{list(inner)}"
    symbol = f" [{quantity.symbol}]" if quantity.symbol else ""
    unit = "" if quantity.unit == "1" else f" {quantity.unit}"
    return f"{path}{where}{symbol} = {array[index]:g}{unit}: must be {allowed}"


def _check_delay(loop: Loop, scenario: Scenario) -> None:
    delay = getattr(scenario.drive, "delay", None)
    if delay is None or isinstance(delay, Tracer):
        return
    largest = float(np.max(np.asarray(delay)))
    if largest > loop.drive.max_delay:
        raise ValueError(
            f"drive.delay = {largest:g} periods: "
            f"must be <= {loop.drive.max_delay}, the max_delay of the loop's drive"
        )
    broken = np.asarray(delay) % 1 != 0
    if broken.any():
        value = np.asarray(delay)[broken].flat[0]
        raise ValueError(f"drive.delay = {value:g} periods: must be a whole number")
