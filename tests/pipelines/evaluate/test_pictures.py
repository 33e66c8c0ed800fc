"""The pictures that an evaluation draws beside its tables."""

import sys

import numpy as np
import pytest

from shapefit.errors import InputError
from shapefit.io import write_shapes
from shapefit.pipelines.evaluate import run as evaluate

FILES = {"per_image.csv", "report.csv", "report.json", "report.md", "report.html", "view.html"}


def test_plots_are_drawn_for_every_metric(desk):
    *_, last = desk.run(plots=True, metrics=["similarity", "reprojection"])
    names = ("similarity", "similarity_boxes", "reprojection", "reprojection_boxes")
    drawn = {f"{name}.{e}" for name in names for e in ("png", "svg")}
    assert {path.name for path in last.written} == FILES | drawn
    assert {path.name for path in desk.config.output.iterdir()} == FILES | drawn


def test_boxes_are_those_of_the_normalised_errors_of_the_groups(desk, monkeypatch):
    asked = []
    draw = evaluate.box_plot
    monkeypatch.setattr(evaluate, "box_plot", lambda *a: asked.append(a) or draw(*a))
    desk.run(plots=True)
    kinds = [(e.metric, e.unit) for (e,), _ in asked]
    assert kinds == [
        ("similarity", "normalised"),
        ("camera", "normalised"),
        ("rotation", "deg"),
        ("reprojection", "m"),
    ]
    assert asked[0][1] == {"Subject 13": ("13_01", "13_02"), "Subject 14": ("14_01",)}


class TestExamples:
    @pytest.fixture(autouse=True)
    def edges(self, desk, truth):
        write_shapes(desk.folder / "truth.h5", truth.replaced(edges=np.array([[0, 1], [1, 3]])))

    def test_they_are_drawn_for_methods_by_name(self, desk, results):
        desk.write("b.h5", results)
        files = {"Convex": [desk.folder / "convex.h5"], "Alternate": [desk.folder / "b.h5"]}
        *_, last = desk.run(results=files, plots=True, examples=["item3", "item5"])
        assert {path.name for path in last.written} >= {"examples.png", "examples.svg"}
        assert (desk.config.output / "examples.png").read_bytes().startswith(b"\x89PNG")
        svg = (desk.config.output / "examples.svg").read_text()
        shown = {line.strip() for line in svg.splitlines() if line.strip().startswith("<!--")}
        words = {"landmarks", "truth", "Convex", "Alternate", "item3", "item5"}
        assert {f"<!-- {word} -->" for word in words} <= shown

    @pytest.mark.parametrize("keys", [{"plots": False}, {"examples": 0}, {"examples": []}])
    def test_they_are_not_drawn_unasked(self, desk, keys):
        *_, last = desk.run(**{"plots": True, "examples": 2, **keys})
        assert not any(path.name.startswith("examples") for path in last.written)

    def test_without_edges_nothing_is_read_or_written(self, desk, truth):
        write_shapes(desk.folder / "truth.h5", truth)
        with pytest.raises(InputError, match=r"truth\.h5: has no edges"):
            desk.begin(plots=True, examples=1)
        assert not desk.config.output.exists()

    def test_an_unknown_item_leaves_no_report(self, desk):
        with pytest.raises(InputError, match="'item9'"):
            desk.run(plots=True, examples=["item9"])
        assert not desk.config.output.exists()


def test_without_matplotlib_nothing_is_written(desk, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(
        InputError, match=r"plots: matplotlib is not installed; .*`pip install matplotlib`"
    ):
        desk.run(plots=True)
    with pytest.raises(InputError, match="examples: matplotlib is not installed"):
        desk.run(plots="auto", examples=1)
    assert not desk.config.output.exists()


def test_by_default_plots_are_left_out_without_matplotlib(desk, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    *_, last = desk.run(plots="auto")
    (warning,) = last.warnings
    assert warning.startswith("no plots: matplotlib is not installed; install it with `pip ")
    written = {path.name for path in desk.config.output.iterdir()}
    pages = {"report.html", "report.md", "view.html"}
    assert written == {"per_image.csv", "report.csv", "report.json", *pages}
