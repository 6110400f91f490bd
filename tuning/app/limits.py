"""How long a sweep takes, estimated before anything is drawn, and what is refused."""

from tuning.sweeps.configuration import SweepPlan

#: plant steps a second that one core makes at least, and the seconds that need no --force
STEPS_PER_S, LONGEST_S = 1e6, 86400.0


def refuse_unbounded(plan: SweepPlan, cores: int) -> None:
    """Refuse a sweep that is estimated to take over a day.

    Raises:
        ValueError: with runs, plant steps and time, and the switch that simulates them.
    """
    steps = plan.table["runs"] * sum(c.window.ticks * c.loop.substeps for c in plan.cases)
    seconds = steps / (STEPS_PER_S * cores)
    if seconds > LONGEST_S:
        raise ValueError(
            f"-n {plan.table['runs']}: {steps:.3g} plant steps, about {seconds / 86400:.3g} days "
            f"on {cores} cores: --force simulates them"
        )
