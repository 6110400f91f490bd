"""Training and held-out sets: the study's own spreads, or the user's file.

    [train]
    plants = 3                   # drawn within the spreads, after the nominal one
    nominal = true
    noise_seeds = 1              # random keys of each plant
    seed = 0                     # of the draws
    horizons = [1.0]             # s; left out: as long as the timing of a contour says
    skip = 0.2                   # s that the metrics leave out, at the start

    [[train.contour]]            # every contour with every horizon, plant, ...
    loop = "dfcmac-circle"       # loops with the law that is tuned
    set = ["lap_time=1"]         # as --set

    [[train.load]]               # values of the load, each with every plant
    amplitude = [20.0, 15.0, 10.0]

    [[train.start]]              # likewise where a run begins
    offset = [1e-4, 0.0]

    [[train.spread]]             # as in a scenario file; left out: those of the study
    path = "plant.mass"
    distribution = "uniform"
    low = 0.8
    high = 1.2

    [held_out]                   # the same keys; never simulated before the gains are final
    plants = 100
    dealt = true                 # each plant assigned to one contour; false: each contour meets all

What is left out is taken from the default of its set (`default_training`, `default_held_out`).
"""

import functools
import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxstage.model.fields import leaves, replace
from jaxstage.studies import Case, Timing, find, known_studies
from tuning.store.gains_file import GainsFile
from tuning.tuner.problem.scenario_set import ContourSpec, SetSpec, widened
from tuning.uncertainty.scenario_file import ScenarioFile
from tuning.uncertainty.uncertain_space import study_spreads

#: most control periods of a training run, where nothing else is said
TRAINING_TICKS = 10_000
#: a held-out run is so many times as long
LONGER = 4
#: share of a run that its metrics leave out, unless the loop's timing judges whole runs: the start
START_SHARE = 0.2
#: plants: drawn for training, and held out
PLANTS, HELD_OUT = 2, 100
#: least spread of what is uncertain: factors 1 -+ this
SPREAD = 0.2
#: added to the seed for the plants that are held out
HELD_OUT_SEED = 1_000_001
#: control periods of a lap that is only compared with others
GLANCE = 200


class LoopSpec(NamedTuple):
    """The loop whose gains are tuned, and what was said about it, as for ``jaxstage run``.

    Attributes:
        loop: its name.
        words: as for ``--set``.
        gains: file of the values to start from.
        scenario: file of values, blocks and spreads.
        spreads: what is uncertain, where a set says nothing of its own (`spreads_of`).
        seed: of the draws.
    """

    loop: str
    words: tuple[str, ...]
    gains: GainsFile
    scenario: ScenarioFile
    spreads: tuple[Mapping[str, Any], ...]
    seed: int


def spreads_of(loop: str, scenario: ScenarioFile) -> Sequence[Mapping[str, Any]]:
    """The spreads of a scenario file, else the study's, at least +-20 % wide."""
    return scenario.spreads or widened(study_spreads(find(loop).name), SPREAD)


def shortened(timing: Timing) -> Timing:
    """The timing of a training run: at most `TRAINING_TICKS` control periods.

    By fewer laps or, where one lap is longer than that, a faster one.
    """
    most = TRAINING_TICKS * timing.dt
    whole = timing.laps * timing.lap_time if timing.duration is None else timing.duration
    if timing.feed is not None:
        return _scored_after_start(timing, replace(timing, duration=most))
    lap = min(timing.lap_time, most)
    laps = max(1, math.floor(most / lap * (1 + 1e-9)))
    changed = replace(timing, lap_time=lap, duration=min(whole, laps * lap))
    return _scored_after_start(timing, changed)


def longer(timing: Timing) -> Timing:
    """The timing of a held-out run: the loop's own lap, `LONGER` times as long as training."""
    duration = shortened(timing).duration
    assert duration is not None
    return _scored_after_start(timing, replace(timing, duration=LONGER * duration))


def _scored_after_start(own: Timing, changed: Timing) -> Timing:
    """Metrics cover all but the start, or the whole run where the loop's own timing says so."""
    if own.scored == 0:
        return changed
    assert changed.duration is not None
    start = START_SHARE * changed.duration
    skip = start if own.skip is None else min(own.skip, changed.duration / 2)
    return replace(changed, scored=None, skip=skip)


