"""Binding-time analysis: what all runs share, and what each run computes for itself.

Every value of a step has a level: what it depends on at most. What depends on shared arrays and the
tick alone is the same in every run: JAX computes it once, and a kernel reads it. Calls are put in
line first, equal equations are one, and what nobody reads is left out.
"""

from typing import Any, NamedTuple

import numpy as np

from jaxstage.compiler.frontend.jax_compat import CALLS, SAME, Literal, called, typed

#: what a value depends on: nothing, shared arrays, the tick too, the run
CONSTANT, FIXED, TICK, RUN = range(4)


class Immediate(NamedTuple):
    """A number that stands in the program."""

    value: Any


class FlatEquation(NamedTuple):
    """An equation of a jaxpr between numbered values.

    Attributes:
        equation: The equation, for its primitive and parameters.
        reads: Numbers of its operands; `Immediate` for literals.
        writes: Numbers of its results.
    """

    equation: Any
    reads: tuple[Any, ...]
    writes: tuple[int, ...]


class FlatJaxpr(NamedTuple):
    """A jaxpr without calls: every value has a number.

    Attributes:
        steps: Its equations in order.
        arguments: Numbers of its arguments.
        results: Numbers of its results; `Immediate` for literals.
        constants: Values that it closes over, by number.
    """

    steps: tuple[FlatEquation, ...]
    arguments: tuple[int, ...]
    results: tuple[Any, ...]
    constants: dict[int, Any]


class Staged(NamedTuple):
    """A program whose values have levels.

    Attributes:
        program: Its equations.
        level: Number of a value -> `CONSTANT`, `FIXED`, `TICK` or `RUN`.
    """

    program: FlatJaxpr
    level: dict[int, int]

    def of(self, value: Any) -> int:
        """The level of a value or literal."""
        return CONSTANT if isinstance(value, Immediate) else self.level[value]

    def shared(self, level: int) -> list[FlatEquation]:
        """The steps of one level."""
        return [s for s in self.program.steps if self._own(s) == level]

    def per_run(self) -> list[FlatEquation]:
        """The steps that every run takes, and those on constants."""
        return [s for s in self.program.steps if self._own(s) in (CONSTANT, RUN)]

    def _own(self, step: FlatEquation) -> int:
        return max((self.of(v) for v in step.reads), default=CONSTANT)

    def crossing(self) -> list[int]:
        """Values that all runs share and that the steps of a run, or the results, need."""
        reads = [v for s in self.per_run() for v in s.reads]
        reads += list(self.program.results)
        return sorted({v for v in reads if self.of(v) in (FIXED, TICK)})


def inline_calls(closed: Any) -> FlatJaxpr:
    """The steps of a closed jaxpr, without calls and without what nobody reads."""
    steps: list[FlatEquation] = []
    constants: dict[int, Any] = {}
    known: dict[Any, tuple[int, ...]] = {}
    count = iter(range(1 << 60))

    def walk(jaxpr: Any, consts: Any, reads: list[Any]) -> list[Any]:
        env: dict[Any, Any] = dict(zip(jaxpr.invars, reads, strict=True))
        for var, value in zip(jaxpr.constvars, consts, strict=True):
            env[var] = next(count)
            constants[env[var]] = value

        def read(var: Any) -> Any:
            if isinstance(var, Literal):
                return Immediate(typed(var))
            return env[var]

        for equation in jaxpr.eqns:
            inputs = [read(v) for v in equation.invars]
            if equation.primitive.name in SAME:
                env.update(zip(equation.outvars, inputs, strict=True))
                continue
            if equation.primitive.name in CALLS and equation.params.get("name") != "floor_divide":
                inner, held = called(equation.params)
                env.update(zip(equation.outvars, walk(inner, held, inputs), strict=True))
                continue
            key = _key(equation, inputs)
            if key not in known:
                known[key] = tuple(next(count) for _ in equation.outvars)
                steps.append(FlatEquation(equation, tuple(inputs), known[key]))
            env.update(zip(equation.outvars, known[key], strict=True))
        return [read(v) for v in jaxpr.outvars]

    arguments = [next(count) for _ in closed.jaxpr.invars]
    results = walk(closed.jaxpr, closed.consts, list(arguments))
    return FlatJaxpr(_needed(steps, results), tuple(arguments), tuple(results), constants)


def _key(equation: Any, reads: list[Any]) -> Any:
    """What two equations have in common that compute the same; nothing where one holds others."""
    params = equation.params
    values = (x for v in params.values() for x in (v if isinstance(v, tuple | list) else (v,)))
    if any(hasattr(x, "eqns") for x in values):
        return id(equation), object()
    same = [
        (type(v.value).__name__, str(getattr(v.value, "dtype", "")), str(v.value))
        if isinstance(v, Immediate)
        else v
        for v in reads
    ]
    return equation.primitive.name, str(params), tuple(same)


def _needed(steps: list[FlatEquation], results: list[Any]) -> tuple[FlatEquation, ...]:
    needed = {v for v in results if isinstance(v, int)}
    kept = []
    for step in reversed(steps):
        if needed.intersection(step.writes):
            kept.append(step)
            needed.update(v for v in step.reads if isinstance(v, int))
    return tuple(reversed(kept))


def counters(program: FlatJaxpr, carry: range) -> tuple[int, ...]:
    """Induction variables: the carried integers that every tick raises by one.

    Args:
        program: One tick.
        carry: Positions of the carry among the arguments; it comes first among the results.

    Returns:
        Their numbers in the carry.
    """
    writers = {w: s for s in program.steps for w in s.writes}
    counting = []
    for number, position in enumerate(carry):
        result = program.results[number]
        step = writers.get(result) if isinstance(result, int) else None
        if step is None or step.equation.primitive.name != "add":
            continue
        whole = np.issubdtype(step.equation.outvars[0].aval.dtype, np.integer)
        a, b = step.reads
        one = isinstance(b, Immediate) and np.ndim(b.value) == 0 and b.value == 1
        if whole and one and a == program.arguments[position]:
            counting.append(number)
    return tuple(counting)


def binding_times(program: FlatJaxpr, levels: list[int]) -> Staged:
    """Propagate levels: a result has the highest level among its operands.

    Args:
        program: The equations.
        levels: Of the arguments.
    """
    level = dict(zip(program.arguments, levels, strict=True))
    level |= dict.fromkeys(program.constants, CONSTANT)
    for step in program.steps:
        top = max((level[v] for v in step.reads if not isinstance(v, Immediate)), default=CONSTANT)
        level |= dict.fromkeys(step.writes, top)
    return Staged(program, level)


def run(steps: list[FlatEquation], values: dict[int, Any]) -> None:
    """Evaluate equations with JAX.

    Args:
        steps: In order.
        values: By number; gets those of the results.
    """
    for step in steps:
        reads = [v.value if isinstance(v, Immediate) else values[v] for v in step.reads]
        result = step.equation.primitive.bind(*reads, **step.equation.params)
        many = step.equation.primitive.multiple_results
        values.update(zip(step.writes, result if many else [result], strict=True))
