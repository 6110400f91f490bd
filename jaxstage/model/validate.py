"""Validation before a run: shapes, types and ranges, each refused with its name and allowed range.

Layer one of three: what is refused here never starts. What goes wrong while a run goes on is marked
in its `Carry`.
"""

# the types of JAX's tree functions are not complete
# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false
# pyright: reportUnknownLambdaType=false, reportUnknownVariableType=false

import functools
import reprlib
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from numpy.typing import NDArray

from jaxstage.model.blocks import Loop, Plant, Reference, unlimited
from jaxstage.model.fields import Quantity, in_units_of, leaves
from jaxstage.model.signals import Scenario

#: in a tree of batch axes: a leaf that all runs share
SHARED = -1
#: plant steps in a control period; more would take hours for a second of motion
MOST_SUBSTEPS = 10_000


def check(
    loop: Loop, gains: Any, scenario: Scenario, path: Any, in_axes: Any = None
) -> tuple[Any, Scenario, Any]:
    """Validate the inputs of a run and make every number a strong array of the path's type.

    Values under a trace (``jit``, ``vmap``, ``grad``) are checked for shape only.

    Args:
        loop: what is fixed.
        gains: pytree of the controller's gains.
        scenario: what is uncertain.
        path: parameters of the reference, whose precision is that of the run.
        in_axes: the three trees of batch axes (0 or `SHARED` a leaf) of a batch of runs, None for
            one run.

    Returns:
        Gains, scenario and path, every leaf an array.

    Raises:
        ValueError: with the value, where it stands and what is allowed.
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
    shapes, structure = jax.tree.flatten(jax.tree.map(_of_one_run, path, in_axes[2]))
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


def _of_one_run(leaf: jax.Array, axis: int) -> jax.Array | jax.ShapeDtypeStruct:
    return leaf if axis == SHARED else jax.ShapeDtypeStruct(leaf.shape[1:], leaf.dtype)


def _lanes(batch: Any) -> Any:
    """The tree of batch axes as ``jax.vmap`` takes it."""
    return jax.tree.map(lambda axis: None if axis == SHARED else axis, batch)


@functools.cache
def _sampled(
    reference: Reference[Any], structure: Any, shapes: tuple[tuple[tuple[int, ...], Any], ...]
) -> tuple[int, ...]:
    """The shape of the positions that a path of such leaves gives."""
    path = jax.tree.unflatten(structure, [jax.ShapeDtypeStruct(*x) for x in shapes])
    tick = jax.ShapeDtypeStruct((), jnp.int32)
    return jax.eval_shape(reference.sample, path, tick).position.shape


def float_type(tree: Any) -> Any:
    """The type of the first floating-point leaf, JAX's default without one.

    The precision of a run is that of its path.

    Raises:
        ValueError: double precision where JAX does not have it.
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

    Args:
        tree: pytree of numbers, arrays and random keys.
        dtype: type of the arrays; keys stay.
        root: begins the names.

    Raises:
        ValueError: a leaf is no real number, or a field holds a list in the place of an array.
    """
    for name, _, value in leaves(tree, root):
        if value is None or isinstance(value, list | tuple | dict):
            raise ValueError(f"{name} = {reprlib.repr(value)}: must be a number or an array")

    def convert(place: Any, leaf: Any) -> Any:
        if isinstance(leaf, jax.Array) and jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
            return leaf
        try:
            if not _is_real(leaf):
                raise TypeError
            return jnp.asarray(leaf, dtype=dtype)
        except (TypeError, ValueError, OverflowError):
            name = f"{root}{jax.tree_util.keystr(place)}"
            raise ValueError(
                f"{name} = {reprlib.repr(leaf)}: must be a number or an array"
            ) from None

    return jax.tree_util.tree_map_with_path(convert, tree)


def _is_real(leaf: Any) -> bool:
    """True for what is made of whole or real numbers: no bool, complex number or text."""
    dtype = leaf.dtype if isinstance(leaf, jax.Array) else np.asarray(leaf).dtype
    return jnp.issubdtype(dtype, jnp.integer) or jnp.issubdtype(dtype, jnp.floating)


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

        def of_one(one: Any) -> jax.Array:
            return jnp.asarray(loop.reference.period(one))

        period = jax.vmap(of_one, (_lanes(batch),))(path)
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
            limit = float(jnp.min(jax.vmap(longest, (_lanes(batch),))(gains)))
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
        ("substeps", loop.substeps, loop.substeps <= MOST_SUBSTEPS, f"<= {MOST_SUBSTEPS}"),
        ("segment", loop.segment, loop.segment >= 0, ">= 0"),
        ("path_limit", loop.path_limit, loop.path_limit > 0, "> 0 m"),
    ):
        if not ok:
            raise ValueError(f"loop.{name} = {value}: must be {allowed}")
    for name in ("substeps", "segment"):
        if not isinstance(getattr(loop, name), int):
            raise ValueError(f"loop.{name} = {getattr(loop, name)}: must be a whole number")


def check_leaves(
    plant: Plant[Any, Any], tree: Any, root: str, batch: Any, per_axis: bool = False
) -> None:
    """Check shape and range of every field below a tree.

    Args:
        plant: gives the names of the axes and the unit of the command.
        tree: gains, or a part of the scenario.
        root: begins the names.
        batch: the same tree with 0 where a leaf has a leading batch axis, else `SHARED`.
        per_axis: fields described for one axis may carry a leading (axes,).

    Raises:
        ValueError: with the field, the run, the axis, its value and what is allowed.
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
            index = tuple(int(i) for i in np.argwhere(bad)[0])
            run = f" of run {index[0]}" if bad.ndim > len(shape) else ""
            first = 1 if run else 0
            where = run + _place(index[first:], array.shape[first:], axes)
            raise ValueError(_refusal(path + where, quantity, array[index], allowed))


def _check_shape(
    path: str, quantity: Quantity, shape: tuple[int, ...], axes: tuple[str, ...], per_axis: bool
) -> None:
    if any(not size.isdigit() and size != "axes" for size in quantity.sizes):
        return  # a symbolic size: the array itself sets it
    base = tuple(len(axes) if size == "axes" else int(size) for size in quantity.sizes)
    allowed = [base, (len(axes), *base)] if per_axis else [base]
    if shape not in allowed:
        expected = " or ".join(str(s) for s in allowed)
        raise ValueError(f"{path} has shape {shape}, expected {expected}")


def _out_of_range(quantity: Quantity, array: NDArray[Any]) -> NDArray[Any]:
    allowed = ~np.isnan(array) if quantity.infinite else np.isfinite(array)
    above = (array > quantity.above) | (quantity.above == -np.inf)
    return ~(allowed & above & (array >= quantity.low) & (array <= quantity.high))


def _place(index: tuple[int, ...], sizes: tuple[int, ...], axes: tuple[str, ...]) -> str:
    """Where in the array of a field an element stands: its axis by name, else its index."""
    if index and sizes[0] == len(axes):
        return f" ({axes[index[0]]})" + "".join(f"[{i}]" for i in index[1:])
    return f"{list(index)}" if index else ""


def _refusal(path: str, quantity: Quantity, value: float, allowed: str) -> str:
    """One line: the value of a field with its unit, and what is allowed."""
    symbol = f" [{quantity.symbol}]" if quantity.symbol else ""
    unit = "" if quantity.unit == "1" else f" {quantity.unit}"
    return f"{path}{symbol} = {value:g}{unit}: must be {allowed}"


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
