"""Derivatives of a simulation: the right mode for the number of parameters, and a check of it.

A gradient of a switching loop can be exact and still useless; `grad_check` puts reverse mode,
forward mode and central differences side by side for each parameter, and names the kinks that the
loop holds.
"""

# what JAX gives is partly untyped
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false
# pyright: reportUnknownArgumentType=false, reportUnknownLambdaType=false

import re
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxstage.model.blocks import Loop
from jaxstage.model.settings import known_leaves, replaced, resolve
from jaxstage.model.signals import Scenario
from jaxstage.numerics.smooth import KINK
from jaxstage.simulate.rollout import start
from jaxstage.simulate.tick import tick

#: up to this many parameters forward mode is the cheaper one: measured on the fuzzy-CMAC loop (64
#: runs, 2000 ticks), a reverse gradient costs 5.1 forward runs and 8 tangents cost 6.7
FORWARD_LIMIT = 6


class Selection(NamedTuple):
    """Some settings of a loop as one vector.

    Attributes:
        names: One label an element, (n,).
        vector: Their values, (n,), each in its SI unit.
        rebuild: From such a vector to (gains, scenario).
    """

    names: tuple[str, ...]
    vector: Array
    rebuild: Callable[[Array], tuple[Any, Scenario]]


def select(gains: Any, scenario: Scenario, names: tuple[str, ...]) -> Selection:
    """Named settings as one vector.

    Args:
        gains: What is tuned.
        scenario: What is uncertain.
        names: Settings by name, symbol or unique suffix.

    Returns:
        The vector, with a label for each element.

    Raises:
        ValueError: For an unknown or ambiguous name.
    """
    known = known_leaves(gains, scenario)
    paths = tuple(resolve(name, known) for name in names)
    values = [jnp.asarray(known[path][1]) for path in paths]
    labels = tuple(
        f"{path}{list(index) if index else ''}"
        for path, value in zip(paths, values, strict=True)
        for index in np.ndindex(value.shape)
    )

    def rebuild(vector: Array) -> tuple[Any, Scenario]:
        new_gains, new_scenario, at = gains, scenario, 0
        for path, value in zip(paths, values, strict=True):
            part = vector[at : at + value.size].reshape(value.shape)
            at += value.size
            new_gains, new_scenario = replaced(new_gains, new_scenario, path, part)
        return new_gains, new_scenario

    vector = jnp.concatenate([v.reshape(-1) for v in values])
    return Selection(names=labels, vector=vector, rebuild=rebuild)


def value_and_gradient(
    function: Callable[[Array], Array], forward: bool | None = None
) -> Callable[[Array], tuple[Array, Array]]:
    """Value and gradient of a scalar function of a vector, by the cheaper mode.

    For long runs in reverse mode give the loop a ``segment`` of about the square root of the
    ticks: memory then grows like that root.

    Args:
        function: From (n,) to ().
        forward: True or False to choose the mode; None takes forward mode up to `FORWARD_LIMIT`
            parameters, else reverse.

    Returns:
        A function from (n,) to f, () and df/dx, (n,).
    """

    def both(x: Array) -> tuple[Array, Array]:
        use_forward = x.size <= FORWARD_LIMIT if forward is None else forward
        if not use_forward:
            return jax.value_and_grad(function)(x)

        def twice(x: Array) -> tuple[Array, Array]:
            value = function(x)
            return value, value

        slope, value = jax.jacfwd(twice, has_aux=True)(x)
        return value, slope

    return both


class DerivativeRow(NamedTuple):
    """The derivatives by one parameter.

    Attributes:
        name: Of the parameter.
        value: Of the parameter, in its SI unit.
        reverse: By reverse mode.
        forward: By forward mode.
        difference: Central, over ``step`` times the scale of the parameter to either side.
    """

    name: str
    value: float
    reverse: float
    forward: float
    difference: float


class GradCheck(NamedTuple):
    """The three derivatives of each parameter, and the kinks of the loop.

    Attributes:
        objective: Its value.
        step: Relative step of the central differences.
        rows: One a parameter.
        kinks: See `kinks`.
    """

    objective: float
    step: float
    rows: tuple[DerivativeRow, ...]
    kinks: tuple[str, ...]

    def mode_error(self) -> float:
        """Largest |reverse - forward|, relative to the largest derivative."""
        return self._largest(lambda row: row.reverse - row.forward)

    def difference_error(self) -> float:
        """Largest |forward - central difference|, relative to the largest derivative."""
        return self._largest(lambda row: row.forward - row.difference)

    def sign_share(self) -> float:
        """Share of the parameters with any effect whose derivative points the right way."""
        acting = [row for row in self.rows if row.difference != 0]
        right = [row for row in acting if row.forward * row.difference > 0]
        return len(right) / len(acting) if acting else 1.0

    def text(self) -> str:
        """A table, one line a parameter, then the kinks."""
        head = (
            f"{'parameter':40s} {'value':>12s} {'reverse':>13s} {'forward':>13s} {'central':>13s}"
        )
        lines = [
            f"{r.name:40s} {r.value:12.5g} {r.reverse:13.6g} {r.forward:13.6g} {r.difference:13.6g}"
            for r in self.rows
        ]
        share = f"signs that agree with a step of {self.step:g}: {self.sign_share():.0%}"
        return "\n".join([head, *lines, share, "kinks:", *(f"  {k}" for k in self.kinks)])

    def _largest(self, gap: Callable[[DerivativeRow], float]) -> float:
        scale = max(abs(row.forward) for row in self.rows) or 1.0
        return max(abs(gap(row)) for row in self.rows) / scale


