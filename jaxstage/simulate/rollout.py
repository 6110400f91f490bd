"""A run from start to report: scan over ticks, flags for lost runs, resume, replay."""

# what JAX gives is partly untyped
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false
# pyright: reportUnknownArgumentType=false, reportUnknownLambdaType=false

from collections.abc import Callable, Generator
from contextlib import contextmanager
from functools import partial
from numbers import Integral
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array, lax
from jax.custom_derivatives import SymbolicZero

from jaxstage.compiler.frontend.step_program import Program, StepSpec
from jaxstage.compiler.runtime.api import program_of, rollout
from jaxstage.model.blocks import Loop, Metric, scan
from jaxstage.model.fields import is_pytree_data, replace
from jaxstage.model.signals import Carry, Output, Run, Sample, Scenario, Setpoint
from jaxstage.model.validate import check
from jaxstage.numerics.segmented_scan import segmented
from jaxstage.simulate.tick import tick, tick_keys

#: what the tick counter holds
MOST_TICKS = 2**31 - 1


def simulate(
    loop: Loop,
    gains: Any,
    scenario: Scenario,
    path: Any,
    ticks: int,
    carry: Carry | None = None,
) -> Run:
    """Simulate one run (a rollout of the closed loop).

    Pure: ``vmap`` over gains is a population, over scenario a Monte-Carlo sweep, ``grad`` or
    ``jacfwd`` over gains is tuning.

    A run whose following error exceeds ``loop.path_limit``, or that is no longer finite, is
    frozen there and flagged in ``final.left_path_at`` or ``final.non_finite_at``; its report is
    NaN.

    Args:
        loop: What is fixed.
        gains: What is tuned, data of ``loop.controller``.
        scenario: What is uncertain.
        path: What is commanded, the parameters of ``loop.reference``.
        ticks: Control periods of ``loop.dt`` s.
        carry: Where an earlier run stopped; the two together equal one long run.

    Returns:
        Report of the metric, its rows with a leading axis of ``ticks``, and the last carry.

    Raises:
        ValueError: For bad input, naming the value and its allowed range.
        RuntimeError: Where ``loop.engine`` is `compiled` and the loop cannot be, with the reason.
    """
    check_ticks(ticks)
    gains, scenario, path = check(loop, gains, scenario, path)
    with fields_named(loop):
        return _simulate(loop, ticks, gains, scenario, path, carry)


def check_ticks(ticks: int) -> None:
    """Refuse a number of control periods that no run can have.

    Raises:
        ValueError: Unless it is a whole number from 1 to what the 32-bit tick counter holds.
    """
    if not isinstance(ticks, Integral):
        raise ValueError(f"ticks = {ticks!r}: must be a whole number")
    if ticks < 1:
        raise ValueError(f"ticks must be >= 1, got {ticks}")
    if ticks > MOST_TICKS:
        raise ValueError(f"ticks must be <= {MOST_TICKS} (the counter has 32 bits), got {ticks}")


@contextmanager
def fields_named(loop: Loop) -> Generator[None]:
    """Say of which data a law or a machine misses a field: usually those of another one."""
    try:
        yield
    except AttributeError as error:
        if not is_pytree_data(error.obj):
            raise
        raise ValueError(
            f"{type(error.obj).__name__} has no '{error.name}', which {loop.controller.name} on "
            f"{loop.plant.name} needs: gains or parameters of another law or machine?"
        ) from error


@partial(jax.jit, static_argnums=(0, 1))
def _simulate(
    loop: Loop, ticks: int, gains: Any, scenario: Scenario, path: Any, carry: Carry | None
) -> Run:
    return whole_run(loop, ticks, gains, scenario, path, carry)


def whole_run(
    loop: Loop, ticks: int, gains: Any, scenario: Scenario, path: Any, carry: Carry | None = None
) -> Run:
    """`simulate` without its checks, inside a trace."""
    begin = _sound(start(loop, gains, scenario, path) if carry is None else carry)
    if ticks < loop.engine.shortest:
        final, rows = scan_ticks(
            loop, ticks, lambda c: advance(loop, gains, scenario, path, c), begin
        )
    else:
        final, rows = rollout(*compiled_form(loop, gains, scenario, path, begin), ticks)
    return Run(report=report(loop, final), rows=rows, final=final)


