"""A control law as C99: text for a drive, and the ticks of a simulation that it is checked with.

    run = simulate(replace(loop, metric=record), gains, scenario, path, 1000)
    files = c_files("my-loop", loop, gains, scenario, run.rows, "1.0", single=True)  # name -> text

The law is traced into scalar operations once and written out for the shapes, the control period and
the precision it has here; gains and memory stay variables. `tuning` writes the files into a folder.
"""

import functools
import re
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxstage.c_export.law_graph import LawGraph, coupled, of_axis, trace
from jaxstage.c_export.replay import RecordedTicks, makefile, readme, recorded_header, replay_source
from jaxstage.c_export.source_files import Identity, gains_source, header, source
from jaxstage.compiler.ir.errors import LoweringError
from jaxstage.model.blocks import Loop
from jaxstage.model.signals import Sample, Scenario
from jaxstage.model.validate import check_leaves, strong


def c_files(
    name: str,
    loop: Loop,
    gains: Any,
    scenario: Scenario,
    rows: Sample,
    version: str,
    single: bool = False,
    axis: str | None = None,
    prefix: str = "control",
) -> dict[str, str]:
    """The controller of a loop as C files.

    Args:
        name: Of the loop.
        loop: Its law, control period and drive.
        gains: What is exported.
        scenario: Its drive limits the recorded demands.
        rows: What the metric `record` stored of a run of the loop, in double precision.
        version: Written into every file.
        single: ``float`` in place of ``double``.
        axis: One axis alone, for a law in which none depends on another.
        prefix: Begins every name in C.

    Returns:
        Name of a file -> its text.

    Raises:
        ValueError: Gains are out of range, an axis is unknown, axes are coupled, the prefix is no
            name in C, or the law has no scalar form, with the reason.
    """
    axes = loop.plant.axes
    check_names(loop, axis, prefix)
    if rows.demand.dtype != np.float64:
        raise ValueError("the ticks of an export must be recorded in double precision")
    gains = strong(gains, jnp.float64)
    check_leaves(loop.plant, gains, "gains", jax.tree.map(lambda _: -1, gains), per_axis=True)
    real = np.float32 if single else np.float64
    gains, setpoint, measurement = jax.tree.map(
        lambda x: np.asarray(x, real), (gains, rows.setpoint, rows.measurement)
    )
    recorded = _follow(loop, gains, scenario, setpoint, measurement)
    what = Identity(
        loop=name,
        law=loop.controller.name,
        prefix=prefix,
        axes=axes if axis is None else (axis,),
        period=loop.dt,
        command_unit=loop.plant.command_unit,
        single=single,
        version=version,
    )
    try:
        with jax.enable_x64(not single):
            law, recorded = _law(loop, gains, recorded, axis)
        written = source(law, what)
    except LoweringError as reason:
        raise ValueError(f"{loop.controller.name} cannot be written in C: {reason}") from None
    return {
        f"{prefix}.h": header(law, what),
        f"{prefix}.c": written,
        f"{prefix}_gains.c": gains_source(law, what),
        "recorded.h": recorded_header(law, what, recorded),
        "replay.c": replay_source(law, what),
        "Makefile": makefile(what),
        "README.txt": readme(law, what, len(recorded.demand)),
    }


def check_names(loop: Loop, axis: str | None, prefix: str) -> None:
    """Raise ValueError for an axis that the loop does not have, and for no name in C."""
    axes = loop.plant.axes
    if axis is not None and axis not in axes:
        raise ValueError(f"axis '{axis}': must be one of {', '.join(axes)}")
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", prefix) or prefix in ("replay", "recorded"):
        raise ValueError(f"prefix '{prefix}': must be a name in C, and not replay or recorded")


def _law(
    loop: Loop, gains: Any, rows: RecordedTicks, axis: str | None
) -> tuple[LawGraph, RecordedTicks]:
    """The law and the ticks, of all axes or of one."""
    axes = loop.plant.axes

    def traced(gains: Any, rows: RecordedTicks, one: bool) -> LawGraph:
        setpoint, seen = jax.tree.map(lambda x: x[0], (rows.setpoint, rows.measurement))
        unit = loop.plant.command_unit
        return trace(loop.controller, gains, setpoint, seen, loop.dt, unit, one)

    law = traced(gains, rows, one=len(axes) == 1)
    if axis is None or len(axes) == 1:
        return law, rows
    what = coupled(law)
    if what is not None:
        raise ValueError(
            f"{loop.controller.name} cannot be exported for one axis: {what} of an axis depends on "
            "the others"
        )
    k = axes.index(axis)
    rows = jax.tree.map(lambda x: x[:, k : k + 1] if x.ndim > 1 else x, rows)
    return traced(of_axis(gains, k, len(axes)), rows, one=True), rows


def _follow(
    loop: Loop, gains: Any, scenario: Scenario, setpoint: Any, measurement: Any
) -> RecordedTicks:
    """What the law demands at recorded samples, in double precision."""
    gains, *samples = jax.tree.map(
        lambda x: jnp.asarray(x, jnp.float64), (gains, setpoint, measurement)
    )
    demand, command = _followed(loop, gains, scenario.drive, tuple(samples))
    return RecordedTicks(setpoint, measurement, np.asarray(demand), np.asarray(command))


@functools.partial(jax.jit, static_argnums=0)
def _followed(loop: Loop, gains: Any, drive: Any, samples: Any) -> Any:
    law = loop.controller
    first = jax.tree.map(lambda x: x[0], samples)

    def period(carry: Any, sample: Any) -> Any:
        (memory, queue), (setpoint, seen) = carry, sample
        demand, memory = law.control(gains, memory, setpoint, seen, loop.dt)
        command, _, queue = loop.drive.apply(drive, queue, demand, loop.dt)
        return (law.settle(gains, memory, demand, command, loop.dt), queue), (demand, command)

    begun = law.init(gains, *first), loop.drive.init(drive, jnp.zeros_like(first[0].position))
    return lax.scan(period, begun, samples)[1]
