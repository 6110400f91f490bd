"""Whether a loop is compiled, and if not, why."""

from typing import Any, NamedTuple

from jaxstage.compiler.runtime.api import Report, describe
from jaxstage.compiler.runtime.toolchain import compiler
from jaxstage.model.blocks import Loop
from jaxstage.model.signals import Scenario
from jaxstage.model.validate import check
from jaxstage.simulate.rollout import compiled_form, start

KERNELS = ("forward", "tangent", "pullback")


class Explanation(NamedTuple):
    """What the engine makes of a loop. shortest: ticks from which a run is compiled (inf: never);
    compiler: its path, or None; kernels: of the run and of its derivatives."""

    engine: str
    shortest: float
    compiler: str | None
    kernels: tuple[Report, ...]

    @property
    def compiled(self) -> bool:
        """Whether long enough runs are compiled."""
        return self.shortest < float("inf") and self.kernels[0].reason is None

    def text(self) -> str:
        """One line on the engine, one a kernel."""
        if self.shortest == float("inf"):
            head = f"engine {self.engine}: lax.scan"
        else:
            head = f"engine {self.engine}: compiled from {self.shortest:g} ticks on"
        return "\n".join([f"{head}; compiler {self.compiler or 'none'}", *map(_line, self.kernels)])


def _line(report: Report) -> str:
    if report.reason is not None:
        return f"{report.what:9} lax.scan, because of: {report.reason}"
    how = "from the cache" if report.cached else f"compiled in {report.seconds:.1f} s"
    return (
        f"{report.what:9} {report.nodes} operations a tick, found in {report.graph_seconds:.1f} s; "
        f"{report.bytes / 1024:.0f} kB, {how}"
    )


def explain(
    loop: Loop, gains: Any, scenario: Scenario, path: Any, kernels: tuple[str, ...] = KERNELS
) -> Explanation:
    """Build the kernels of a loop (forward; tangent and pullback with respect to all gains and all
    of the scenario) and say what came of it. Raises ValueError for bad input."""
    gains, scenario, path = check(loop, gains, scenario, path)
    carry = start(loop, gains, scenario, path)
    program, _ = compiled_form(loop, gains, scenario, path, carry)
    reports = tuple(describe(program, what) for what in kernels)
    return Explanation(loop.engine.name, loop.engine.shortest, compiler(), reports)
