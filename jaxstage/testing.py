"""The contract of a control law, as checks that any law can be put through.

    from jaxstage.testing import check_controller

    for check in check_controller(per_axis(my_law), my_gains):
        print(check.text())

Every law of the library passes these checks. Each is a function of its own that raises
AssertionError with what is wrong. They look at a few control periods with given errors, behind a
drive that saturates: moving, at rest, at a reversal, with zero error, and far off. Double precision
must be switched on.
"""

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxstage.model.blocks import Controller
from jaxstage.model.fields import leaves
from jaxstage.model.settings import apply, read_toml, to_toml
from jaxstage.model.signals import Measurement, Scenario, Setpoint, Start

#: control period in s
DT = 1e-4
#: error (m), its rate (m/s), velocity (m/s) and acceleration (m/s2) of the setpoint
MOVING = ([1.2e-3, -0.7e-3], [0.012, -0.02], [0.15, -0.04], [0.3, 0.8])
CASES = {
    "moving": MOVING,
    "zero error": ([0, 0], [0, 0], [0.15, -0.04], [0.3, 0.8]),
    "rest": ([0, 0], [0, 0], [0, 0], [0, 0]),
    "reversal": ([1e-5, -1e-5], [1e-9, -1e-9], [0, 1e-300], [-1, 1]),
    "far off": ([5, -5], [100, -100], [1, 1], [50, -50]),
}

Pair = tuple[Setpoint, Measurement]
#: (gains, pair, limit) -> demands (periods, axes) and the memory after them
Run = Callable[[Any, Pair, Any], tuple[Any, Any]]


def cast(tree: Any, dtype: Any = jnp.float64) -> Any:
    """The tree with every leaf a strong array of one type."""
    return jax.tree.map(lambda x: jnp.asarray(x, dtype), tree)


def bench(case: Any, dtype: Any = jnp.float64, axes: int = 2) -> Pair:
    """Setpoint and measurement of a rigid machine with the errors of a case of `CASES`."""
    sized = (jnp.asarray(np.resize(np.asarray(x, float), axes)) for x in case)
    error, rate, velocity, acceleration = sized
    position = jnp.asarray(np.resize([0.02, -0.01], axes))
    setpoint = Setpoint(
        position=position,
        velocity=velocity,
        acceleration=acceleration,
        tangent=jnp.eye(axes)[0],
        curvature=jnp.zeros(()),
    )
    x, v = position - error, velocity - rate
    seen = Measurement(position=x, velocity=v, drive_position=x, drive_velocity=v)
    return cast(setpoint, dtype), cast(seen, dtype)


def ticks(
    law: Controller, gains: Any, pair: Pair, limit: Any = 0.3, count: int = 2, dt: float = DT
) -> tuple[Any, Any]:
    """``count`` periods with a fixed error behind a drive that saturates: demands and memory."""
    setpoint, measured = pair
    memory, demands = law.init(gains, setpoint, measured), []
    for _ in range(count):
        demand, memory = law.control(gains, memory, setpoint, measured, dt)
        memory = law.settle(gains, memory, demand, jnp.clip(demand, -limit, limit), dt)
        demands.append(demand)
    return jnp.stack(demands), memory


def compiled(law: Controller, dt: float = DT) -> Run:
    """`ticks` of a law as one compiled function of gains, pair and limit."""
    return jax.jit(lambda gains, pair, limit: ticks(law, gains, pair, limit, dt=dt))


def close(a: Any, b: Any, rtol: float, atol: float = 0.0) -> None:
    """Two trees agree, leaf by leaf."""
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, rtol=rtol, atol=atol), a, b)


# --- the checks ------------------------------------------------------------------------------


def _kinds(tree: Any) -> Any:
    described = jax.tree.map(lambda x: (x.shape, str(x.dtype), x.weak_type), tree)
    return jax.tree.structure(tree), jax.tree.leaves(described)


