"""C text of single operations and of what is written where, against JAX."""

import itertools
import re
import shutil

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from jaxstage.c_export.law_graph import trace
from jaxstage.c_export.source_files import source
from jaxstage.compiler.ir.errors import LoweringError
from jaxstage.model.blocks import Controller
from jaxstage.model.fields import pytree, replace, signal
from jaxstage.model.signals import Measurement, Setpoint
from tests.helpers.c_driver import drive, identity

pytestmark = [
    pytest.mark.fast,
    pytest.mark.skipif(shutil.which("gcc") is None, reason="no C compiler here"),
]

I32 = jnp.int32


def whole(x):
    return x.astype(I32)


#: functions of two reals; the results are the same to the bit, the sign of a zero too
EXACT = {
    "max": jnp.maximum, "min": jnp.minimum, "add": lambda a, b: a + b, "div": lambda a, b: a / b,
    "clip": lambda a, b: jnp.clip(a, -1.0, 2.0), "sign": lambda a, b: jnp.sign(a),
    "between": lambda a, b: jnp.minimum(jnp.maximum(a, b), a - b),
    "between_zeros": lambda a, b: jnp.clip(a, -0.0 * b, 0.0 * b),
    "abs": lambda a, b: jnp.abs(a), "floor": lambda a, b: jnp.floor(a),
    "ceil": lambda a, b: jnp.ceil(a), "round": lambda a, b: jnp.round(a),
    "sqrt": lambda a, b: jnp.sqrt(a), "fmod": lax.rem,
    "select": lambda a, b: jnp.where(a <= b, a, -b),
    "less": lambda a, b: (a < b).astype(a.dtype), "equal": lambda a, b: (a == b).astype(a.dtype),
    "unequal": lambda a, b: (a != b).astype(a.dtype),
    "finite": lambda a, b: jnp.isfinite(a).astype(a.dtype),
    "either": lambda a, b: ((a > 0) ^ ((b > 0) | ~(a < b))).astype(a.dtype),
    "largest": lambda a, b: jnp.argmax(jnp.stack([a, b, a - b])).astype(a.dtype),
    "to_int": lambda a, b: whole(a), "to_uint": lambda a, b: a.astype(jnp.uint32),
    "int_add": lambda a, b: whole(a) + whole(b), "int_sub": lambda a, b: whole(a) - whole(b),
    "int_mul": lambda a, b: whole(a) * whole(b), "int_neg": lambda a, b: -whole(a),
    "int_abs": lambda a, b: jnp.abs(whole(a)), "int_sign": lambda a, b: jnp.sign(whole(a)),
    "int_max": lambda a, b: jnp.maximum(whole(a), whole(b)),
    "int_div": lambda a, b: lax.div(whole(a), whole(b)),
    "int_rem": lambda a, b: lax.rem(whole(a), whole(b)),
    "floor_div": lambda a, b: whole(a) // whole(b), "mod": lambda a, b: whole(a) % whole(b),
    "floor_div_4": lambda a, b: whole(a) // 4, "mod_7": lambda a, b: whole(a) % 7,
    "bits": lambda a, b: (whole(a) & whole(b)) ^ (whole(a) | ~whole(b)),
    "shift": lambda a, b: lax.shift_left(whole(a), whole(b)),
    "look_up": lambda a, b: (1.5 * jnp.arange(9, dtype=a.dtype))[whole(jnp.clip(a, 3.0, 5.0))],
    "shift_down": lambda a, b: lax.shift_right_logical(whole(a), whole(b)),
}  # fmt: skip

#: the same to a few units in the last place
CLOSE = {
    "exp": jnp.exp, "exp2": jnp.exp2, "expm1": jnp.expm1, "log": jnp.log, "log1p": jnp.log1p,
    "tanh": jnp.tanh, "sinh": lambda a: jnp.sinh(jnp.clip(a, -9, 9)), "atan": jnp.arctan,
    "asinh": jnp.arcsinh, "cbrt": jnp.cbrt, "rsqrt": lax.rsqrt, "logistic": jax.nn.sigmoid,
    "erf": jax.scipy.special.erf, "sin": lambda a: jnp.sin(jnp.clip(a, -9, 9)),
    "cos": lambda a: jnp.cos(jnp.clip(a, -9, 9)),
    "cube": lambda a: a**3, "inverse": lambda a: a**-2,
}  # fmt: skip

