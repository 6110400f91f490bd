"""What of a run is scored: it follows the lap time, is stated, and is at least a lap."""

import pytest

import jaxstage as js
from jaxstage.model.fields import replace
from jaxstage.studies.case import retimed
from jaxstage.studies.verdict import scored_columns, scored_text
from tuning.store.prepare import prepare

pytestmark = pytest.mark.fast


def scored(loop, *words):
    return scored_columns(prepare(loop, words).case)


def test_what_a_study_leaves_out_follows_the_lap_time():
    """The first lap of three: 4 of 12 s as published, 1.57 of 4.71 s at another lap time."""
    own = scored("cascade-r-motor")
    assert (own["scored_from_s"], own["scored_to_s"]) == pytest.approx((4.0, 12.0), abs=5e-4)
    short = scored("cascade-r-motor", "lap_time=1.57", "laps=3")
    assert short["scored_from_s"] == pytest.approx(1.57, abs=5e-4)
    assert short["scored_laps"] == pytest.approx(2.0, abs=1e-3)
    assert scored("cascade-r-motor", "lap_time=1.57")["scored_to_s"] == pytest.approx(
        4.71, abs=5e-4
    )


def test_it_follows_a_lap_time_that_comes_from_a_feed():
    """asmc-s1 leaves out a twentieth of its lap, whatever the feed."""
    assert scored("asmc-s1")["scored_laps"] == pytest.approx(0.95)
    fast = scored("asmc-s1", "feed=600")
    assert fast["scored_laps"] == pytest.approx(0.95, abs=1e-3)
    assert fast["scored_from_s"] == pytest.approx(fast["scored_to_s"] / 20, abs=5e-3)


def test_a_part_of_a_lap_is_scored_only_by_name():
    with pytest.raises(ValueError, match=r"must be < the run .*more laps, or less skip"):
        prepare("cascade-r-motor", ["laps=1"])
    half = scored("cascade-r-motor", "laps=1", "skip=2")
    assert half["scored_laps"] == pytest.approx(0.5, abs=1e-3)


def test_a_window_of_less_than_a_lap_is_refused_in_one_line():
    own = js.find("cascade-circle").timing
    window = js.build("pi-circle", replace(own, lap_time=0.2, skip=0.3)).window
    with pytest.raises(ValueError, match=r"only 0.5 lap of the run would be scored: must be >= 1"):
        window.refuse_part_of_a_lap(own)
    window.refuse_part_of_a_lap(replace(own, laps=1, skip=0.6 * own.lap_time))


def test_timing_follows_only_where_nothing_is_named():
    own = js.Timing(lap_time=4.0, duration=12.0, skip=4.0)
    assert retimed(own, lap_time=2.0) == js.Timing(lap_time=2.0, duration=6.0, skip=2.0)
    assert retimed(own, lap_time=2.0, skip=1.0).skip == 1.0
    assert retimed(own, laps=5) == js.Timing(lap_time=4.0, laps=5, skip=4.0)
    assert retimed(own, scored=2) == js.Timing(lap_time=4.0, duration=12.0, scored=2)
    assert retimed(own, dt=1e-3) == replace(own, dt=1e-3)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({}, "lap 2 of 2, 0.2 to 0.4 s"),
        ({"scored": 0}, "whole run, 0 to 0.4 s"),
        ({"skip": 0.3}, "0.5 lap, 0.3 to 0.4 s"),
        ({"skip": 0.1}, "1.5 laps, 0.1 to 0.4 s"),
    ],
)
def test_the_scored_part_in_words(changes, text):
    case = js.build("pi-circle", js.Timing(lap_time=0.2, **changes))
    assert scored_text(case) == text
