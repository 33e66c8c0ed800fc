"""The figures of real cars are measured again."""

import re
from pathlib import Path

import pytest

import shapefit
from experiments import pages
from experiments.car_bodies import measure_bodies
from tests.stated_figures import (
    report,
    rows_below_the_header,
    rows_of,
    runner,
    table,
    within,
)

NAMES_IN_THE_REPORT = {
    "Perspective** (`configs/cars/fit.yaml`)": "Perspective",
    "Mean shape, posed": "Mean shape",
}
"""Rows of the page that are called otherwise in the report."""


ORACLES = {
    "Mean shape, placed by an oracle",
    "Nearest other model, by an oracle",
    "Best combination, fitted to the 3D truth",
}
"""Rows that `python -m experiments published cars` measures."""


KINDS = [
    ("similarity", "normalised"),
    ("camera", "normalised"),
    ("rotation", "deg"),
    ("reprojection", "box"),
]
"""Metric and unit of each column."""


@pytest.mark.slow
@pytest.mark.real_data
def test_real_cars(project, real_data, tmp_path):
    run = runner(project, tmp_path, f"data={real_data / 'cars'}")
    run("learn-dict", "cars/learn-dict")
    run("fit", "cars/fit", "--set", "export={}")
    for path in sorted((project / "configs/cars/methods").glob("*.yaml")):
        run("fit", f"cars/methods/{path.stem}")
    run("eval", "cars/eval")
    check_cars(project, report(tmp_path / "results/cars/report/report.csv"))
    page = pages.add_published("cars", tmp_path / "results/cars/report")
    _, _, by_body = page.partition("By class of body")
    stated = table(project / "docs/accuracy.md", "photos")
    assert check_bodies(stated, rows_of(by_body)) == 4 * 3 * 3


def check_cars(project: Path, figures: dict) -> None:
    """Fail unless mean and median of each method and metric are those stated."""
    rows = rows_below_the_header(table(project / "docs/accuracy.md", "method, lambda"))
    checked = 0
    for row in rows.keys() - ORACLES:
        method = NAMES_IN_THE_REPORT.get(row, row)
        for (metric, unit), cell in zip(KINDS, rows[row], strict=False):
            measured_figures = figures.get((method, metric, unit, "all"), ())
            stated_figures = re.findall(r"[\d.]+", cell)
            both = zip(stated_figures, measured_figures, strict=bool(cell))
            for stated, measured in both:
                assert within(measured, stated), (row, metric, measured, stated)
                checked += 1
    assert checked == 2 * 11 * 4


def check_bodies(stated: dict[str, list[str]], found: dict[str, list[str]]) -> int:
    """Fail unless the errors by class of body are those stated; return how many are.

    Errors are texts, "similarity / camera frame / rotation".
    """
    checked = 0
    for method, cells in rows_below_the_header(stated).items():
        for stated_cell, cell in zip(cells, found[method], strict=True):
            both = zip(stated_cell.split(" / "), cell.split(" / "), strict=True)
            for figure, measured in both:
                assert within(float(measured), figure), (method, stated_cell, cell)
                checked += 1
    return checked


def shape_errors(rows: dict[str, list[str]], method: str) -> list[float]:
    """Return the similarity errors of a method, by class of body."""
    return [float(cell.split(" / ")[0]) for cell in rows[method]]


@pytest.mark.real_data
def test_sedan_suv_and_pick_up(project, real_data):
    shapes = shapefit.read_shapes(real_data / "cars/fg3dcar_shapes.h5")
    page, _ = measure_bodies(shapes, pages.quoted("cars")["bodies"])
    rows = rows_of(page)
    stated = table(project / "docs/accuracy.md", "made images")
    _, *convex = shape_errors(rows, "Convex")
    _, *alternative = shape_errors(rows, "Perspective from the mean shape")
    sedan, suv, pick_up = 0, 1, 2
    assert check_bodies(stated, rows) == 4 * 4 * 3
    assert alternative[sedan] < convex[sedan]
    assert convex[suv] < alternative[suv]
    assert convex[pick_up] < alternative[pick_up]
