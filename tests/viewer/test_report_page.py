"""A report as a page: the blocks of the Markdown, tables that sort, links that open the viewer."""

import csv

import numpy as np
import pytest

from shapefit.config import EvalConfig
from shapefit.evaluation.report import markdown_table
from shapefit.evaluation.summaries import ImageErrors
from shapefit.pipelines.evaluate import run as evaluate
from shapefit.pipelines.evaluate.run import RANKED, rank
from shapefit.viewer.report_page import add_section, report_page

BLOCKS = [
    "# Errors",
    "A paragraph.",
    markdown_table(["method", "mean"], [["b", "10.5 / 2"], ["a|c", "9.25 / 3"], ["paper", "–"]]),
    "## Failed",
    "- one: why",
    "![bars](bars.svg)",
]
DRAWING = b"<svg xmlns='http://www.w3.org/2000/svg'/>"


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
    assert column(0) == ["a|c", "b", "paper"]
    assert page.run("return document.querySelector('th').getAttribute('aria-sort')") == "ascending"
    assert page.run("return document.querySelector('figure img').complete")
    assert page.complaints() == []
    assert page.requests() == []


def test_further_blocks_stand_once_before_how_it_was_made():
    page = report_page(BLOCKS, drawings={"bars.svg": DRAWING}, provenance={"version": "1"})
    table = markdown_table(["method", "13"], [["*PMP*", "0.390"], ["<b>", "1"]])
    added = add_section(add_section(page, ["## Old"]), ["## Published", table])
    assert "Old" not in added
    for text in ("<h2>Published</h2>", "<i>PMP</i>", "0.390", "&lt;b&gt;"):
        assert added.count(text) == 1
        assert added.index("</figure>") < added.index(text) < added.index("How it was made")
    assert add_section(added, []) == page


@pytest.mark.parametrize("decimals", [0, 1, 9], ids=["all-equal", "ties", "no-ties"])
def test_images_are_ranked_and_those_of_equal_errors_in_their_order(rng, decimals):
    values = np.round(rng.random(150) / 3, decimals)
    values[::7] = np.nan
    items = tuple(f"i{i}" for i in range(150))
    found = rank(ImageErrors("m", "similarity", "m", items, ("",) * 150, values))
    known = np.flatnonzero(~np.isnan(values))
    order = known[np.argsort(-values[known], kind="stable")].tolist()
    middle = (len(order) - RANKED) // 2
    expected = order[:RANKED], order[middle : middle + RANKED], order[-RANKED:]
    assert tuple(found.values()) == expected
    few = ImageErrors("m", "similarity", "m", items[:3], ("",) * 3, np.array([1.0, 3, 2]))
    assert rank(few) == {"all images, worst first": [1, 2, 0]}


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
    assert page.run("return document.querySelectorAll('.images a').length") == 36
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
    page.find(".images a").click()
    page.until("return window.shapefit && shapefit.view.drawn > 0")
    assert page.state("item") == worst
