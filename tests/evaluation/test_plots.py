"""The plot of errors: what it shows, and that its file is the same every time."""

import numpy as np

from shapefit.evaluation.plots import draw_errors, save
from shapefit.evaluation.summaries import ImageErrors

SEQUENCES = ("13_1", "13_1", "13_2", "14_1", "14_1")


def errors(method="a", shift=0.0):
    values = np.array([3.0, 1.0, 6.0, 5.0, np.nan]) + shift
    return ImageErrors(method, "similarity", "m", tuple("pqrst"), SEQUENCES, values)


def test_a_line_a_method_has_the_sorted_errors_of_the_images_that_did_not_fail():
    nothing = ImageErrors("c", "similarity", "m", tuple("pqrst"), SEQUENCES, np.full(5, np.nan))
    figure = draw_errors([errors(), errors("b", 1), nothing])
    (axis,) = figure.axes
    first, second, third = axis.lines
    np.testing.assert_allclose(first.get_ydata(), [1, 3, 5, 6])
    np.testing.assert_allclose(first.get_xdata(), [10, 30, 50, 70])
    np.testing.assert_allclose(second.get_ydata(), [2, 4, 6, 7])
    assert len(third.get_ydata()) == 0
    assert axis.get_ylabel() == "error (m)"


def test_files_are_the_same_every_time_and_need_no_screen(tmp_path):
    for form in ("png", "svg"):
        for turn in ("first", "second"):
            save(draw_errors([errors(), errors("b")]), tmp_path / turn, form)
        assert (tmp_path / "first").read_bytes() == (tmp_path / "second").read_bytes()