def default_training(spec: LoopSpec, case: Case) -> SetSpec:
    """The training set where nothing is said.

    The nominal plant and `PLANTS` others on the contour of the loop, in a lap that fits, and at
    the loop's own speed on the one with the sharpest corners, if others are left to be held out.

    Args:
        spec: what is tuned.
        case: of the loop.
    """
    timing = shortened(case.timing)
    assert timing.duration is not None
    faster = timing.lap_time != case.timing.lap_time
    words = (*spec.words, f"lap_time={timing.lap_time!r}") if faster else spec.words
    others = sisters(spec.loop, case.timing.dt, case.timing.substeps)
    contours = [ContourSpec(spec.loop, words)]
    contours += [ContourSpec(others[0], spec.words)] if len(others) > 1 else []
    return SetSpec(
        contours=tuple(contours),
        plants=PLANTS,
        nominal=True,
        noise_seeds=1,
        seed=spec.seed,
        horizons=(timing.duration,),
        skip=timing.skip,
        spreads=spec.spreads,
        correlations=tuple(spec.scenario.correlations),
        design="sobol",
    )


def default_held_out(spec: LoopSpec, case: Case) -> SetSpec:
    """The held-out set where nothing is said.

    `HELD_OUT` plants, on the contours of the law that are not trained on where there are any, else
    with the motion spread, too, at the loop's own lap time and `LONGER` times as long.

    Args:
        spec: what is tuned.
        case: of the loop.
    """
    timing = longer(case.timing)
    assert timing.duration is not None
    others = sisters(spec.loop, case.timing.dt, case.timing.substeps)
    others = others[1:] if len(others) > 1 else others
    motion = [
        {"path": path, "distribution": "uniform", "low": 1 - SPREAD, "high": 1 + SPREAD}
        for path, quantity, value in leaves(case.path, "reference")
        if not others and quantity.role == "param" and np.all(np.asarray(value) != 0)
    ]
    return SetSpec(
        contours=tuple(ContourSpec(name, spec.words) for name in others or (spec.loop,)),
        plants=HELD_OUT,
        nominal=False,
        noise_seeds=1,
        seed=(spec.seed + HELD_OUT_SEED) % 2**32,
        horizons=(timing.duration,),
        skip=timing.skip,
        spreads=(*spec.spreads, *motion),
        correlations=tuple(spec.scenario.correlations),
        dealt=True,
    )


@functools.cache
def sisters(loop: str, dt: float, substeps: int) -> tuple[str, ...]:
    """Loops of the same study with the same law and published gains on another contour.

    The one with the sharpest corners comes first.

    Args:
        loop: name of the loop.
        dt: its control period, s.
        substeps: its integration steps in a period.
    """
    stem = loop.rpartition("-")[0]
    study = next(s for s in known_studies() if any(entry.name == loop for entry in s.loops))
    names = [e.name for e in study.loops if stem and e.name.startswith(f"{stem}-")]
    if len(names) < 2:
        return ()
    # a short lap: only the curves are compared
    timing = Timing(lap_time=GLANCE * dt, laps=1, dt=dt, substeps=substeps)
    built = {name: find(name).build(timing) for name in names}
    others = [n for n in names if n != loop and _are_sisters(built[loop], built[n])]
    return tuple(sorted(others, key=lambda name: -_sharpness(built[name])))


def _sharpness(case: Case) -> float:
    """Largest change of the commanded velocity in a tick, over the mean speed."""
    ticks = jnp.arange(case.window.lap)
    velocity = np.asarray(
        jax.vmap(case.loop.reference.sample, (None, 0))(case.path, ticks).velocity
    )
    steps = np.linalg.norm(np.roll(velocity, -1, axis=0) - velocity, axis=1)
    return float(steps.max() / np.linalg.norm(velocity, axis=1).mean())


def _are_sisters(own: Case, other: Case) -> bool:
    blocks = ("plant", "controller", "reference", "load", "sensor", "drive")
    same = all(getattr(own.loop, b) == getattr(other.loop, b) for b in blocks)
    return same and _equal(own.gains, other.gains) and not _equal(own.path, other.path)


def _equal(a: Any, b: Any) -> bool:
    if jax.tree.structure(a) != jax.tree.structure(b):
        return False
    return all(np.array_equal(x, y) for x, y in zip(*map(jax.tree.leaves, (a, b)), strict=True))
