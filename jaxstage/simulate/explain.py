"""Whether a loop is compiled, and if not, why."""

from typing import Any, NamedTuple

from jaxstage.compiler.runtime.api import KernelReport, describe, refusal
from jaxstage.compiler.runtime.toolchain import compiler_name
from jaxstage.model.blocks import Loop
from jaxstage.model.signals import Scenario
from jaxstage.model.validate import check
from jaxstage.simulate.rollout import compiled_form, start

KERNELS = ("forward", "tangent", "pullback")


class Explanation(NamedTuple):
    """What the engine makes of a loop.

    Attributes:
        engine: Its name.
        shortest: Ticks from which a run is compiled, inf for never.
        compiler: The command of the C++ compiler, or None.
        reason: Why no run is compiled, or None.
        kernels: Of the run and of its derivatives, as far as they were asked for.
    """

    engine: str
    shortest: float
    compiler: str | None
    reason: str | None
    kernels: tuple[KernelReport, ...]

    @property
    def compiled(self) -> bool:
        """Whether long enough runs are compiled."""
        return self.shortest < float("inf") and self.reason is None

    def text(self) -> str:
        """One line on the engine, one a kernel."""
        if self.shortest == float("inf"):
            head = f"engine {self.engine}: lax.scan"
        else:
            head = f"engine {self.engine}: compiled from {self.shortest:g} ticks on"
        return "\n".join([f"{head}; compiler {self.compiler or 'none'}", *map(_line, self.kernels)])


def _line(report: KernelReport) -> str:
    if report.reason is not None:
        return f"{report.what:9} lax.scan, because of: {report.reason}"
    how = "from the cache" if report.cached else f"compiled in {report.seconds:.1f} s"
    return (
        f"{report.what:9} {report.nodes} operations a tick, read in {report.graph_seconds:.1f} s; "
        f"{report.bytes / 1024:.0f} kB, {how}"
    )


def explain(
    loop: Loop, gains: Any, scenario: Scenario, path: Any, kernels: tuple[str, ...] = KERNELS
) -> Explanation:
    """Build kernels of a loop and say what came of it.

    Args:
        loop: What is fixed.
        gains: What is tuned.
        scenario: What is uncertain.
        path: Parameters of the reference.
        kernels: Of ``forward`` (a run), ``tangent`` and ``pullback`` (derivatives with respect to
            all gains and all of the scenario). None builds nothing.

    Raises:
        ValueError: For bad input, naming the value and its allowed range.
    """
    unknown = [what for what in kernels if what not in KERNELS]
    if unknown:
        raise ValueError(f"kernels = {unknown[0]!r}: must be of {', '.join(KERNELS)}")
    gains, scenario, path = check(loop, gains, scenario, path)
    carry = start(loop, gains, scenario, path)
    program, _ = compiled_form(loop, gains, scenario, path, carry)
    reports = tuple(describe(program, what) for what in kernels)
    run = [report.reason for report in reports if report.what == "forward"]
    reason = run[0] if run else refusal(program)
    engine = loop.engine
    return Explanation(engine.name, engine.shortest, compiler_name(), reason, reports)