def compiled_form(
    loop: Loop, gains: Any, scenario: Scenario, path: Any, carry: Carry
) -> tuple[Program, list[Array]]:
    """The loop as the compiler takes it.

    Args:
        loop: What is fixed.
        gains: What is tuned.
        scenario: What is uncertain.
        path: Parameters of the reference.
        carry: Before the first tick.

    Returns:
        The program, which holds shapes alone, and its numbers.
    """
    same = replace(loop, engine=scan, segment=0)
    step = StepSpec(_advance, same, loop.segment, finite=True, strict=loop.engine.strict)
    return program_of(step, (gains, scenario), path, carry)


def _advance(loop: Loop, inputs: Any, path: Any, carry: Carry) -> tuple[Carry, Any]:
    gains, scenario = inputs
    return advance(loop, gains, scenario, path, carry)


def _sound(carry: Carry) -> Carry:
    """A carry that is not finite is lost from the start: the ticks then only meet finite ones."""
    broken = ~_finite(carry) & ~lost(carry)
    return replace(carry, non_finite_at=jnp.where(broken, carry.step, carry.non_finite_at))


def start(loop: Loop, gains: Any, scenario: Scenario, path: Any) -> Carry:
    """The carry before the first tick.

    The machine stands ``scenario.start.offset`` m beside the path and moves with the fraction
    ``scenario.start.velocity`` of the commanded velocity.

    Args:
        loop: What is fixed.
        gains: What is tuned.
        scenario: What is uncertain.
        path: Parameters of the reference.

    Returns:
        States and memories after their ``init``, tick 0, no flags.
    """
    setpoint = loop.reference.sample(path, jnp.zeros((), jnp.int32))
    position = setpoint.position + scenario.start.offset
    velocity = setpoint.velocity * scenario.start.velocity
    output = Output(
        position=position, velocity=velocity, drive_position=position, drive_velocity=velocity
    )
    state = loop.plant.init(scenario.plant, output)
    sensor = loop.sensor.init(scenario.sensor, output)
    key, _ = tick_keys(scenario, jnp.zeros((), jnp.int32))
    measurement, _ = loop.sensor.read(scenario.sensor, sensor, key, output, loop.dt)
    never = jnp.full((), -1, jnp.int32)
    return Carry(
        state=state,
        drive=loop.drive.init(scenario.drive, jnp.zeros_like(position)),
        sensor=sensor,
        memory=loop.controller.init(gains, setpoint, measurement),
        metric=loop.metric.init(setpoint),
        step=jnp.zeros((), jnp.int32),
        left_path_at=never,
        non_finite_at=never,
    )


def scan_ticks(
    loop: Loop, ticks: int, step: Callable[[Carry], tuple[Carry, Any]], carry: Carry
) -> tuple[Carry, Any]:
    """Scan over the ticks, in checkpointed segments if the loop asks for them.

    Args:
        loop: Whose ``segment`` is taken.
        ticks: Control periods.
        step: From a carry to the next and a row.
        carry: Before the first tick.

    Returns:
        The last carry, and the rows with a leading axis of ``ticks``.
    """
    return segmented(lambda c, _: step(c), carry, ticks, loop.segment)


def lost(carry: Carry) -> Array:
    """True where a run left its path or stopped being finite."""
    return (carry.left_path_at >= 0) | (carry.non_finite_at >= 0)


def _finite(tree: Any) -> Array:
    """True if every float of a tree is finite.

    In one flat array: a check a leaf costs the compiled loop a kernel a leaf, four times as much.
    """
    by_type: dict[Any, list[Array]] = {}
    for leaf in jax.tree.leaves(tree):
        if jnp.issubdtype(leaf.dtype, jnp.inexact):
            by_type.setdefault(leaf.dtype, []).append(leaf.reshape(-1))
    checks = [jnp.all(jnp.isfinite(jnp.concatenate(flat))) for flat in by_type.values()]
    return jnp.all(jnp.stack(checks)) if checks else jnp.ones((), bool)