def memory_keeps_its_kind(
    law: Controller, gains: Any, dtype: Any = jnp.float64, axes: int = 2, dt: float = DT
) -> None:
    """Memory keeps structure, shapes and types, so that a scan accepts it and nothing retraces."""
    setpoint, measured = bench(MOVING, dtype, axes)

    def period(gains: Any, setpoint: Setpoint, measured: Measurement) -> Any:
        before = law.init(gains, setpoint, measured)
        demand, controlled = law.control(gains, before, setpoint, measured, dt)
        return demand, before, controlled, law.settle(gains, controlled, demand, demand, dt)

    demand, before, controlled, settled = jax.eval_shape(
        period, cast(gains, dtype), setpoint, measured
    )
    assert demand.shape == (axes,), f"the demand has shape {demand.shape}, not {(axes,)}"
    assert demand.dtype == dtype and not demand.weak_type, f"the demand is {demand.dtype}"
    assert _kinds(before) == _kinds(controlled), "control changes the kind of the memory"
    assert _kinds(before) == _kinds(settled), "settle changes the kind of the memory"
    wrong = [x for x in jax.tree.leaves(settled) if x.dtype != dtype or x.weak_type]
    assert not wrong, f"the memory holds {wrong[0]}, not {np.dtype(dtype)}"


def finite_everywhere(run: Run, gains: Any, axes: int = 2) -> None:
    """Demand and memory are finite in every case, also where the drive gives next to nothing."""
    for name, case in CASES.items():
        for limit in (np.inf, 1e-3):
            result = run(cast(gains), bench(case, axes=axes), limit)
            finite = all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(result))
            assert finite, f"{name}: demand or memory is not finite"


def compiled_equals_eager(
    law: Controller, run: Run, gains: Any, axes: int = 2, dt: float = DT
) -> None:
    """Compiled, the law gives the numbers that it gives step by step."""
    pair = bench(MOVING, axes=axes)
    eager = ticks(law, cast(gains), pair, dt=dt)
    close(run(cast(gains), pair, 0.3), eager, rtol=1e-11, atol=1e-14)


def batch_equals_single(run: Run, gains: Any, axes: int = 2) -> None:
    """Many gains at once give what each gives alone."""
    pair = bench(MOVING, axes=axes)
    some = [
        jax.tree.map(lambda x, c=c: x * c + (c - 1) * 1e-3, cast(gains)) for c in (0.8, 1.0, 1.3)
    ]
    stacked = jax.tree.map(lambda *x: jnp.stack(x), *some)
    many = jax.vmap(lambda g: run(g, pair, 0.3))(stacked)
    for i, one in enumerate(some):
        close(jax.tree.map(lambda x, i=i: x[i], many), run(one, pair, 0.3), 1e-11, 1e-14)


def gradients_agree(law: Controller, gains: Any, axes: int = 2, dt: float = DT) -> None:
    """By gains, setpoint and measurement: finite in every case; forward mode equals reverse mode
    and central differences while moving."""
    gains = cast(gains)
    weights = jnp.broadcast_to(jnp.asarray(np.resize([0.7, -1.3], axes)), (2, axes))
    rng = np.random.default_rng(0)
    direction = jax.tree.map(
        lambda x: jnp.asarray(rng.uniform(0.5, 1, x.shape) * np.where(x == 0, 1e-3, x)), gains
    )

    def objective(g: Any, pair: Pair) -> Any:
        demands, memory = ticks(law, g, pair, limit=0.05, dt=dt)
        return jnp.sum(demands * weights) + sum(jnp.sum(m) for m in jax.tree.leaves(memory))

    @jax.jit
    def slopes(g: Any, pair: Pair, d: Any) -> Any:
        forward = jax.jvp(lambda x: objective(x, pair), (g,), (d,))
        return forward, jax.grad(objective, argnums=(0, 1))(g, pair)

    for name, case in CASES.items():
        slope = slopes(gains, bench(case, axes=axes), direction)
        finite = all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(slope))
        assert finite, f"{name}: a derivative is not finite"
    pair = bench(MOVING, axes=axes)
    (_, forward), (reverse, _) = slopes(gains, pair, direction)
    assert forward != 0, "no gain has an effect"
    pairs = zip(jax.tree.leaves(reverse), jax.tree.leaves(direction), strict=True)
    np.testing.assert_allclose(sum(np.vdot(a, b) for a, b in pairs), forward, rtol=1e-10)
    h = 1e-6
    up, down = (
        slopes(jax.tree.map(lambda x, d, s=s: x + s * d, gains, direction), pair, direction)[0][0]
        for s in (h, -h)
    )
    np.testing.assert_allclose((up - down) / (2 * h), forward, rtol=5e-6)


