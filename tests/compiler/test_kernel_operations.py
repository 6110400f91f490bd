"""Operations in a kernel mean what they mean in JAX: every pair of special values."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from jaxstage.compiler.frontend.step_program import StepSpec
from jaxstage.compiler.runtime import api, toolchain
from tests.compiler.test_c99_text import EXACT, VALUES, whole

pytestmark = pytest.mark.skipif(
    isinstance(toolchain.compiler(), str), reason="no C++ compiler here"
)

#: beside those of the C text
MORE = {
    "round_away": lambda a, b: lax.round(a, lax.RoundingMethod.AWAY_FROM_ZERO),
    "zero_over": lambda a, b: 0.0 / a,
    "reciprocal": lambda a, b: 1.0 / a,
    "shift_signed": lambda a, b: lax.shift_right_arithmetic(whole(a), jnp.int32(3)),
    "square": lambda a, b: whole(a) * whole(a),
    "int_min": lambda a, b: jnp.minimum(whole(a), whole(b)),
    "invert": lambda a, b: ~whole(a),
}


def compiled_and_plain(functions, first, second):
    """All functions of every pair: in one kernel, and by JAX."""
    real = first.dtype

    def every(a, b):
        return jnp.stack([f(a, b).astype(real) for f in functions])

    def step(static, inputs, shared, carry):
        return every(*inputs), None

    def one(a, b):
        program, leaves = api.program_of(
            StepSpec(step), (a, b), (), jnp.zeros(len(functions), real)
        )
        assert api.refusal(program) is None, api.refusal(program)
        return api.rollout(program, leaves, 1)[0]

    return (np.asarray(jax.jit(jax.vmap(f))(first, second)) for f in (one, every))


@pytest.mark.parametrize("single", [False, True], ids=["double", "single"])
def test_operations_mean_in_a_kernel_what_they_mean_in_jax(single):
    """No division by 0 ends the process; integers wrap; a zero may have the other sign."""
    real = np.float32 if single else np.float64
    functions = {n: f for n, f in (EXACT | MORE).items() if n not in ("to_uint",) or not single}
    pairs = np.array(list(itertools.product(VALUES, VALUES)), real)
    ours, theirs = compiled_and_plain(
        functions.values(), jnp.asarray(pairs[:, 0]), jnp.asarray(pairs[:, 1])
    )
    wrong = {}
    for name, c, x in zip(functions, ours.T, theirs.T, strict=True):
        same = (c == x) | (np.isnan(c) & np.isnan(x))
        if not same.all():
            wrong[name] = [*zip(pairs[~same].tolist(), c[~same], x[~same], strict=True)][:2]
    assert not wrong, wrong
