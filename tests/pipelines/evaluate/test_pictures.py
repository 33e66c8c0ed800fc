"""The pictures that an evaluation draws beside its tables."""

import sys

import pytest

from shapefit.errors import InputError

FILES = {"per_image.csv", "report.csv", "report.json", "report.md", "report.html", "view.html"}


def test_plots_are_drawn_for_every_metric(desk):
    *_, last = desk.run(plots=True, metrics=["similarity", "reprojection"])
    names = ("similarity", "similarity_boxes", "reprojection", "reprojection_boxes")
    drawn = {f"{name}.{e}" for name in names for e in ("png", "svg")}
    assert {path.name for path in last.written} == FILES | drawn
    assert {path.name for path in desk.config.output.iterdir()} == FILES | drawn


def test_without_matplotlib_nothing_is_written(desk, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(
        InputError, match=r"plots: matplotlib is not installed; .*`pip install matplotlib`"
    ):
        desk.run(plots=True)
    assert not desk.config.output.exists()


def test_by_default_plots_are_left_out_without_matplotlib(desk, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    *_, last = desk.run(plots="auto")
    (warning,) = last.warnings
    assert warning.startswith("no plots: matplotlib is not installed; install it with `pip ")
    written = {path.name for path in desk.config.output.iterdir()}
    pages = {"report.html", "report.md", "view.html"}
    assert written == {"per_image.csv", "report.csv", "report.json", *pages}
