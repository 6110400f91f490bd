"""A bench for one law: two control periods with a given error, behind a drive that saturates."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from batteries import DT, ENTRIES, seen, setpoint

#: error (m), rate (m/s), setpoint velocity (m/s) and acceleration (m/s2) of x and y
MOVING = ([1.2e-3, -0.7e-3], [0.012, -0.02], [0.15, -0.04], [0.3, 0.8])
CASES = {
    "moving": MOVING,
    "zero error": ([0, 0], [0, 0], [0.15, -0.04], [0.3, 0.8]),
    "rest": ([0, 0], [0, 0], [0, 0], [0, 0]),
    "reversal": ([1e-5, -1e-5], [1e-9, -1e-9], [0, 1e-300], [-1, 1]),
    "far off": ([5, -5], [100, -100], [1, 1], [50, -50]),
}


def bench(case, dtype=jnp.float64):
    """Setpoint and measurement with the given error and rate."""
    error, rate, velocity, acceleration = (np.asarray(x, float) for x in case)
    wanted = setpoint([0.02, -0.01], velocity, acceleration, dtype)
    return wanted, seen([0.02, -0.01] - error, velocity - rate, dtype)


def ticks(law, gains, pair, limit=0.3, count=2):
    """``count`` periods with a fixed error and a drive that saturates: demands and memory."""
    wanted, measured = pair
    memory, demands = law.init(gains, wanted, measured), []
    for _ in range(count):
        demand, memory = law.control(gains, memory, wanted, measured, DT)
        memory = law.settle(gains, memory, demand, jnp.clip(demand, -limit, limit), DT)
        demands.append(demand)
    return jnp.stack(demands), memory


@functools.cache
def compiled(name, dtype=jnp.float64):
    """`ticks` of an entry as one compiled function of gains, setpoint, measurement and limit."""
    (law,) = (entry.make() for entry in ENTRIES if entry.name == name)
    return jax.jit(lambda gains, pair, limit: ticks(law, gains, pair, limit))


def close(a, b, rtol, atol=0.0):
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, rtol=rtol, atol=atol), a, b)
