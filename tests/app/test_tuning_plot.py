"""The pictures of a tuning show what they are given."""

import numpy as np
import pytest

from jaxstage.plot import tuning

pytestmark = pytest.mark.fast


def words(figure):
    texts = [text.get_text() for text in figure.texts]
    for ax in figure.axes:
        texts += [ax.get_xlabel(), ax.get_ylabel(), *(t.get_text() for t in ax.texts)]
        texts += [t.get_text() for t in (ax.get_legend().get_texts() if ax.get_legend() else ())]
        texts += [t.get_text() for t in (*ax.get_xticklabels(), *ax.get_yticklabels())]
    return " ".join(" ".join(texts).split())


NONE = np.full(2, np.nan)
TRACES = (
    tuning.Trace(
        name="lm",
        units=np.array([0.0, 20.0, 45.0]),
        best=np.array([1.0, 0.2, 0.05]),
        gradient=np.array([np.nan, 0.3, 0.01]),
        violation=np.array([np.nan, -0.1, -0.2]),
    ),
    tuning.Trace("cma", np.array([0.0, 50.0]), np.array([1.0, 0.4]), NONE, NONE),
)


def test_history_is_a_line_a_method_and_its_gradient_where_there_is_one():
    drawn = tuning.history(TRACES, "footer of the tuning")
    best, gradient = drawn.axes
    assert best.get_yscale() == "log"
    np.testing.assert_array_equal(best.get_lines()[0].get_ydata(), TRACES[0].best)
    assert len(gradient.get_lines()) == 1
    told = words(drawn)
    for text in ("lm: 0.05 after 45 units", "cma: 0.4 after 50 units", "footer of the tuning"):
        assert text in told, text
    assert len(tuning.history(TRACES[1:], "").axes) == 1
    assert "Crosses" not in told


def test_history_marks_what_misses_a_goal():
    """The best gains are those that miss the goals least: their objective may rise."""
    met = TRACES[0]._replace(
        best=np.array([1.0, 1.4, 1.2]), violation=np.array([np.nan, 0.3, -0.1])
    )
    best = tuning.history([met], "").axes[0]
    np.testing.assert_array_equal(best.get_lines()[0].get_ydata(), [1.0, 1.4, 1.2])
    (crosses,) = [line for line in best.get_lines() if line.get_marker() == "X"]
    assert crosses.get_xydata().tolist() == [[20.0, 1.4]]
    assert "Crosses miss a goal" in words(best.figure)


def test_gains_stand_in_their_ranges_the_farthest_moved_first():
    still = tuning.Moved("eta (m/s2)", 1.0, 1.0, 0.1, 10.0, True, False)
    far = tuning.Moved("c1 (1/s)", 1.0, 10.0, 0.1, 10.0, True, True)
    linear = tuning.Moved("w (A)", 0.0, 0.5, -1.0, 1.0, False, False)
    drawn = tuning.parameters([still, linear, far], "")
    (ax,) = drawn.axes
    assert [label.get_text() for label in ax.get_yticklabels()] == [
        "c1 (1/s)", "w (A)", "eta (m/s2)",
    ]  # fmt: skip
    places = [line.get_xdata() for line in ax.get_lines() if len(line.get_xdata()) == 2][1::2]
    np.testing.assert_allclose(places, [[0.5, 1.0], [0.5, 0.75], [0.5, 0.5]])
    assert "1 → 10 in 0.1 … 10" in words(drawn)
    many = [far._replace(label=str(i)) for i in range(tuning.MOST_GAINS + 5)]
    assert "The 5 that moved least are not drawn" in words(tuning.parameters(many, ""))


def test_the_front_is_drawn_in_every_pair_with_the_suggestion():
    points = np.array([[1.0, 3.0, 2.0], [2.0, 2.0, 2.5], [3.0, 1.0, 1.0], [3.0, 3.0, 3.0]])
    kept = np.array([True, True, True, False])
    drawn = tuning.front(points, kept, 1, np.array([4.0, 2.0, 2.0]), ("a", "b", "c"), "foot")
    assert [(ax.get_xlabel(), ax.get_ylabel()) for ax in drawn.axes] == [
        ("a", "b"), ("a", "c"), ("b", "c"),
    ]  # fmt: skip
    for ax, (i, j) in zip(drawn.axes, ((0, 1), (0, 2), (1, 2)), strict=True):
        lines = {line.get_label(): line.get_xydata() for line in ax.get_lines()}
        np.testing.assert_array_equal(lines["beaten"], points[3:][:, [i, j]])
        np.testing.assert_array_equal(lines["front"], points[:3][:, [i, j]])
        np.testing.assert_array_equal(lines["suggested"], points[1:2][:, [i, j]])
    two = tuning.front(points[:, :2], kept, 0, np.array([4.0, 2.0]), ("a", "b"), "")
    assert len(two.axes) == 1
