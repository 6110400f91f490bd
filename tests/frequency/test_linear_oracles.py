"""The linear view against closed forms in z, written down independently of the library."""

import control
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg

import jaxstage as js
from jaxstage.controllers import Cascade, RigidAxis, cascade, per_axis
from jaxstage.frequency.linear import linearise
from jaxstage.frequency.margins import grid, loop_margins
from jaxstage.frequency.response import compliance, response, sensitivity, tracking
from jaxstage.frequency.wrappers import Straight, straight
from jaxstage.hardware.drives import (
    Amplified,
    CurrentDrive,
    amplified,
    current_drive,
    ideal_drive,
)
from jaxstage.hardware.loads import no_load
from jaxstage.hardware.sensors import ideal_sensor, motor_side
from jaxstage.model.signals import Scenario, Start
from jaxstage.plants import pmlsm_stage, two_inertia
from jaxstage.plants.parts.lugre import Lugre
from jaxstage.plants.pmlsm_stage import PmlsmStage
from jaxstage.plants.two_inertia import TwoInertia, explicit
from jaxstage.simulate.stability import spectral_radius, stability_limit

DT = 1e-4
OMEGA = np.geomspace(1, np.pi / DT * 0.999, 3001)
Z = np.exp(1j * OMEGA * DT)
MASS, DAMPING, FORCE = 2.0, 10.0, 50.0


def one(value):
    return jnp.array([float(value)])


def loop_of(plant, drive=ideal_drive, sensor=ideal_sensor, substeps=1):
    return js.Loop(
        plant=plant, controller=per_axis(cascade), reference=straight(DT), load=no_load,
        sensor=sensor, drive=drive, metric=js.record, dt=DT, substeps=substeps,
    )  # fmt: skip


def gains_of(k_p, k_s, k_i, force, mass, damping):
    nominal = RigidAxis(
        force_constant=one(force), mass=one(mass), damping=one(damping), coulomb=one(0),
        load=one(0),
    )  # fmt: skip
    return Cascade(
        position_gain=one(k_p), velocity_gain=one(k_s), integral_gain=one(k_i),
        velocity_feedforward=one(1), acceleration_feedforward=one(1),
        friction_feedforward=one(1), load_feedforward=one(0), friction_width=one(1e-4),
        nominal=nominal,
    )  # fmt: skip


def scenario_of(plant, drive=()):
    start = Start(offset=one(0), velocity=one(1))
    return Scenario(
        plant=plant, load=(), sensor=(), drive=drive, start=start, key=jax.random.key(0)
    )


REST = Straight(begin=one(0), velocity=one(0))
STAGE = PmlsmStage(
    force_constant=one(FORCE), mass=one(MASS), damping=one(DAMPING), resistance=one(1)
)
GAINS = gains_of(60, 400, 1e4, FORCE, MASS, DAMPING)


def zero_order_hold(a, b):
    """Transition of x' = A x + B u with u held, by the matrix exponential."""
    n = len(a)
    both = scipy.linalg.expm(np.block([[a, b], [np.zeros((b.shape[1], n + b.shape[1]))]]) * DT)
    return both[:n, :n], both[:n, n:]


def held(a, b, z=Z):
    """States over input, (w, n)."""
    ad, bd = zero_order_hold(a, b)
    return np.linalg.solve(z[:, None, None] * np.eye(len(a)) - ad, bd)[..., 0]


def rigid_loop_gain(z=Z):
    a = np.array([[0, 1], [0, -DAMPING / MASS]])
    states = held(a, np.array([[0], [FORCE / MASS]]), z)
    law = 400 + 1e4 * DT / (1 - 1 / z)
    return MASS / FORCE * law * (60 * states[:, 0] + states[:, 1])


@pytest.fixture(scope="module")
def rigid():
    loop = loop_of(pmlsm_stage(("x",)))
    return linearise(loop, GAINS, scenario_of(STAGE), REST, 50)


def element(matrix):
    return lambda omega: matrix(omega)[..., 0, 0]


@pytest.mark.fast
def test_a_rigid_axis_under_a_cascade(rigid):
    """Closed form of the loop gain; margins as python-control finds them."""
    sens = element(sensitivity(rigid))
    loop_gain = 1 / sens(OMEGA) - 1
    assert np.abs(loop_gain / rigid_loop_gain() - 1).max() < 1e-9
    found = loop_margins(sens, grid(rigid))
    assert found.gain_up is None
    assert found.gain_down.value == pytest.approx(0.03168, abs=5e-6)
    assert found.gain_down.omega == pytest.approx(32.83, abs=5e-3)
    assert found.phase.value == pytest.approx(77.60896, abs=5e-6)
    assert found.phase.omega == pytest.approx(405.620, abs=5e-4)
    assert found.ms.value == pytest.approx(1.02043, abs=5e-6)
    assert found.delay == pytest.approx(np.radians(found.phase.value) / found.phase.omega)
    theirs = control.stability_margins(control.frd(loop_gain, OMEGA, smooth=False))
    assert theirs[0] == pytest.approx(found.gain_down.value, rel=1e-5)
    assert theirs[1] == pytest.approx(found.phase.value, abs=1e-4)
    assert theirs[4] == pytest.approx(found.phase.omega, rel=1e-6)


