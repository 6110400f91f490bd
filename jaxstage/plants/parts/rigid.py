"""A rigid axis: motor and tool are one body, so that both sides of it are measured alike."""

from jax import Array

from jaxstage.model.array_types import PerAxis
from jaxstage.model.fields import pytree, signal
from jaxstage.model.signals import Output


@pytree
class RigidState:
    """State of a machine whose axes are rigid."""

    position: Array = signal("m", "x", "position", shape="(axes,)", shown="mm")
    velocity: Array = signal("m/s", "v", "velocity", shape="(axes,)", shown="mm/s")


def init(params: object, output: Output) -> RigidState:
    """Start at the given output."""
    return RigidState(position=output.position, velocity=output.velocity)


def one_body(position: PerAxis, velocity: PerAxis) -> Output:
    """The output of an axis whose drive moves as the tool does. position: m; velocity: m/s."""
    return Output(
        position=position, velocity=velocity, drive_position=position, drive_velocity=velocity
    )


def observe(params: object, state: RigidState) -> Output:
    """Tool and drive are one body."""
    return one_body(state.position, state.velocity)
