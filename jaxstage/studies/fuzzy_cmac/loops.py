"""Loops and values of the fuzzy-CMAC study.

Source: Mao et al., "Direct Fuzzy CMAC Sliding Mode Trajectory Tracking for Biaxial Position
System", Energies 2021, 14, 7802. "published": printed there; "chosen": not printed, with reason.
Lengths of the paper's controller are centimetres; here they are metres: r1 = 0.001 becomes
0.001 * 100^2, eta = 1 cm/s2 becomes 0.01 m/s2.
"""

import functools
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxstage.controllers import (
    Cascade,
    CmacSliding,
    Gaussian,
    Pi,
    RigidAxis,
    Sliding,
    cascade,
    cmac_sliding,
    crisp,
    gaussian,
    per_axis,
    pi,
    sliding,
)
from jaxstage.controllers.parts.cmac import SHAPE
from jaxstage.hardware.drives import ideal_drive
from jaxstage.hardware.loads import no_load
from jaxstage.hardware.sensors import ideal_sensor
from jaxstage.metrics import standard
from jaxstage.model.blocks import Loop
from jaxstage.model.signals import Scenario, Start
from jaxstage.plants import PmsmTable, pmsm_table
from jaxstage.references import bowknot, circle, heart, make_path, sampled, star
from jaxstage.references.timing import constant_feed, uniform_parameter
from jaxstage.studies.case import Case, Timing, check_timing, scored, window
from jaxstage.studies.law import StudyLaw, named
from jaxstage.studies.study import Box, NamedLoop, Spread

#: following error beyond which a run counts as lost; the contours are about 60 mm wide (chosen)
PATH_LIMIT = 0.1


def _xy(x: float, y: float | None = None) -> Array:
    # numpy until a case is built: importing must not start JAX
    return cast(Array, np.array([x, x if y is None else y]))


def plant() -> PmsmTable:
    """The table of section 3.2."""
    return PmsmTable(
        force_constant=_xy(0.96),  # published
        mass=_xy(3.0e-3, 2.8e-3),  # published; 3 g is implausible for a stage, kept
        damping=_xy(0.1, 0.12),  # published
        viscous=_xy(0.0),  # chosen: not given, would count B twice
        coulomb=_xy(0.15),  # published
        static=_xy(0.24, 0.20),  # published
        stribeck=_xy(10.0, 5.0),  # published
        load=_xy(0.1),  # published; constant, opposing +x (sign chosen)
        backlash=_xy(0.0),  # chosen: not given
        resistance=_xy(2.0),  # chosen: energy is not in the paper
    )


def nominal() -> RigidAxis:
    """What the laws assume: the true values; dry friction at the working speed is F_s."""
    table = plant()
    return RigidAxis(
        force_constant=table.force_constant,
        mass=table.mass,
        damping=table.damping,
        coulomb=table.static,
        load=table.load,
    )


_COMMISSIONED = "chosen: what is left after commissioning a drive"
_DRY = "chosen: dry friction moves with temperature and lubrication; F_s stays above F_c"

#: how uncertain the table is
SPREADS = (
    Spread(path="plant.force_constant", low=0.95, high=1.05, reason=_COMMISSIONED),
    Spread(path="plant.mass", low=0.8, high=1.2, reason="chosen: workpieces"),
    Spread(path="plant.damping", low=0.5, high=1.5, reason=_COMMISSIONED),
    Spread(path="plant.coulomb", low=0.8, high=1.1, reason=_DRY),
    Spread(path="plant.static", low=0.9, high=1.2, reason=_DRY),
    Spread(path="plant.load", low=0.5, high=1.5, reason="chosen: cables and covers"),
)


_POLES = "chosen: up to a tenth of the sampling rate"
_AROUND = "chosen: a factor 10 around the value here"

#: where the gains are searched
BOXES = (
    Box(path="slope", low=0.1, high=1000.0, reason=_POLES),
    Box(path="rate", low=0.1, high=1000.0, reason="chosen: sampled, the law is unstable near 1100"),
    Box(path="switching_gain", low=1e-3, high=10.0, reason="chosen: friction is 80 m/s2"),
    Box(path="error_width", low=5e-4, high=5e-2, reason=_AROUND),
    Box(path="rate_width", low=5e-3, high=0.5, reason=_AROUND),
    Box(path="receptive.width", low=0.3, high=3.0, reason="chosen: fields that overlap"),
    Box(path="proportional_gain", low=60.0, high=6.0e5, reason="chosen: that of the CMAC"),
    Box(path="position_gain", low=6.0, high=3000.0, reason=_POLES),
    Box(path="velocity_gain", low=40.0, high=1.0e4, reason=_POLES),
    Box(path="integral_gain", low=1.0e4, high=1.0e7, reason=_AROUND),
    Box(path="velocity_feedforward", low=0.5, high=1.5, reason="chosen: around full"),
    Box(path="acceleration_feedforward", low=0.5, high=1.5, reason="chosen: around full"),
    Box(path="friction_feedforward", low=0.1, high=1.5, reason="chosen: none to too much"),
    Box(path="load_feedforward", low=0.5, high=1.5, reason="chosen: around full"),
)