@pytest.mark.fast
def test_the_half_period_hold_is_the_difference_to_continuous_time(rigid):
    """A held command lags by dt/2: phase margin 78.7509 deg less omega_c dt/2."""
    found = loop_margins(element(sensitivity(rigid)), grid(rigid))
    hold = np.degrees(405.102 * DT / 2)
    assert hold == pytest.approx(1.160, abs=1e-3)
    assert found.phase.value + hold == pytest.approx(78.7509, abs=0.02)


@pytest.mark.fast
def test_modal_form_and_solve_are_the_same(rigid):
    few = OMEGA[::300]
    part = rigid.between("cut", "cut")
    solved = np.asarray(response(part, jnp.asarray(few)))
    assert np.abs(solved - sensitivity(rigid)(few)).max() < 1e-11


@pytest.mark.fast
def test_stiffness_and_tracking_of_a_rigid_axis(rigid):
    """At low frequency the integral makes compliance j w M/(k_p k_i .. ), tracking 1."""
    low = np.array([0.01])
    feedforward, alone = (element(tracking(rigid, f))(low)[0] for f in (True, False))
    assert feedforward == pytest.approx(1, abs=1e-6) and alone == pytest.approx(1, abs=1e-3)
    soft = element(compliance(rigid))
    continuous = 1j * low / (MASS * (1e4 * 60 + 1j * low * (1e4 + 400 * 60)))
    assert soft(low)[0] == pytest.approx(continuous[0], rel=1e-3)


def law_of_two(k_s, k_i, k_p, position, velocity, mass, force, ratio):
    law = k_s + k_i * DT / (1 - 1 / Z)
    return mass / force * law * (k_p * position + velocity) / ratio


J1, J2, SHAFT, LOSS, VISCOUS, BRISTLE = 2e-3, 1e-3, 400.0, 0.2, 0.01, 1.0
RATIO = 2 * np.pi / 0.01


def two_inertias(spring):
    a = np.zeros((4, 4))
    a[0, 1] = a[2, 3] = 1
    a[1] = [-SHAFT / J1, -LOSS / J1, SHAFT / J1, LOSS / J1]
    a[3] = [SHAFT / J2, LOSS / J2, -(SHAFT + spring) / J2, -(LOSS + VISCOUS) / J2]
    return held(a, np.array([[0], [1 / J1], [0], [0]]))


def two_inertia_loop(sensor, substeps, integration, gains):
    friction = Lugre(
        coulomb=one(1e-9), static=one(1e-9), stribeck=one(1), bristle_stiffness=one(BRISTLE),
        bristle_damping=one(0), viscous=one(VISCOUS),
    )  # fmt: skip
    machine = TwoInertia(
        motor_inertia=one(J1), load_inertia=one(J2), stiffness=one(SHAFT), damping=one(LOSS),
        ratio=one(RATIO), copper_loss=one(0), friction=friction,
    )  # fmt: skip
    plant = two_inertia(("x",), **({"integration": integration} if integration else {}))
    loop = loop_of(plant, sensor=sensor, substeps=substeps)
    law = gains_of(*gains, RATIO, (J1 + J2) * RATIO**2, 0)
    return linearise(loop, law, scenario_of(machine), REST, 50)


SIDES = {
    "tool": (ideal_sensor, (2, 3), (5.0, 30.0, 60.0)),
    "motor": (motor_side(ideal_sensor), (0, 1), (40.0, 300.0, 5e3)),
}


def theory_of_two(side, spring=BRISTLE):
    """Loop gain of the two inertias in closed form."""
    _, rows, (k_p, k_s, k_i) = SIDES[side]
    states = two_inertias(spring)
    position, velocity = (states[:, row] for row in rows)
    return law_of_two(k_s, k_i, k_p, position, velocity, (J1 + J2) * RATIO**2, RATIO, RATIO)


def error_of_two(side, substeps, integration=None):
    """The model, and the largest relative error of its sensitivity."""
    sensor, _, gains = SIDES[side]
    model = two_inertia_loop(sensor, substeps, integration, gains)
    sens = element(sensitivity(model))
    return model, np.abs(sens(OMEGA) * (1 + theory_of_two(side)) - 1).max()


def test_two_inertias_on_the_tool_side():
    """Shaft, and the bristle as a spring, integrated by Runge-Kutta in quarters of a period."""
    model, error = error_of_two("tool", 4, explicit)
    assert error < 2e-8
    found = loop_margins(element(sensitivity(model)), grid(model))
    # the closed form where its imaginary part is 0, by bisection: the loop gain is -1/11.60062
    assert found.gain_up.value == pytest.approx(11.600619689, rel=1e-8)
    assert found.gain_up.omega == pytest.approx(832.72339156, rel=1e-8)
    assert found.phase.value == pytest.approx(85.8501, abs=5e-5)
    assert found.phase.omega == pytest.approx(38.7459, rel=2e-6)
    assert found.ms.value == pytest.approx(1.10949, abs=1e-5)
    assert found.ms.omega == pytest.approx(773.4, rel=2e-3)


