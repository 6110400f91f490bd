"""Pictures: drawn for every kind of run, honest about scale, whole or absent."""

import errno

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.figure import Figure

import jaxstage as js
from jaxstage import plot
from jaxstage.metrics import contour, record, together, tracking, windowed
from jaxstage.metrics.words import length_text, time_text
from jaxstage.model.fields import replace
from jaxstage.plot.contour import magnification
from jaxstage.plot.numbers import envelope, pixels, round_down
from jaxstage.plot.pictures import save
from jaxstage.plot.style import reversals
from jaxstage.plot.weights import equal_cells

SHORT = js.Timing(lap_time=0.5, dt=1e-3)
ALWAYS = {"contour.png", "axes.png", "error.png", "command.png"}
KINDS = {
    "cascade-bowknot": ALWAYS,
    "sliding-star": ALWAYS | {"surface.png"},
    "dfcmac-circle": ALWAYS | {"surface.png", "weights.png"},
}


def simulated(name, timing):
    case = js.build(name, timing)
    judged = windowed(together(tracking, contour), case.window.start, case.window.stop, "scored")
    run = js.with_metric(case, together(judged, record)).simulate()
    flags = {name: int(getattr(run.final, name)) for name in ("left_path_at", "non_finite_at")}
    return case, run, {name: tick if tick >= 0 else None for name, tick in flags.items()}


def drawn_of(case, run, result, folder):
    return plot.pictures(case, run.report["scored"], run.rows["record"], result, folder)


def size_of(file):
    """Width, height and length in bytes of a PNG that is complete."""
    data = file.read_bytes()
    assert data.startswith(b"\x89PNG") and data[-8:-4] == b"IEND"
    return int.from_bytes(data[16:20]), int.from_bytes(data[20:24]), len(data)


def texts(figure):
    found = [t.get_text() for t in figure.findobj(lambda a: hasattr(a, "get_text"))]
    return " / ".join(found)


@pytest.fixture(scope="module")
def circle():
    return simulated("dfcmac-circle", js.Timing(lap_time=0.5))


@pytest.fixture(scope="module")
def shown(circle):
    case, run, _ = circle
    return plot.view(case, run.report["scored"], run.rows["record"])


@pytest.mark.parametrize("name", KINDS)
def test_every_kind_of_run_has_its_pictures(name, tmp_path, circle):
    made = circle if name == "dfcmac-circle" else simulated(name, SHORT)
    files = drawn_of(*made, tmp_path)
    assert {f.name for f in files} == KINDS[name] == {f.name for f in tmp_path.iterdir()}
    for file in files:
        width, height, size = size_of(file)
        assert 1000 <= width <= 1700 and 500 <= height <= 1500 and size > 20_000


def test_a_lost_run_is_drawn_up_to_its_loss(tmp_path):
    case, run, result = simulated("dfcmac-circle", SHORT)
    lost = result["left_path_at"]
    assert lost is not None
    assert len(drawn_of(case, run, result, tmp_path)) == 6
    view = plot.view(case, run.report["scored"], run.rows["record"], "it left")
    assert view.lost == lost == len(view.time) and np.isfinite(view.error).all()
    for draw in (plot.contour, plot.axes, plot.error, plot.command, plot.surface, plot.weights):
        assert f"LOST at t = {lost} ms (tick {lost} of 1000): it left" in texts(draw(view))
    assert "lost here" in texts(plot.contour(view))


def test_a_run_lost_at_its_first_tick_gives_no_picture_and_removes_old_ones(circle, tmp_path):
    case, run, result = circle
    blank = replace(run.rows["record"].output, position=np.full((1000, 2), np.nan))
    rows = replace(run.rows["record"], output=blank)
    (tmp_path / "contour.png").write_text("old")
    result = {**result, "left_path_at": 0}
    assert plot.pictures(case, run.report["scored"], rows, result, tmp_path) == ()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("count", [1, 3])
def test_one_and_three_axes(shown, count):
    def widened(array):
        return np.stack([array[:, 0], array[:, 1], array[:, 0]], axis=1)[:, :count]

    fields = ("reference", "velocity", "tool", "error", "rate", "nearest", "command", "demand",
              "weights", "surface", "curve")  # fmt: skip
    view = shown._replace(
        axes=("x", "y", "z")[:count],
        slope=shown.slope[:1],
        heading=np.append(shown.heading, 0.0)[:count],
        **{name: widened(getattr(shown, name)) for name in fields},
    )
    for draw in (plot.axes, plot.error, plot.command, plot.surface, plot.weights):
        draw(view).savefig(_Nowhere())
    if count == 1:
        with pytest.raises(ValueError, match="two axes"):
            plot.contour(view)
    else:
        assert len(plot.contour(view).axes) == 3


class _Nowhere:
    """A file that forgets."""

    def write(self, data):
        return len(data)

    def flush(self):
        pass