def scenario() -> Scenario:
    """The published table, started at rest at the beginning of the path."""
    return Scenario(
        plant=plant(),
        load=(),
        sensor=(),
        drive=(),
        start=Start(offset=_xy(0.0), velocity=_xy(0.0)),
        key=jax.random.key(0),
    )


def sliding_gains() -> Sliding:
    """Ideal sliding mode, equations (15)-(19)."""
    table = plant()
    return Sliding(
        slope=_xy(1.0),  # published
        switching_gain=_xy(0.01),  # published, unit chosen: 1 cm/s2
        disturbance_bound=table.static / table.mass,  # chosen: friction is the disturbance
        switch=(),
        nominal=nominal(),
    )


def _cmac_gains(receptive: Any, credit: float) -> CmacSliding:
    return CmacSliding(
        slope=_xy(1.0),  # published
        rate=_xy(10.0),  # published 0.001, lengths in cm
        credit=_xy(credit),
        switching_gain=_xy(0.01),  # published, unit chosen: 1 cm/s2
        error_width=_xy(5e-3),  # chosen: the width m = 0.5, in cm
        rate_width=_xy(50e-3),  # chosen: a tenth of it loses heart and star
        weights=cast(Array, np.zeros((2, *SHAPE))),  # chosen
        receptive=receptive,
        switch=(),
        nominal=nominal(),
    )


def cmac_gains() -> CmacSliding:
    """Conventional CMAC; credit 1/4: alpha/m of equation (9) with 4 active cells (chosen)."""
    return _cmac_gains((), 0.25)


def dfcmac_gains() -> CmacSliding:
    """Direct fuzzy CMAC: m = 0.5, sigma = 1 published, read as spacing and width."""
    return _cmac_gains(Gaussian(spacing=_xy(0.5), width=_xy(1.0)), 1.0)


def pi_gains() -> Pi:
    """The PI law that the CMAC is while it stays in one cell: K = 2 r1 nu 4 b."""
    table = plant()
    return Pi(proportional_gain=2 * 10.0 * table.force_constant / table.mass, slope=_xy(1.0))


def cascade_gains() -> Cascade:
    """The industrial cascade, tuned by hand for dt = 0.1 ms (all values chosen)."""
    return Cascade(
        position_gain=_xy(600.0),
        velocity_gain=_xy(4000.0),
        integral_gain=_xy(1.0e6),
        velocity_feedforward=_xy(1.0),
        acceleration_feedforward=_xy(1.0),
        friction_feedforward=_xy(1.0),
        load_feedforward=_xy(1.0),
        friction_width=_xy(1e-4),
        nominal=nominal(),
    )


def _surface(memory: Any) -> Array:
    return memory.surface


LAWS = (
    StudyLaw("sliding", "ideal sliding mode, model known", sliding(), sliding_gains, _surface),
    StudyLaw("cmac", "conventional CMAC sliding mode", cmac_sliding(crisp), cmac_gains, _surface),
    StudyLaw(
        "dfcmac", "direct fuzzy CMAC sliding mode", cmac_sliding(gaussian), dfcmac_gains, _surface
    ),
    StudyLaw("pi", "PI law equal to the CMAC in one cell", pi, pi_gains, _surface),
    StudyLaw("cascade", "P position / PI velocity cascade", cascade, cascade_gains),
)


def law(name: str) -> StudyLaw:
    """The law called ``name``."""
    return named(LAWS, name)


CONTOURS = {"circle": circle, "bowknot": bowknot, "heart": heart, "star": star}


def build(law: StudyLaw, contour: str, timing: Timing) -> Case:
    """One law of the study on one of its contours."""
    check_timing(timing)
    motion = (
        uniform_parameter(timing.lap_time, timing.dt)
        if timing.feed is None
        else constant_feed(timing.feed, timing.dt)
    )
    path = make_path(CONTOURS[contour](), motion)
    ticks = window(timing, path.setpoint.position.shape[0])
    metric = standard(law.surface)
    loop = Loop(
        plant=pmsm_table(),
        controller=per_axis(law.controller),
        reference=sampled,
        load=no_load,
        sensor=ideal_sensor,
        drive=ideal_drive,
        metric=scored(metric, ticks),
        dt=timing.dt,
        substeps=timing.substeps,
        path_limit=PATH_LIMIT,
    )
    return Case(
        name=f"{law.name}-{contour}",
        loop=loop,
        metric=metric,
        gains=jax.tree.map(jnp.asarray, law.gains()),
        scenario=jax.tree.map(jnp.asarray, scenario()),
        path=path,
        timing=timing,
        window=ticks,
    )


loops: tuple[NamedLoop, ...] = tuple(
    NamedLoop(
        name=f"{law.name}-{contour}",
        summary=f"{law.summary}, {contour}",
        build=functools.partial(build, law, contour),
    )
    for law in LAWS
    for contour in CONTOURS
)