def grad_check(
    loop: Loop,
    gains: Any,
    scenario: Scenario,
    path: Any,
    objective: Callable[[Any, Scenario], Array],
    names: tuple[str, ...],
    step: float = 1e-4,
    scales: Mapping[str, float] | None = None,
) -> GradCheck:
    """Reverse mode against forward mode against central differences, per parameter.

    Args:
        loop: Whose kinks are named.
        gains: What is tuned.
        scenario: What is uncertain.
        path: Parameters of the reference.
        objective: From (gains, scenario) to (), usually a metric of ``simulate(loop, ...)``.
        names: Settings by name, symbol or suffix; every element of them is a parameter.
        step: Relative step of the central difference.
        scales: By name of a setting: what a parameter that is 0 steps by, times ``step``; 1 if left
            out.

    Returns:
        The derivatives side by side, and the kinks of the loop.

    Raises:
        ValueError: For unknown names, and for an objective that is not finite.
    """
    chosen = select(gains, scenario, names)

    def function(x: Array) -> Array:
        return objective(*chosen.rebuild(x))

    x = chosen.vector
    value, reverse = jax.jit(value_and_gradient(function, forward=False))(x)
    _, forward = jax.jit(value_and_gradient(function, forward=True))(x)
    if not np.isfinite(value):
        raise ValueError(f"the objective is {float(value)}: the run was lost, nothing to check")
    scale = _scales(chosen, scales or {})
    ends = jax.jit(lambda moved: jax.lax.map(function, moved, batch_size=64))
    moves = jnp.diag(step * scale)
    difference = (ends(x[None] + moves) - ends(x[None] - moves)) / (2 * step * scale)
    columns = (np.asarray(c, float) for c in (x, reverse, forward, difference))
    rows = (
        DerivativeRow(name, *map(float, numbers))
        for name, *numbers in zip(chosen.names, *columns, strict=True)
    )
    return GradCheck(float(value), step, tuple(rows), kinks(loop, gains, scenario, path))


def _scales(chosen: Selection, scales: Mapping[str, float]) -> Array:
    plain = [scales.get(name.split("[")[0], 1.0) for name in chosen.names]
    return jnp.where(chosen.vector != 0, jnp.abs(chosen.vector), jnp.asarray(plain))


#: operations with a kink or a jump that a law may use without naming it
_KINKED = frozenset({"sign", "abs", "max", "min", "clamp", "floor", "ceil", "round"})
_STAGES = ("sense", "control", "drive", "settle", "plant")


def kinks(loop: Loop, gains: Any, scenario: Scenario, path: Any) -> tuple[str, ...]:
    """The kinks of one tick: where its derivative jumps or vanishes.

    Args:
        loop: What is fixed.
        gains: What is tuned.
        scenario: What is uncertain.
        path: Parameters of the reference.

    Returns:
        One line a stage, e.g. ``control: cell, sign, within``. Those of `numerics.smooth` by their
        names; others by that of the operation.
    """
    carry = jax.eval_shape(lambda g, s, p: start(loop, g, s, p), gains, scenario, path)

    def move(gains: Any, scenario: Scenario, path: Any, carry: Any) -> Any:
        after, _ = tick(loop, gains, scenario, path, carry)
        return after.state, after.memory

    stages: dict[str, set[str]] = {}
    whole = jax.make_jaxpr(move)(gains, scenario, path, carry)
    _collect(whole.jaxpr, "", stages)
    return tuple(f"{s}: {', '.join(sorted(stages[s]))}" for s in _STAGES if s in stages)


def _collect(jaxpr: Any, outer: str, stages: dict[str, set[str]]) -> None:
    """Add the kinks of a jaxpr, and of those inside it, to the set of their stage."""
    for equation in jaxpr.eqns:
        scope = f"{outer}/{equation.source_info.name_stack}"
        parts = re.findall(r"\w+", scope)  # scopes under vmap read vmap(name)
        stage = next((s for s in parts if s in _STAGES), None)
        named = [p.removeprefix(KINK) for p in parts if p.startswith(KINK)]
        floating = any(jnp.issubdtype(v.aval.dtype, jnp.floating) for v in equation.outvars)
        # the ledger reads the motion and does not change it
        if (
            stage
            and "ledger" not in parts
            and floating
            and (named or equation.primitive.name in _KINKED)
        ):
            stages.setdefault(stage, set()).add(named[0] if named else equation.primitive.name)
        for inner in jax.tree.leaves(
            list(equation.params.values()), is_leaf=lambda x: hasattr(x, "eqns")
        ):
            if hasattr(inner, "eqns"):
                _collect(getattr(inner, "jaxpr", inner), scope, stages)
