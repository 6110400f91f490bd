"""The battery that every law passes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxstage import testing
from jaxstage.controllers import Offset, cmac_sliding, gaussian, offset_setpoint, per_axis, pi
from jaxstage.hardware.drives import CurrentDrive, current_drive
from jaxstage.model.fields import replace
from jaxstage.numerics.smooth import exact
from jaxstage.simulate.rollout import _simulate, simulate
from jaxstage.studies.fuzzy_cmac.loops import dfcmac_gains, pi_gains
from tests.helpers.batteries import ENTRIES, Lead, ahead, cast, table_loop
from tests.helpers.law_bench import compiled

pytestmark = pytest.mark.long

every_law = pytest.mark.parametrize("entry", ENTRIES, ids=lambda entry: entry.name)
types = pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64], ids=["f32", "f64"])


@pytest.mark.fast
@every_law
@types
def test_memory_keeps_structure_shape_and_type(entry, dtype):
    testing.memory_keeps_its_kind(entry.make(), entry.gains, dtype)


@every_law
def test_finite_command_and_memory(entry):
    testing.finite_everywhere(compiled(entry.name), entry.gains)


@every_law
def test_jit_equals_eager(entry):
    testing.compiled_equals_eager(entry.make(), compiled(entry.name), entry.gains)


@every_law
def test_many_gains_equal_one_at_a_time(entry):
    testing.batch_equals_single(compiled(entry.name), entry.gains)


@every_law
def test_gradients(entry):
    testing.gradients_agree(entry.make(), entry.gains)


@pytest.mark.fast
@every_law
def test_composed_anew_it_is_the_same_definition(entry):
    assert entry.make() is entry.make()
    assert hash(entry.make()) == hash(entry.make())


@pytest.mark.fast
@every_law
def test_gains_survive_a_file(entry):
    testing.gains_survive_a_file(entry.gains)


@pytest.mark.fast
@every_law
def test_every_gain_and_memory_has_unit_and_meaning(entry):
    testing.fields_are_described(entry.make(), entry.gains)


@every_law
def test_single_precision_follows_double(entry):
    run, single = compiled(entry.name), compiled(entry.name, "f32")
    testing.single_follows_double(run, single, entry.gains)


SETTLED = [entry for entry in ENTRIES if entry.settled and entry.name != "offset"]


@pytest.mark.parametrize("entry", SETTLED, ids=lambda entry: entry.name)
def test_single_precision_run_follows_double(entry):
    """A tenth of a second of a law that does not switch: errors agree to a fiftieth."""
    loop, scenario, path = table_loop(entry.make())
    reports = []
    for dtype in (jnp.float32, jnp.float64):
        run = simulate(loop, entry.gains, scenario, cast(path, dtype), 1000)
        assert run.report.ate.dtype == dtype
        reports.append(run.report)
    np.testing.assert_allclose(reports[0].ate, reports[1].ate, rtol=0.02)
    np.testing.assert_allclose(reports[0].tracking_max, reports[1].tracking_max, rtol=0.02)


def test_no_retrace_for_changed_numbers():
    """Floats, numpy or JAX numbers, other seeds and recomposed definitions: one compilation."""

    def loop_of():
        return table_loop(per_axis(cmac_sliding(gaussian, exact)))

    loop, scenario, path = loop_of()
    gains = dfcmac_gains()
    before = _simulate._cache_size()
    variants = [
        (gains, scenario),
        (cast(gains), cast(replace(scenario, key=()))),
        (jax.tree.map(lambda x: np.asarray(1.1 * x, np.float32), gains), scenario),
        (gains, replace(scenario, plant=jax.tree.map(lambda x: 1.2 * x, scenario.plant))),
    ]
    for seed, (numbers, uncertain) in enumerate(variants):
        again, _, _ = loop_of()
        assert again == loop
        simulate(again, numbers, replace(uncertain, key=jax.random.key(seed)), path, 20)
    assert _simulate._cache_size() == before + 1


def test_no_retrace_for_python_floats():
    law, gains = per_axis(pi), pi_gains()
    loop, scenario, path = table_loop(offset_setpoint(law, "lead", ahead), drive=current_drive(2))
    before = _simulate._cache_size()
    for delay, time in enumerate((1e-4, np.float32(2e-4), jnp.asarray(3e-4))):
        drive = CurrentDrive(limit=np.array([1.0, 2.0]), delay=delay, lag=float(time))
        scenario = replace(scenario, drive=drive)
        simulate(loop, Offset(law=gains, offset=Lead(time=time)), scenario, path, 20)
    assert _simulate._cache_size() == before + 1