def test_contour_states_its_magnification_verdict_and_settings(shown):
    words = texts(plot.contour(shown))
    factor = magnification(shown)
    assert (
        f"drawn × {factor:g}" in words and f"error × {factor:g} (lap 2 of 2, 0.5 to 1 s)" in words
    )
    assert "path: 10 mm" in words and "error: " in words
    rms = np.sqrt(np.mean(shown.distance[5000:] ** 2))
    assert f"contour error {rms * 1e6:.3g} µm RMS" in words
    for setting in ("2 laps of 500 ms", "100 µs", "double", "seed 0", js.__version__):
        assert setting in words


def test_drawn_error_over_factor_is_the_contour_error(shown):
    axes = plot.contour(shown).axes[0]
    tool = next(item for item in axes.lines if str(item.get_label()).startswith("tool"))
    outside = np.hypot(*np.asarray(tool.get_data())) - 25.0
    largest = np.max(np.abs(outside)) / magnification(shown) * 1e3
    np.testing.assert_allclose(largest, np.max(shown.distance[5000:]) * 1e6, rtol=0.01)
    low, high = axes.get_xlim()
    assert axes.get_aspect() == 1.0 and low < -25 < 25 < high


def test_reversals_of_a_circle(shown):
    assert reversals(shown, 0) == pytest.approx([5000, 7500], abs=1)
    assert reversals(shown, 1) == pytest.approx([6250, 8750], abs=1)


def test_a_run_scored_as_a_whole_has_no_other_laps(shown):
    whole = shown._replace(scored=(0, len(shown.time)), scored_text="whole run")
    for draw in (plot.contour, plot.error):
        words = texts(draw(whole))
        assert "other laps" not in words and "whole run" in words
        assert "other laps" in texts(draw(shown))


def test_laws_without_memory_are_refused(shown):
    with pytest.raises(ValueError, match="no weights"):
        plot.weights(shown._replace(weights=None))
    with pytest.raises(ValueError, match="no sliding variable"):
        plot.surface(shown._replace(surface=None))


def test_nothing_half_written(tmp_path, monkeypatch):
    def full(file):
        raise OSError(errno.ENOSPC, "disk full")

    (tmp_path / "a.png").write_bytes(b"old")
    monkeypatch.setattr("jaxstage.system.files.os.fsync", full)
    with pytest.raises(OSError, match="disk full") as refused:
        save(Figure(), tmp_path / "a.png")
    assert refused.value.filename == str(tmp_path / "a.png")
    assert [f.name for f in tmp_path.iterdir()] == ["a.png"]
    assert (tmp_path / "a.png").read_bytes() == b"old"


def test_equal_cells_share_a_line():
    values = np.zeros((5, 2, 3, 3))
    values[:, 0, 1, 1] = values[:, 1, 1, 1] = np.arange(5)
    values[3:, 1, 0, 2] = 1.0
    assert equal_cells(values) == [[(0, 1, 1), (1, 1, 1)], [(1, 0, 2)]]


series = st.integers(1, 3000).flatmap(
    lambda n: st.tuples(
        st.just(n), st.integers(0, 2**32 - 1), st.integers(0, n - 1), st.floats(-1e9, 1e9)
    )
)


@settings(max_examples=60, deadline=None)
@given(series, st.integers(1, 200))
def test_thinning_never_loses_an_extreme(drawn, count):
    n, seed, where, spike = drawn
    random = np.random.default_rng(seed)
    x, y = np.sort(random.uniform(size=n)), random.normal(size=n)
    y[where] = spike
    kept = envelope(x, y, count)
    assert np.all(np.diff(kept) > 0) and len(kept) <= max(n if n <= 4 * count else 0, 4 * count)
    column = np.minimum((x - x[0]) / ((x[-1] - x[0]) or 1.0) * count, count - 1).astype(int)
    for c in np.unique(column):
        of_all, of_kept = y[column == c], y[kept[column[kept] == c]]
        assert of_kept.min() == of_all.min() and of_kept.max() == of_all.max()
        assert of_kept[0] == of_all[0] and of_kept[-1] == of_all[-1]


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 2000), st.integers(0, 2**32 - 1), st.integers(2, 300))
def test_thinned_path_stays_within_a_pixel(n, seed, count):
    points = np.cumsum(np.random.default_rng(seed).normal(size=(n, 2)), axis=0)
    kept = pixels(points, count)
    size = np.max(np.ptp(points, axis=0)) / count
    before = kept[np.searchsorted(kept, np.arange(n), side="right") - 1]
    assert kept[0] == 0 and kept[-1] == n - 1
    assert np.max(np.abs(points - points[before])) <= size * (1 + 1e-9)


def test_numbers_in_words():
    assert [round_down(v) for v in (1.0, 1.99, 2.0, 4.9, 99.0, 0.3)] == [1, 1, 2, 2, 50, 0.2]
    assert round_down(0.2 / 0.1) == 2 and round_down(0.6 / 0.3) == 2
    assert length_text(16.14e-6) == "16.1 µm" and length_text(0.0124) == "12.4 mm"
    assert length_text(1e-3) == "1 mm" and length_text(9.996e-4) == "1 mm"
    assert length_text(1.234) == "1230 mm" and length_text(999e-6) == "999 µm"
    assert time_text(1e-4) == "100 µs" and time_text(0.043) == "43 ms" and time_text(5.0) == "5 s"
