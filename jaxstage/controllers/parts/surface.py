"""Sliding variables."""

from jax import Array

from jaxstage.model.signals import Measurement, Setpoint


def errors(setpoint: Setpoint, measurement: Measurement) -> tuple[Array, Array]:
    """Following error e = r - y in m and its rate e' = r' - y' in m/s."""
    return setpoint.position - measurement.position, setpoint.velocity - measurement.velocity


def linear_surface(slope: Array, error: Array, rate: Array) -> Array:
    """s = -(c1 e + e') in m/s. Mao et al. 2021, equation (15)."""
    return -(slope * error + rate)