VALUES = (
    *(0.0, -0.0, 1.0, -1.0, 0.5, 2.5, -2.5, 7.0, -7.0, 31.0, 32.0, 1e-3, -0.3, 3e9, -3e9, 6e9),
    *(1e30, 2147483647.0, -2147483648.0, np.inf, -np.inf, np.nan),
)


def a_law(function, name="a law"):
    """A law without gains and memory: demand = function(position, velocity)."""
    return Controller(
        name=name,
        init=lambda gains, setpoint, seen: (),
        control=lambda gains, memory, setpoint, seen, dt: (
            function(setpoint.position, seen.position),
            (),
        ),
    )


def samples(first, second):
    """Setpoint and measurement that hold two arrays (ticks, axes)."""
    none = np.zeros_like(first)
    setpoint = Setpoint(
        position=first, velocity=none, acceleration=none, tangent=none, curvature=none[:, 0]
    )
    return setpoint, Measurement(
        position=second, velocity=none, drive_position=none, drive_velocity=none
    )


@pytest.mark.parametrize("single", [False, True], ids=["double", "single"])
def test_operations_mean_in_c_what_they_mean_in_jax(single, tmp_path):
    """Every pair of special values: NaN, infinities, both zeros, integers that overflow."""
    real = np.float32 if single else np.float64
    functions = [*EXACT.values(), *(lambda a, b, f=f: f(a) for f in CLOSE.values())]
    count = len(functions)

    def every(first, second):
        return jnp.stack([f(first[0], second[0]).astype(real) for f in functions])

    pairs = np.array(list(itertools.product(VALUES, VALUES)), real)
    first, second = (np.repeat(pairs[:, i : i + 1], count, axis=1) for i in (0, 1))
    law = a_law(every)
    found, _ = drive(law, (), *samples(first, second), np.zeros_like(first), 1e-3, tmp_path, single)
    with jax.enable_x64(not single):
        wanted = np.asarray(jax.jit(jax.vmap(every))(first, second))
    for i, name in enumerate([*EXACT, *CLOSE]):
        c, x = found[:, i], wanted[:, i]
        if name in EXACT:
            same = (c == x) & (np.signbit(c) == np.signbit(x)) | np.isnan(c) & np.isnan(x)
        else:
            few = 8 * np.finfo(real).eps
            same = np.isclose(c, x, rtol=few, atol=np.finfo(real).tiny, equal_nan=True)
        assert same.all(), (name, pairs[~same][:5], c[~same][:5], x[~same][:5])


@pytree
class Hazards:
    """A memory whose parts become one another."""

    first: jax.Array = signal("1", "", "becomes the second")
    second: jax.Array = signal("1", "", "becomes the first")
    queue: jax.Array = signal("1", "", "last values, newest first", shape="(9,)")
    before: jax.Array = signal("1", "", "the queue before", shape="(9,)")
    ring: jax.Array = signal("1", "", "last values, by number", shape="(8,)")
    weights: jax.Array = signal("1", "", "sums by cell", shape="(3, 4)")
    marks: jax.Array = signal("1", "", "values of the first ticks of a round", shape="(4,)")
    tail: jax.Array = signal("1", "", "forgets by half", shape="(9,)")
    total: jax.Array = signal("1", "", "sum of the tail before")
    log: jax.Array = signal("1", "", "measured values, by number", shape="(8,)")
    constant: jax.Array = signal("1", "", "as at the start", shape="(5,)")
    at: jax.Array = signal("1", "", "number of the newest")
    odd: jax.Array = signal("1", "", "whether it is odd")