def gains_survive_a_file(gains: Any) -> None:
    """Written as TOML and read back, the gains are the same, bit for bit."""
    rng = np.random.default_rng(1)
    changed = jax.tree.map(lambda x: jnp.asarray(x * rng.uniform(0.5, 2, np.shape(x))), gains)
    nothing = Start(offset=jnp.zeros(1), velocity=jnp.zeros(1))
    scenario = Scenario(
        plant=(), load=(), sensor=(), drive=(), start=nothing, key=jax.random.key(0)
    )
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "gains.toml"
        file.write_text(to_toml({"gains": changed}))
        back, _, _, paths = apply(cast(gains), scenario, read_toml(file).values)
    assert jax.tree.structure(back) == jax.tree.structure(changed), "the structure changed"
    assert len(paths) == len(jax.tree.leaves(gains)), "not every gain is in the file"
    jax.tree.map(np.testing.assert_array_equal, back, changed)


def fields_are_described(law: Controller, gains: Any, axes: int = 2) -> None:
    """Every gain has unit, meaning and symbol, every number of the memory unit and meaning."""
    memory = law.init(cast(gains), *bench(MOVING, axes=axes))
    for tree in (gains, memory):
        described = list(leaves(tree))
        assert len(described) == len(jax.tree.leaves(tree)), "a number stands in no field"
        for path, quantity, _ in described:
            assert quantity.unit and quantity.doc, f"{path} has no unit or no meaning"
    bare = [path for path, quantity, _ in leaves(gains) if not quantity.symbol]
    assert not bare, f"no symbol: {', '.join(bare)}"


def single_follows_double(run: Run, single: Run, gains: Any, axes: int = 2) -> None:
    """In single precision the demand is that of double precision to a thousandth.

    Errors are differences of positions of 20 mm: 2e-9 m of rounding, times the stiffest law.
    """
    for name in ("moving", "zero error", "rest"):
        fine, _ = run(cast(gains), bench(CASES[name], axes=axes), 0.3)
        low = jnp.float32
        coarse, _ = single(cast(gains, low), bench(CASES[name], low, axes), 0.3)
        assert coarse.dtype == low, f"{name}: the demand is {coarse.dtype}"
        scale = np.abs(fine).max() + 0.02
        np.testing.assert_allclose(coarse[0], fine[0], atol=1e-3 * scale, err_msg=name)


# --- all of them -----------------------------------------------------------------------------


class Check(NamedTuple):
    """What became of a check. said: what is wrong, or an empty text."""

    name: str
    passed: bool
    said: str

    def text(self) -> str:
        """One line."""
        return f"{'passed' if self.passed else 'FAILED'}  {self.name}" + (
            f": {self.said}" if self.said else ""
        )


def check_controller(
    law: Controller, gains: Any, axes: int = 2, dt: float = DT
) -> tuple[Check, ...]:
    """Put a law for the whole machine through all checks.

    gains: as for `simulate`. axes: of the machine. dt: control period in s. Raises ValueError where
    double precision is not switched on.
    """
    if jnp.zeros(()).dtype != jnp.float64:
        raise ValueError('the checks need double precision: configure(precision="double") first')
    run, single = compiled(law, dt), compiled(law, dt)
    checks: dict[str, Callable[[], None]] = {
        "memory keeps its kind": lambda: memory_keeps_its_kind(law, gains, axes=axes, dt=dt),
        "memory keeps its kind, single precision": lambda: memory_keeps_its_kind(
            law, gains, jnp.float32, axes, dt
        ),
        "finite everywhere": lambda: finite_everywhere(run, gains, axes),
        "compiled equals eager": lambda: compiled_equals_eager(law, run, gains, axes, dt),
        "batch equals single": lambda: batch_equals_single(run, gains, axes),
        "gradients agree": lambda: gradients_agree(law, gains, axes, dt),
        "gains survive a file": lambda: gains_survive_a_file(gains),
        "fields are described": lambda: fields_are_described(law, gains, axes),
        "single follows double": lambda: single_follows_double(run, single, gains, axes),
    }
    return tuple(_result(name, check) for name, check in checks.items())


def _result(name: str, check: Callable[[], None]) -> Check:
    try:
        check()
    except Exception as error:  # a law may fail in any way: that is what is asked
        lines = [line.strip() for line in str(error).splitlines() if line.strip()]
        said = " ".join(lines[:4]) or type(error).__name__
        return Check(name, False, said)
    return Check(name, True, "")
