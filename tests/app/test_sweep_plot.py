"""Pictures of a sweep show what the table says."""

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from jaxstage.plot import sensitivity, sweep
from jaxstage.plot.numbers import plain

SHEET = sweep.Sheet("contour max (µm)", 20.0, "64 plants | seed 0")
SOURCE = np.random.default_rng(0)
VALUES = SOURCE.uniform(5, 25, 400)
VALUES[:7] = np.nan
PASSED = VALUES < 20
ONE = sweep.MetricSample("pi-circle", VALUES, PASSED, "yield 74 %", (0.74, 0.7, 0.78))
OTHER = sweep.MetricSample("cascade-circle", VALUES[::-1] + 1, VALUES[::-1] + 1 < 20)

pytestmark = pytest.mark.fast


def words(figure):
    found = [text.get_text() for text in figure.texts]
    for ax in figure.axes:
        found += [ax.get_xlabel(), ax.get_ylabel(), ax.get_title("right")]
        found += [text.get_text() for text in ax.texts]
        legend = ax.get_legend()
        found += [text.get_text() for text in legend.get_texts()] if legend else []
    return " ".join(" ".join(found).split())


def test_the_distribution_has_limit_interval_and_lost_runs():
    drawn = sweep.distribution([ONE, OTHER], SHEET)
    told = words(drawn)
    for text in (
        "limit 20",
        "contour max (µm)",
        "yield 74 %",
        "7 lost",
        "64 plants",
        "share of plants",
    ):
        assert text in told, text
    often, share = drawn.axes
    for ax in (often, share):
        assert any(np.all(np.asarray(line.get_xdata()) == 20.0) for line in ax.lines)
    curve = next(line for line in share.lines if "pi-circle" in str(line.get_label()))
    assert curve.get_ydata()[-1] == pytest.approx(393 / 400), "lost runs never come in"
    at = np.searchsorted(curve.get_xdata(), 20.0) - 1
    assert curve.get_ydata()[at] == pytest.approx(PASSED.sum() / 400)
    (bar,) = share.containers
    assert bar.lines[0].get_ydata()[0] == 0.74


def test_a_sweep_that_is_all_lost_can_be_drawn():
    lost = sweep.MetricSample("pi-circle", np.full(9, np.nan), np.zeros(9, bool))
    assert "all runs were lost" in words(sweep.distribution([lost], SHEET))
    columns = {"plant.mass x (kg)": SOURCE.random(9)}
    sweep.parameters(lost, columns, {"plant.mass x (kg)": None}, SHEET)
    sweep.versus(lost, lost, "words", SHEET)


def test_samples_far_apart_are_all_resolved():
    """Bins are shared, so that heights compare, and as narrow as the narrowest sample needs."""
    near, far = SOURCE.lognormal(0.0, 0.3, 400), SOURCE.lognormal(4.0, 0.02, 400)
    samples = [sweep.MetricSample("near", near, None), sweep.MetricSample("far", far, None)]
    drawn = sweep.distribution(samples, SHEET._replace(limit=None))
    outlines = [p for p in drawn.axes[0].patches if not p.get_fill()]
    for patch, values in zip(outlines, (near, far), strict=True):
        heights = patch.get_path().vertices[:, 1]
        # an outline goes up and down: two corners a bin
        assert len(np.unique(patch.get_path().vertices[heights > 0, 0])) > 8
        assert heights.max() < len(values) / 2
    one = sweep.MetricSample("constant", np.full(9, 3.0), None)
    assert sweep.distribution([one], SHEET).axes[0].patches


def test_failing_and_lost_plants_are_marked():
    names = ["plant.mass x (kg)", "plant.load x (N)"]
    columns = {name: SOURCE.random(400) for name in names}
    drawn = sweep.parameters(ONE, columns, dict(zip(names, (0.1, -0.6), strict=True)), SHEET)
    first = drawn.axes[0]
    assert first.get_xlabel() == "plant.load x (N)", "the strongest first"
    assert first.get_title("right") == "rho -0.60"
    marks = {
        line.get_marker(): len(line.get_xdata())
        for line in first.lines
        if line.get_marker() != "None"
    }
    failed = int((~PASSED & np.isfinite(VALUES)).sum())
    assert marks == {".": int(PASSED.sum()), "x": failed, "v": 7}
    told = words(drawn)
    assert "median of 12 slices" in told and "Crosses" in told and "Triangles" in told
    assert any(line.get_marker() == "None" and len(line.get_xdata()) == 12 for line in first.lines)
    far = sweep.parameters(ONE, columns, {}, SHEET._replace(limit=500.0))
    assert "The limit of 500 is off the scale" in words(far)
    assert max(ax.get_ylim()[1] for ax in far.axes) < 40


def test_a_picture_of_few_plants_explains_nothing_that_is_not_drawn():
    good = sweep.MetricSample("pi-circle", SOURCE.uniform(5, 15, 64), np.ones(64, bool))
    drawn = sweep.parameters(good, {"plant.mass x (kg)": SOURCE.random(64)}, {}, SHEET)
    told = words(drawn)
    assert "Each dot is one plant" in told
    assert not any(word in told for word in ("Black", "Crosses", "Triangles"))
    (dots,) = (line for line in drawn.axes[0].lines if len(line.get_xdata()) == 64)
    assert dots.get_marker() == "." and dots.get_markersize() == 7


