"""A report as a page: the blocks of the Markdown, tables that sort, images that open the viewer."""

import csv
import json

import numpy as np
import pytest

from shapefit.config import EvalConfig, SweepConfig
from shapefit.evaluation.summary import ImageErrors
from shapefit.evaluation.tables.document import (
    Italic,
    Listing,
    Picture,
    Section,
    Table,
    Title,
    as_markdown,
)
from shapefit.pipelines import sweeps as sweep
from shapefit.pipelines.evaluate import run as evaluate
from shapefit.pipelines.evaluate.report_pages import (
    SHOWN,
    contact_sheet,
    contact_sheets,
    rank,
)
from shapefit.viewer.report_page import report_page

BLOCKS = [
    Title("Errors"),
    "A paragraph.",
    Table(["method", "mean"], [["b", "10.5 / 2"], ["a", "9.25 / 3"], [Italic("paper"), "–"]]),
    Section("Failed"),
    Listing(["one: why"]),
    Picture("bars.svg", "bars"),
    Picture("../pictures/contact_sheet.png", "Contact sheet of a"),
]
DRAWING = b"<svg xmlns='http://www.w3.org/2000/svg'/>"


def test_blocks_are_one_page_in_markdown():
    text = as_markdown(BLOCKS)
    assert text.startswith("# Errors\n\nA paragraph.\n\n| method  |     mean |\n")
    assert "| *paper* |        – |" in text
    assert "\n## Failed\n\n- one: why\n\n![bars](bars.svg)\n" in text


def test_tables_sort_by_number_up_and_down(tmp_path, open_page):
    path = tmp_path / "report.html"
    html = report_page(BLOCKS, drawings={"bars.svg": DRAWING}, provenance={"version": "1"})
    path.write_text(html, encoding="utf-8")
    page = open_page(path)

    def column(number):
        return page.run(
            f"return [...document.querySelectorAll('tbody tr')].slice(0, 3)"
            f".map((row) => row.cells[{number}].textContent)"
        )

    heads = page.driver.find_elements("css selector", "th button")
    heads[1].click()
    assert column(1) == ["9.25 / 3", "10.5 / 2", "–"]
    heads[1].click()
    assert column(1)[1:] == ["10.5 / 2", "9.25 / 3"]
    heads[0].click()
    assert column(0) == ["a", "b", "paper"]
    assert page.run("return document.querySelector('th').getAttribute('aria-sort')") == "ascending"
    assert page.run("return document.querySelector('figure img').complete")
    assert page.complaints() == []
    assert page.requests() == []


def test_the_worst_median_and_best_images_are_ranked(rng):
    values = rng.permutation(np.arange(101.0))
    values[values == 50] = np.nan
    items = tuple(f"i{i}" for i in range(101))
    found = rank(ImageErrors("m", "similarity", "m", items, ("",) * 101, values))
    assert [found[kind][0].error for kind in ("worst", "best")] == [100, 11]
    assert [image.error for image in found["best"]] == list(np.arange(11.0, -1, -1))
    assert all(values[image.row] == image.error for image in found["median"])
    assert {len(rows) for rows in found.values()} == {SHOWN}
    middle = np.median([image.error for image in found["median"]])
    assert abs(middle - np.nanmedian(values)) <= 1
    few = ImageErrors("m", "similarity", "m", items[:3], ("",) * 3, np.array([1.0, 3, 2]))
    assert rank(few) == {"all images, worst first": [(1, "i1", 3), (2, "i2", 2), (0, "i0", 1)]}


@pytest.mark.parametrize("decimals", [0, 1, 9], ids=["all-equal", "ties", "no-ties"])
def test_images_of_equal_errors_are_ranked_in_their_order(rng, decimals):
    values = np.round(rng.random(150) / 3, decimals)
    values[::7] = np.nan
    items = tuple(f"i{i}" for i in range(150))
    found = rank(ImageErrors("m", "similarity", "m", items, ("",) * 150, values))
    known = np.flatnonzero(~np.isnan(values))
    order = known[np.argsort(-values[known], kind="stable")].tolist()
    middle = (len(order) - SHOWN) // 2
    expected = order[:SHOWN], order[middle : middle + SHOWN], order[-SHOWN:]
    assert tuple([image.row for image in found[kind]] for kind in found) == expected


