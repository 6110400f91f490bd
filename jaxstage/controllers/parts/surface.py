"""Following error and linear sliding surface."""

from jax import Array

from jaxstage.model.signals import Measurement, Setpoint


def errors(setpoint: Setpoint, measurement: Measurement) -> tuple[Array, Array]:
    """Following error e = r - y in m and its rate e' = r' - y' in m/s, in the shape of r."""
    return setpoint.position - measurement.position, setpoint.velocity - measurement.velocity


def linear_surface(slope: Array, error: Array, rate: Array) -> Array:
    """Linear sliding variable s = -(c1 e + e') in m/s.

    Source: Mao et al., Energies 2021, 14, 7802, equation (15).

    Args:
        slope: c1, 1/s.
        error: e, m.
        rate: e', m/s.
    """
    return -(slope * error + rate)