def hazardous():
    """A law with a swap, a queue, a ring, a table with cells that coincide, a number and a flag."""

    def init(gains, setpoint, seen):
        zero = jnp.zeros_like(setpoint.position[0])
        return Hazards(
            first=zero + 1, second=setpoint.position[0], queue=jnp.stack([zero] * 9),
            before=jnp.stack([zero + 2] * 9), ring=jnp.stack([zero] * 8),
            weights=jnp.stack([jnp.stack([zero] * 4)] * 3), marks=jnp.stack([zero] * 4),
            tail=jnp.stack([zero + 1] * 9), total=zero, log=jnp.stack([zero] * 8),
            constant=jnp.stack([zero + 3] * 5), at=jnp.zeros((), I32), odd=jnp.zeros((), bool),
        )  # fmt: skip

    def control(gains, memory, setpoint, seen, dt):
        x, y = setpoint.position[0], seen.position[0]
        at = jnp.clip(memory.at, 0, 7)
        ring = memory.ring.at[at].set(x)
        row = jnp.clip(jnp.floor(x), 0, 2).astype(I32)
        column = jnp.clip(jnp.floor(y), 0, 3).astype(I32)
        weights = memory.weights.at[row, column].add(x).at[2 - row, 1].multiply(0.5)
        kept = replace(
            memory, first=memory.second, second=memory.first + x,
            queue=jnp.concatenate([x[None], memory.queue[:-1]]), before=memory.queue, ring=ring,
            weights=weights, marks=jnp.where(memory.at == jnp.arange(4), x, memory.marks),
            tail=0.5 * memory.tail + memory.first, total=jnp.sum(memory.tail),
            log=memory.log.at[7 - at].set(y), odd=~memory.odd,
            at=jnp.where(memory.at >= 7, 0, memory.at + 1),
        )  # fmt: skip
        demand = jnp.stack([
            kept.first, kept.second, ring[7 - at] + memory.ring[at], jnp.sum(memory.before),
            memory.weights[row, column], jnp.sum(weights[row]), memory.at.astype(x.dtype),
            jnp.where(memory.odd, x, y), memory.constant[0], jnp.sum(kept.queue),
            memory.marks[0] - memory.marks[3], memory.total, memory.log[2],
        ])  # fmt: skip
        return demand, kept

    def settle(gains, memory, demand, command, dt):
        cut = command - demand
        return replace(
            memory, first=memory.second + cut[0], second=memory.first,
            queue=memory.queue + jnp.where(memory.odd, demand[1], command[1]),
        )  # fmt: skip

    return Controller(name="hazards", init=init, control=control, settle=settle)


def test_memory_is_written_when_nothing_reads_it_any_more(tmp_path):
    law, periods, axes = hazardous(), 60, 13
    rng = np.random.default_rng(5)
    first, second = (np.repeat(rng.uniform(-1, 5, (periods, 1)), axes, axis=1) for _ in range(2))
    first[7], second[9], first[11] = np.nan, np.nan, 1e20  # an index of NaN is 0
    setpoint, seen = samples(first, second)
    command = rng.uniform(-1, 1, (periods, axes))
    demands, memories = [], []
    memory = law.init((), *jax.tree.map(lambda x: jnp.asarray(x[0]), (setpoint, seen)))
    step, settle = (jax.jit(f, static_argnums=4) for f in (law.control, law.settle))
    for k in range(periods):
        now = jax.tree.map(lambda x, k=k: jnp.asarray(x[k]), (setpoint, seen))
        demand, memory = step((), memory, *now, 1e-3)
        demands.append(demand)
        memory = settle((), memory, demand, jnp.asarray(command[k]), 1e-3)
        memories.append(memory)
    found, _ = drive(law, (), setpoint, seen, command, 1e-3, tmp_path)
    np.testing.assert_allclose(found, np.array(demands), rtol=1e-13)
    text = (tmp_path / "control.c").read_text()
    assert re.search(r"memory->log\[n\d+\] = ", text) and "for (int32_t i = 0; i < 8; i++)" in text
    assert re.search(r"i < 9; i\+\+\)\n +sum\d+ \+= memory->before\[i\];", text)
    assert re.search(r"i < 9; i\+\+\)\n +memory->queue\[i\] = memory->queue\[i\] \+ x\d+;", text)
    assert max(map(len, text.splitlines())) <= 100


def test_what_has_no_c_text_is_refused_with_its_reason():
    sample = jax.tree.map(lambda x: x[0], samples(np.ones((1, 2)), np.ones((1, 2))))
    law = a_law(lambda a, b: jax.scipy.special.erfinv(a), "inverse")
    with pytest.raises(LoweringError, match="'erf_inv' has no C text"):
        source(trace(law, (), *sample, 1e-3, "A"), identity(law, 2))
    law = a_law(lambda a, b: lax.while_loop(lambda x: x[0] < 9, lambda x: x * 2, a))
    with pytest.raises(LoweringError, match="while"):
        trace(law, (), *sample, 1e-3, "A")