def test_contact_sheets_are_linked_where_they_are(tmp_path):
    pictures, report = tmp_path / "pictures", tmp_path / "report"
    pictures.mkdir()
    config = json.dumps({"pictures": {"folder": str(pictures), "format": "png"}})
    assert contact_sheet(config) is None
    (pictures / "contact_sheet.png").touch()
    assert [contact_sheet(other) for other in ("{", "[]", "")] == [None] * 3
    found = contact_sheet(config)
    assert found is not None
    _, sheet = contact_sheets({"a": [found]}, report)
    assert sheet == Picture("../pictures/contact_sheet.png", "Contact sheet of a")


@pytest.fixture(scope="module")
def evaluated(sequence, tmp_path_factory):
    folder = tmp_path_factory.mktemp("evaluated") / "report"
    config = EvalConfig(
        results={"walker": (sequence.result,)},
        truth=(sequence.truth,),
        output=folder,
        metrics=("similarity",),
    )
    outcomes = list(evaluate.run(config))
    assert not any(outcome.warnings for outcome in outcomes)
    return folder


def test_a_report_shows_its_plots_and_images(evaluated, open_page):
    page = open_page(evaluated / "report.html")
    titles = page.run("return [...document.querySelectorAll('h2, h3')].map((e) => e.textContent)")
    assert {"Plots", "How it was made", "walker: worst", "walker: best"} <= set(titles)
    assert page.run("return document.querySelectorAll('.card svg path').length") > 36 * 4
    assert page.run("return document.querySelectorAll('figure img').length") == 2
    text = (evaluated / "report.md").read_text("utf-8")
    for name in ("similarity", "similarity_boxes"):
        assert f"({name}.png)" in text
        assert (evaluated / f"{name}.png").is_file()


def test_the_worst_image_leads_to_its_frame(evaluated, open_page):
    with (evaluated / "per_image.csv").open(encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["unit"] == "normalised"]
    worst = max(rows, key=lambda row: float(row["error"]))["item"]
    page = open_page(evaluated / "report.html")
    page.find("a.card").click()
    page.until("return window.shapefit && shapefit.drawn > 0")
    assert page.state("item") == worst


def test_a_sweep_shows_its_best_value(project, tmp_path):
    data = project / "sample_data"
    config = SweepConfig(
        project={"shapes": data / "people_test.h5"},
        learn_dict={"shapes": data / "people_train.h5", "k": 8, "iterations": 2},
        fit={"method": "convex"},
        truth=(data / "people_test.h5",),
        vary={"fit.lambda": (0.1, 50.0)},
        every=20,
        output=tmp_path / "sweep",
        plots=False,
    )
    *_, last = sweep.run(config)
    assert {path.name for path in last.written} >= {"report.html", "view.html", "sweep.md"}
    html = (tmp_path / "sweep/report.html").read_text("utf-8")
    assert "<h3>0.1: all images, worst first</h3>" in html or "<h3>0.1: worst</h3>" in html
    assert "Error against fit.lambda" in html


def test_without_a_view_there_are_no_links(sequence, tmp_path):
    settings = {"truth": (sequence.truth,), "metrics": ("similarity",), "plots": False}
    config = EvalConfig(
        results={"walker": (sequence.result,)}, output=tmp_path / "out", view=False, **settings
    )
    *_, last = evaluate.run(config)
    assert "view.html" not in {path.name for path in last.written}
    assert (
        "view.html" not in (tmp_path / "out/report.html").read_text("utf-8").split("<details>")[0]
    )