def test_a_tornado_starts_at_the_nominal_plant():
    effects = [
        sensitivity.Effect("plant.mass x", 8.0, 14.0, (9.0, 13.0)),
        sensitivity.Effect("plant.load x", 12.0, 9.0),
    ]
    drawn = sensitivity.tornado("pi-circle", 10.0, effects, SHEET, ("drive.delay",))
    (ax,) = drawn.axes
    ends = sorted((bar.get_x(), bar.get_x() + bar.get_width()) for bar in ax.patches)
    assert {x for pair in ends for x in pair} == {8.0, 9.0, 10.0, 12.0, 14.0}
    assert "nominal plant: 10" in words(drawn)
    assert "there is no slope: drive.delay." in " ".join(words(drawn).split())
    diamonds = [line.get_xdata()[0] for line in ax.lines if line.get_marker() == "D"]
    assert diamonds == [9.0, 13.0]


def test_indices_are_ordered_by_their_total():
    found = [
        sensitivity.Index("a", 0.1, 0.02, 0.2, 0.03),
        sensitivity.Index("b", 0.3, 0.02, 0.7, 0.05),
    ]
    (ax,) = sensitivity.indices("pi-circle", found, SHEET).axes
    assert [label.get_text() for label in ax.get_yticklabels()] == ["b", "a"]
    assert sorted(bar.get_width() for bar in ax.patches) == [0.1, 0.2, 0.3, 0.7]


def test_plants_that_are_no_sample_have_no_band():
    drawn = sweep.distribution([ONE], SHEET)
    corners = sweep.distribution([ONE._replace(chance=False)], SHEET)
    assert len(drawn.axes[1].collections) == len(corners.axes[1].collections) + 1
    assert "no sample of the spreads" in words(corners) and "band" not in words(corners)


def test_equal_figures_are_better_for_neither():
    told = words(sweep.versus(ONE, ONE, "Each dot is one plant.", SHEET))
    finite = int(np.isfinite(ONE.values).sum())
    for text in ("pi-circle smaller: 0 plants", f"the same: {finite} plants"):
        assert text in told, text


def test_a_value_of_few_kinds_has_a_tick_and_a_median_for_each():
    delay = np.repeat([0.0, 1.0, 2.0, 2.0], 100)
    (ax,) = sweep.parameters(ONE, {"drive.delay": delay}, {"drive.delay": -0.001}, SHEET).axes
    assert ax.get_xticks().tolist() == [0, 1, 2] and ax.get_title("right") == "rho +0.00"
    (median,) = [line for line in ax.lines if len(line.get_xdata()) == 3]
    kept = np.isfinite(ONE.values)
    wanted = [np.median(ONE.values[kept & (delay == value)]) for value in (0, 1, 2)]
    assert median.get_ydata().tolist() == wanted


def test_one_controller_against_another():
    drawn = sweep.versus(ONE, OTHER, "Each dot is one plant.", SHEET)
    told = words(drawn)
    both = np.isfinite(ONE.values) & np.isfinite(OTHER.values)
    smaller = int((ONE.values[both] < OTHER.values[both]).sum())
    for text in (
        f"pi-circle smaller: {smaller} plants",
        f"cascade-circle smaller: {int(both.sum()) - smaller} plants",
        f"lost under one or both: {400 - int(both.sum())} plants",
        "Each dot is one plant.",
    ):
        assert text in told, text


def test_both_axes_have_one_scale_and_few_far_values_are_cut():
    near = np.linspace(10.0, 20.0, 200)
    far = np.append(near[:-2], [80.0, 75.0])
    a, b = (sweep.MetricSample(name, values, None) for name, values in (("a", near), ("b", far)))
    (ax,) = sweep.versus(a, b, "", SHEET._replace(limit=15.0)).axes
    assert ax.get_xlim() == ax.get_ylim() and ax.get_xlim()[1] < 25
    assert "beyond the scale: 2 plants" in words(ax.figure)
    (whole,) = sweep.versus(a, a, "", SHEET._replace(limit=50.0)).axes
    assert "beyond" not in words(whole.figure)
    assert "limit 50: off the scale" in words(whole.figure)


def test_yield_marks_stand_beside_each_other():
    twin = ONE._replace(name="twin")
    share = sweep.distribution([ONE, twin], SHEET).axes[1]
    marks = [bar.lines[0] for bar in share.containers]
    places = [mark.get_transform().transform(mark.get_xydata()[0])[0] for mark in marks]
    assert places[1] - places[0] > 10, "pixels"


@pytest.mark.parametrize(
    ("value", "text"),
    [(80000.0, "80,000"), (1234.5678, "1,235"), (0.00123456, "0.001235"), (0.0, "0"),
     (-30.0, "-30"), (2.5e6, "2,500,000"), (2.5e7, "2.5e+07"),
     (3.2e-5, "3.2e-05"),
     (99999.9, "100,000")],
)  # fmt: skip
def test_numbers_are_written_as_people_write_them(value, text):
    assert plain(value) == text


def test_a_long_title_is_wrapped_and_a_dollar_is_a_dollar():
    name = "a-loop-with-quite-a-long-name-of-its-own"
    columns = {"plant.mass x (kg)": SOURCE.random(400)}
    drawn = sweep.parameters(
        ONE._replace(name=name), columns, {}, SHEET._replace(footer="1 $ _a $")
    )
    renderer = FigureCanvasAgg(drawn).get_renderer()
    for text in drawn.texts:
        box = text.get_window_extent(renderer)
        assert box.x0 >= 0 and box.x1 <= drawn.bbox.x1, text.get_text()
    assert "$" in words(drawn)
