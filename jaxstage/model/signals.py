"""What crosses the borders between modules: the data of one control period, and of a run.

Shapes are those of ONE run; ``axes`` is the number of axes. Everything is SI. No function of the
library takes a batch axis: batches are made by ``jax.vmap``.
"""

from typing import Any

from jax import Array

from jaxstage.model.fields import param, part, pytree, signal


@pytree
class Setpoint:
    """The commanded motion at one instant."""

    position: Array = signal("m", "r", "commanded position", shape="(axes,)", shown="mm")
    velocity: Array = signal("m/s", "r'", "commanded velocity", shape="(axes,)", shown="mm/s")
    acceleration: Array = signal("m/s2", "r''", "commanded acceleration", shape="(axes,)")
    tangent: Array = signal("1", "t", "unit tangent of the curve (exists at rest)", shape="(axes,)")
    curvature: Array = signal("1/m", "kappa", "curvature of the curve")


@pytree
class Output:
    """The truth: the tool side (what cuts) and the drive side (motor, in tool units)."""

    position: Array = signal("m", "x", "tool position", shape="(axes,)", shown="mm")
    velocity: Array = signal("m/s", "v", "tool velocity", shape="(axes,)", shown="mm/s")
    drive_position: Array = signal("m", "x_d", "drive position", shape="(axes,)", shown="mm")
    drive_velocity: Array = signal("m/s", "v_d", "drive velocity", shape="(axes,)", shown="mm/s")


@pytree
class Measurement:
    """What the controller sees of the `Output`."""

    position: Array = signal("m", "y", "measured tool position", shape="(axes,)", shown="mm")
    velocity: Array = signal("m/s", "y'", "measured tool velocity", shape="(axes,)", shown="mm/s")
    drive_position: Array = signal("m", "y_d", "measured drive position", shape="(axes,)")
    drive_velocity: Array = signal("m/s", "y_d'", "measured drive velocity", shape="(axes,)")


@pytree
class Power:
    """Mean power of each axis over a substep or period.

    Each term has its own formula, so that ``mechanical - dissipated - load = change of stored
    energy`` is a check of the plant; the supply delivers ``copper + mechanical``.
    """

    copper: Array = signal("W", "P_cu", "resistive loss of the motor", shape="(axes,)")
    mechanical: Array = signal("W", "P_m", "motor force times velocity", shape="(axes,)")
    dissipated: Array = signal("W", "P_d", "friction and damping", shape="(axes,)")
    load: Array = signal("W", "P_L", "work against all external forces", shape="(axes,)")
    drawn: Array = signal("W", "P", "what the mains sees", shape="(axes,)")


@pytree
class Nearest:
    """The point of the reference curve nearest to the tool, on the branch being followed."""

    point: Array = signal("m", "c", "nearest point", shape="(axes,)", shown="mm")
    distance: Array = signal("m", "eps", "contour error", shown="um")
    arc: Array = signal(
        "m",
        "s",
        "arc length of the nearest point in the lap, or from the commanded one",
        shown="mm",
    )
    reach: Array = signal("m", "", "arc length searched either side of the commanded point")


@pytree
class Start:
    """Where and how a run begins."""

    offset: Array = param("m", "x0", "displacement from the start of the path", shape="(axes,)")
    velocity: Array = param(
        "1", "v0", "fraction of the reference velocity: 0 at rest, 1 matched", shape="(axes,)"
    )


@pytree
class Scenario:
    """All that is uncertain about a run."""

    plant: Any = part("parameters of the plant")
    load: Any = part("parameters of the load")
    sensor: Any = part("parameters of the sensor")
    drive: Any = part("parameters of the drive")
    start: Start = part("where the run begins")
    key: Array = part("random key; the draws of tick k depend on (key, k) alone")


@pytree
class Sample:
    """One control period: values at its START; power and `between` over the step that follows."""

    step: Array = signal("1", "k", "tick, counted from the start of the run")
    time: Array = signal("s", "t", "time of the tick")
    setpoint: Setpoint = part("commanded motion")
    output: Output = part("the truth")
    nearest: Nearest = part("nearest point of the curve to the tool")
    between: Output = part("the truth at the end of each substep, (substeps, axes)")
    measurement: Measurement = part("what the controller saw")
    memory: Any = part("controller memory that made the demand")
    demand: Array = signal("command", "u_d", "what the controller asked for", shape="(axes,)")
    command: Array = signal(
        "command", "u", "the demand within the limits of the drive", shape="(axes,)"
    )
    applied: Array = signal(
        "command", "u_a", "what reached the plant, after delay/lag", shape="(axes,)"
    )
    load: Array = signal("N", "F", "force of the load block at the tick", shape="(axes,)")
    power: Power = part("mean power over the period")
    storing: Array = signal("W", "", "mean rate of the stored energy", shape="(axes,)")


@pytree
class Carry:
    """All that one tick hands to the next. A run continues from it exactly."""

    state: Any = part("state of the plant")
    drive: Any = part("memory of the drive")
    sensor: Any = part("memory of the sensor")
    memory: Any = part("memory of the controller")
    metric: Any = part("sums of the metrics")
    step: Array = signal("1", "k", "ticks done")
    left_path_at: Array = signal("1", "", "tick at which the tool left the path, or -1")
    non_finite_at: Array = signal("1", "", "tick at which a value stopped being finite, or -1")


@pytree
class Run:
    """The result of a simulation."""

    report: Any = part("what the metric finished with; NaN where the run was lost")
    rows: Any = part("recorded rows, one per tick, or None")
    final: Carry = part("where the run stopped; `simulate(..., carry=run.final)` goes on")
