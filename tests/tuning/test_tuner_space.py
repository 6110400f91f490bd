"""What is tuned: boxes, transforms, names, ties, order."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxstage as js
from tuning.tuner.problem.search_space import Search, default_searches, parameters, search_space
from tuning.tuner.problem.transforms import TRANSFORMS, boxed, linear, logarithmic, ordered

pytestmark = pytest.mark.fast


@functools.cache
def case(name="dfcmac-circle"):
    timing = js.find(name).timing
    return js.build(name, js.replace(timing, duration=20 * timing.dt, scored=0, skip=None))


@functools.cache
def fuzzy():
    return case("af-pid-ccc")


def made(*searches, of=None):
    return search_space(of or case(), searches)


@pytest.mark.parametrize("transform", [logarithmic, boxed, linear, ordered], ids=lambda t: t.name)
def test_transforms_are_their_own_inverse_and_stay_inside(transform):
    before = np.array([0.3, 1.0, 2.0])
    low, high = np.full(3, 0.1), np.full(3, 9.0)
    z = transform.inverse(before, low, high, before)
    np.testing.assert_allclose(transform.forward(jnp.asarray(z), low, high, before), before)
    far = [np.asarray(transform.forward(jnp.asarray(z + d), low, high, before)) for d in (-30, 30)]
    if transform != linear:
        assert np.all(np.stack(far) >= low[0] * (1 - 1e-12))
        assert np.all(np.stack(far) <= high[0] * (1 + 1e-12))
    slope = jax.jacfwd(lambda z: transform.forward(z, low, high, before))(jnp.asarray(z))
    assert np.all(np.diag(slope) > 0)
    assert TRANSFORMS[transform.name] == transform


def test_a_unit_of_z_is_about_a_factor_e():
    low, high, value = np.array(0.01), np.array(100.0), np.array(1.0)
    moved = logarithmic.forward(jnp.asarray(0.1), low, high, value)
    assert float(moved) == pytest.approx(np.exp(0.1), rel=1e-3)


def test_ordered_values_stay_in_order():
    entry = made(Search("error_sets.centres", transform=ordered), of=fuzzy()).entries[0]
    assert entry.count == 7 and (entry.low[0], entry.high[0]) == (-4, 4)
    z = np.random.default_rng(0).normal(scale=3.0, size=(50, 7))
    centres = np.array([entry.value_of(jnp.asarray(row)) for row in z])
    assert np.all(np.diff(centres, axis=1) > 0)
    assert np.all((centres > -4) & (centres < 4))


def test_names_parts_symbols_and_labels():
    space = made(Search("c1"), Search("receptive"), Search("gains.rate", tied=True))
    assert [e.path for e in space.entries] == [
        "gains.slope",
        "gains.rate",
        "gains.receptive.spacing",
        "gains.receptive.width",
    ]
    assert space.size == 7 and len(space.labels) == 7
    assert space.labels[:3] == ("gains.slope x", "gains.slope y", "gains.rate")
    fixed = made(Search("receptive"), Search("sigma", fixed=True))
    assert [e.path for e in fixed.entries] == ["gains.receptive.spacing"]
    whole = made(Search("rules"), of=fuzzy())
    assert whole.size == 147


def test_vectors_and_gains_are_one():
    space = made(Search("c1"), Search("r1", tied=True), Search("eta", 1e-3, 1.0))
    start = space.start()
    before = space.gains_of(jnp.asarray(start))
    for a, b in zip(jax.tree.leaves(before), jax.tree.leaves(case().gains), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12)
    z = start + np.array([0.5, -0.5, 0.7, 0.1, 0.2])
    np.testing.assert_allclose(space.z_of(space.gains_of(jnp.asarray(z))), z, rtol=1e-9)
    moved = space.gains_of(jnp.asarray(z)).rate
    np.testing.assert_allclose(moved[0] / moved[1], 1.0)


def test_tied_gains_move_by_one_factor():
    space = made(Search("gains.law.law.slope", tied=True), of=fuzzy())
    slope = np.asarray(space.gains_of(jnp.asarray(space.start() + 0.01)).law.law.slope)
    np.testing.assert_allclose(slope / [10, 12, 15], np.exp(0.01), rtol=1e-3)


def test_parameters_say_where_they_stand():
    space = made(Search("c1", 0.1, 10.0))
    listed = parameters(space, space.start() + np.array([0.0, 50.0]))
    assert [p.label for p in listed] == ["gains.slope x", "gains.slope y"]
    assert [p.at_bound for p in listed] == [False, True]
    first = listed[0]
    assert (first.symbol, first.unit, first.before, first.low) == ("c1", "1/s", 1.0, 0.1)
    assert first.value == pytest.approx(1.0) and listed[1].value == pytest.approx(10.0)


@pytest.mark.parametrize(
    ("searches", "told"),
    [
        ((), "nothing to tune"),
        ((Search("slope", fixed=True),), "nothing to tune"),
        ((Search("c2"),), "unknown setting 'c2'"),
        ((Search("c1"), Search("slope")), "gains.slope is named twice"),
        ((Search("c1", 5.0, 2.0),), "gains.slope: low = 5 must be below high = 2"),
        ((Search("c1", -1.0, 2.0),), r"leaves the range of the field: > 0 1/s"),
        ((Search("c1", 2.0, 5.0),), r"gains.slope = 1 is outside its box 2..5"),
        ((Search("weights"),), "gains.weights is 0: give low and high"),
        ((Search("weights", -1.0, 1.0, logarithmic),), "transform log needs low > 0"),
        ((Search("c1", transform=ordered),), "ordered needs a list of increasing values"),
    ],
)
def test_what_is_refused(searches, told):
    with pytest.raises(ValueError, match=told) as error:
        made(*searches)
    assert "\n" not in str(error.value)


def test_neighbours_keep_their_order():
    """A cap that must not fall below its floor: the boxes meet in the middle."""
    space = made(Search("thmin_P", 0.0, 4000.0), Search("thmax_P"), of=fuzzy())
    least, most = sorted(space.entries, key=lambda e: e.path, reverse=False)
    assert float(least.high) == float(most.low) == 2000.0
    alone = made(Search("thmax_P"), of=case("af-pid-ccc"))
    assert float(alone.entries[0].low) == 400.0


def test_the_box_is_the_users_else_the_studys_else_a_factor():
    """What is named keeps the bounds of its study, each that the user leaves out."""
    (own,) = (e for e in made(*default_searches(case())).entries if e.path == "gains.slope")
    factor = np.array([0.1, 10.0])
    assert not np.array_equal([own.low[0], own.high[0]], factor), "the study says something else"
    (named,) = made(Search("c1")).entries
    np.testing.assert_array_equal([named.low, named.high], [own.low, own.high])
    (high,) = made(Search("c1", high=3.0)).entries
    assert (high.low[0], high.high[0]) == (own.low[0], 3.0)
    far = js.replace(case().gains, slope=2 * own.high)
    (beyond,) = made(Search("c1"), of=case()._replace(gains=far)).entries
    np.testing.assert_allclose([beyond.low[0], beyond.high[0]], factor * far.slope[0])
    (none,) = made(Search("nominal.mass"), of=case()).entries
    np.testing.assert_allclose(
        [none.low / none.before, none.high / none.before], [[0.1] * 2, [10.0] * 2]
    )


def test_every_loop_has_a_default_search_that_fits():
    """The boxes of the studies hold the published values and lie in the ranges of the fields."""
    names = {}
    for name in js.loop_names():
        law = js.find(name).build
        names.setdefault(getattr(law, "args", (name,))[0], name)
    for name in names.values():
        found = case(name)
        space = search_space(found, default_searches(found))
        start = space.gains_of(jnp.asarray(space.start()))
        for entry in space.entries:
            assert np.all(np.isfinite(entry.low) & np.isfinite(entry.high)), (name, entry.path)
        values = zip(jax.tree.leaves(start), jax.tree.leaves(found.gains), strict=True)
        assert all(np.allclose(a, b, rtol=1e-9) for a, b in values), name