@pytest.mark.parametrize(("side", "error"), [("tool", 1.3e-4), ("motor", 3.9e-4)])
def test_the_error_of_two_inertias_is_that_of_their_integration(side, error):
    """Implicit steps of second order: half the step, a quarter of the error."""
    whole, half = error_of_two(side, 1), error_of_two(side, 2)
    assert whole[1] == pytest.approx(error, rel=0.1)
    assert whole[1] / half[1] == pytest.approx(4, rel=0.02)
    found = loop_margins(element(sensitivity(whole[0])), grid(whole[0]))
    phase, largest = (85.8501, 1.10955) if side == "tool" else (79.47806, 1.02304)
    assert found.phase.value == pytest.approx(phase, abs=5e-5)
    assert found.ms.value == pytest.approx(largest, abs=1e-5)


def test_without_the_bristle_the_phase_margin_would_be_another():
    """Friction at rest is a spring: left out of the theory, 83.03 deg at 30.34 rad/s."""
    loop_gain = theory_of_two("tool", spring=0.0)
    theirs = control.stability_margins(control.frd(loop_gain, OMEGA, smooth=False))
    assert theirs[1] == pytest.approx(83.03, abs=0.02)
    assert theirs[4] == pytest.approx(30.34, abs=0.02)


@pytest.mark.fast
@pytest.mark.parametrize("delay", [1, 3])
def test_dead_time_turns_the_phase_and_nothing_else(delay):
    """L e^{-j w d dt}; the delay margin shrinks by exactly the dead time."""
    drive = CurrentDrive(limit=one(np.inf), delay=jnp.asarray(float(delay)), lag=one(0))
    loop = loop_of(pmlsm_stage(("x",)), drive=current_drive(3))
    model = linearise(loop, GAINS, scenario_of(STAGE, drive), REST, 50)
    sens = element(sensitivity(model))
    late = rigid_loop_gain() * Z**-delay
    assert np.abs((1 / sens(OMEGA) - 1) / late - 1).max() < 1e-9
    found = loop_margins(sens, grid(model))
    prompt = np.radians(77.60896) / 405.620
    assert found.delay == pytest.approx(prompt - delay * DT, rel=1e-6)


@pytest.mark.fast
@pytest.mark.parametrize(("delay", "peak"), [(0, 1.02043), (1, 1.05818), (3, 1.13992)])
def test_the_integral_of_bode(delay, peak):
    """Strictly proper L without poles outside the circle: the mean of ln |S| over 0..pi is 0."""
    drive = CurrentDrive(limit=one(np.inf), delay=jnp.asarray(float(delay)), lag=one(0))
    loop = loop_of(pmlsm_stage(("x",)), drive=current_drive(3))
    model = linearise(loop, GAINS, scenario_of(STAGE, drive), REST, 50)
    sens = element(sensitivity(model))
    points = 200_000
    middle = (np.arange(points) + 0.5) * np.pi / points / DT
    assert np.log(np.abs(sens(middle))).mean() == pytest.approx(np.log(2) / points, rel=1e-3)
    assert np.abs(sens(middle)).max() == pytest.approx(peak, abs=5e-6)


def test_gain_margin_is_the_limit_of_stability():
    """The loop becomes unstable where its drive gives exactly the gain margin."""
    lag = CurrentDrive(limit=one(np.inf), delay=jnp.asarray(3.0), lag=one(5e-4))
    loop = loop_of(pmlsm_stage(("x",)), drive=amplified(current_drive(3)))

    def model(factor):
        drive = Amplified(factor=jnp.asarray(factor, float), drive=lag)
        return linearise(loop, GAINS, scenario_of(STAGE, drive), REST, 50)

    nominal = model(1.0)
    up = loop_margins(element(sensitivity(nominal)), grid(nominal)).gain_up.value
    matrices = jax.jit(jax.vmap(lambda f: model(f).a))
    limit = stability_limit(
        lambda f: spectral_radius(matrices(jnp.asarray(f))), 1.0, 2 * up, tolerance=1e-8
    )
    assert limit == pytest.approx(up, rel=1e-6)


@pytest.mark.fast
def test_the_gradient_of_a_sensitivity_by_a_gain(rigid):
    """Forward mode through the linearisation against central differences."""
    loop = loop_of(pmlsm_stage(("x",)))
    omega = jnp.asarray([50.0, 400.0, 3000.0])

    def size(k_p):
        law = js.replace(GAINS, position_gain=one(0) + k_p)
        model = linearise(loop, law, scenario_of(STAGE), REST, 50)
        return jnp.abs(response(model.between("cut", "cut"), omega)[:, 0, 0])

    size = jax.jit(size)
    slope = jax.jit(jax.jacfwd(size))(60.0)
    step = 1e-3
    assert np.allclose(slope, (size(60.0 + step) - size(60.0 - step)) / (2 * step), rtol=1e-6)