def advance(
    loop: Loop, gains: Any, scenario: Scenario, path: Any, carry: Carry
) -> tuple[Carry, Any]:
    """One guarded tick, which a lost run passes unchanged.

    Only finite values are ever accepted into the carry, so a lost run goes on computing from
    finite values and changes nothing in the runs beside it.

    Args:
        loop: What is fixed.
        gains: What is tuned.
        scenario: What is uncertain.
        path: Parameters of the reference.
        carry: Before the tick.

    Returns:
        The carry after it, flags set, and the row of the metric, NaN where the run is lost.
    """
    frozen = lost(carry)
    setpoint = loop.reference.sample(path, carry.step)
    output = loop.plant.observe(scenario.plant, carry.state)
    off = jnp.max(jnp.abs(setpoint.position - output.position)) > loop.path_limit
    leaves, structure = jax.tree.flatten((gains, scenario, path, carry))
    (after, row), finite = _checked_tick(loop, structure, *leaves)
    ok = finite & ~off & ~frozen
    kept = jax.tree.map(partial(jnp.where, ok), after, carry)
    flagged = replace(
        kept,
        step=after.step,
        left_path_at=jnp.where(off & ~frozen, carry.step, carry.left_path_at),
        non_finite_at=jnp.where(~finite & ~off & ~frozen, carry.step, carry.non_finite_at),
    )
    return flagged, jax.tree.map(lambda r: _blank(ok, r), row)


def _tick_and_check(loop: Loop, structure: Any, *leaves: Any) -> tuple[Any, Array]:
    """`tick` on flattened inputs, and whether all that it would carry on is finite."""
    after, row = tick(loop, *jax.tree.unflatten(structure, leaves))
    return (after, row), _finite(replace(after, step=None))


def _checked_tick_jvp(loop: Loop, structure: Any, primals: Any, tangents: Any) -> Any:
    """Masked gradient: the derivative of a tick, 0 at its INPUT where the result is not finite.

    The cotangent of rejected values is zero, and reverse mode would turn it into 0 x NaN.
    """
    moving = [i for i, t in enumerate(tangents) if not isinstance(t, SymbolicZero)]

    def evaluate(*values: Array) -> tuple[Any, Array]:
        leaves = list(primals)
        for i, value in zip(moving, values, strict=True):
            leaves[i] = value
        return _tick_and_check(loop, structure, *leaves)

    out, derivative = jax.linearize(evaluate, *(primals[i] for i in moving))
    masked = [jnp.where(out[1], tangents[i], jnp.zeros_like(tangents[i])) for i in moving]
    return out, derivative(*masked)


_checked_tick = jax.custom_jvp(_tick_and_check, nondiff_argnums=(0, 1))
# symbolic zeros: what is not differentiated (the path above all) must not cost a tick anything
_checked_tick.defjvp(_checked_tick_jvp, symbolic_zeros=True)


def _blank(ok: Array, leaf: Array) -> Array:
    if jnp.issubdtype(leaf.dtype, jnp.inexact):
        return jnp.where(ok, leaf, jnp.full_like(leaf, jnp.nan))
    return leaf


def report(loop: Loop, carry: Carry) -> Any:
    """What the metric finishes with; its floats are NaN where the run was lost."""
    return jax.tree.map(partial(_blank, ~lost(carry)), loop.metric.finish(carry.metric))


def replay(metric: Metric[Any, Any], rows: Sample, dt: float) -> tuple[Any, Any]:
    """Evaluate a metric on recorded samples.

    Args:
        metric: Which one.
        rows: What the metric `record` stored, one row a tick.
        dt: Control period in s.

    Returns:
        The report and the rows that it would have given in the run.
    """
    first: Setpoint = jax.tree.map(lambda r: r[0], rows.setpoint)
    acc, out = lax.scan(lambda a, s: metric.update(a, s, dt), metric.init(first), rows)
    return metric.finish(acc), out
