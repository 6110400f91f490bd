"""Helix about z, run through at constant speed.

    r(t) = (R cos w t, R sin w t, v_z t)

Speed sqrt((R w)^2 + v_z^2) and curvature R w^2 / speed^2 are constant. R = 0 is a straight line,
v_z = 0 a circle, w = 0 a straight line beside the axis; all three 0 is a point, whose tangent is 0.

Source: Science Progress 2021, doi:10.1177/00368504211011847, "screw-shape curve"; the formula is
lost there and the usual one taken.
"""

from functools import cache

import jax.numpy as jnp
from jax import Array

from jaxstage.model.blocks import Reference
from jaxstage.model.fields import param, pytree, replace
from jaxstage.model.signals import Nearest, Setpoint
from jaxstage.numerics.geometry import norm
from jaxstage.references.checked import finite
from jaxstage.references.motion import analytic, float_kind, time_of


@pytree
class Helix:
    """Parameters of a helical motion."""

    radius: Array = param("m", "R", "radius", low=0.0, shown="mm")
    turn_rate: Array = param("rad/s", "w", "angular speed about z")
    climb_rate: Array = param("m/s", "v_z", "speed along z", shown="mm/s")


def helix(radius: float, turn_rate: float, climb_rate: float) -> Helix:
    """Checked parameters of a helix.

    Args:
        radius: R, m, >= 0.
        turn_rate: w, rad/s.
        climb_rate: v_z, m/s.

    Raises:
        ValueError: for a negative radius, NaN or infinity.
    """
    curve = Helix(
        radius=finite("radius", radius),
        turn_rate=finite("turn_rate", turn_rate),
        climb_rate=finite("climb_rate", climb_rate),
    )
    if radius < 0:
        raise ValueError(f"radius must be >= 0 m; got {radius!r}")
    return curve


def _position(curve: Helix, time: Array) -> Array:
    angle = curve.turn_rate * time
    return jnp.stack(
        [curve.radius * jnp.cos(angle), curve.radius * jnp.sin(angle), curve.climb_rate * time]
    )


def _turn(curve: Helix) -> Array:
    turning = curve.turn_rate != 0
    return jnp.where(turning, 2 * jnp.pi / jnp.where(turning, curve.turn_rate, 1), jnp.inf)


@cache
def helical(dt: float) -> Reference[Helix]:
    """Helical motion, computed in the tick; axes x, y, z; parameters `Helix`.

    The arc of the nearest point counts from the start of the motion.

    Args:
        dt: control period in s.
    """
    motion = analytic("helical", _position, dt, _turn)

    def risen(curve: Helix, tick: Array) -> Array:
        """Way along z in the turns before this one, (3,) m, where the time counts from the turn."""
        if float_kind(curve) == jnp.float64:
            return jnp.zeros(3)
        before = time_of(curve, tick, dt) - time_of(curve, tick, dt, _turn)
        return jnp.zeros(3, before.dtype).at[2].set(curve.climb_rate * before)

    def sample(curve: Helix, tick: Array) -> Setpoint:
        setpoint = motion.sample(curve, tick)
        return replace(setpoint, position=setpoint.position + risen(curve, tick))

    def nearest(curve: Helix, tick: Array, tool: Array) -> Nearest:
        up_to = risen(curve, tick)
        point = motion.nearest(curve, tick, tool - up_to)
        point = replace(point, point=point.point + up_to)
        along, up = curve.radius * curve.turn_rate, curve.climb_rate
        speed = norm(jnp.stack([jnp.asarray(along), jnp.asarray(up)]))
        return replace(point, arc=point.arc + speed * jnp.asarray(tick).astype(speed.dtype) * dt)

    return replace(motion, sample=sample, nearest=nearest)
