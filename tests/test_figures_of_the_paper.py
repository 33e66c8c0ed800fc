"""The paper's table on motion capture is measured again, and texts name its figures."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from ruamel.yaml import YAML

from benchmarks import turned_images
from experiments import pages
from tests.io.files import load
from tests.stated_figures import (
    FURTHER_FITS,
    PAPER_TABLE,
    TABLE_FITS,
    keep_images,
    report,
    rows_below_the_header,
    runner,
    table,
    within,
)


def paper_report(
    project: Path,
    data: Path,
    folder: Path,
    every: int,
    fits: tuple[str, ...] = (*TABLE_FITS, *FURTHER_FITS),
    people: bool = False,
) -> dict:
    """Return the report of the paper's methods on every so many frames of motion
    capture.

    people: besides, by the posterior with the dictionary of the package, as `People`,
    which has seen neither subject.
    """
    run = runner(project, folder, f"data={data / 'mocap'}")
    run("learn-dict", "mocap/learn-dict")
    run("learn-dict", "paper/learn-pmp")
    run("project", "mocap/project")
    views = folder / "results/mocap/landmarks.h5"
    keep_images(views, lambda images: np.arange(0, len(images), every))
    for name in fits:
        run("fit", f"paper/fit-{name}")
    results = results_of_the_paper(folder, fits)
    if people:
        results["People"] = "results/paper/people.h5"
        output = ["-d", "people", "-o", results["People"]]
        run("fit", "people/fit", str(views), *output)
    run("eval", "paper/eval", "--set", f"results={json.dumps(results)}")
    return report(folder / "results/paper/mocap/report.csv")


def results_of_the_paper(folder: Path, fits: tuple[str, ...]) -> dict[str, str]:
    """Return method -> file, of these fits, as the paper's evaluation names them."""
    config = YAML(typ="safe").load(folder / "configs/paper/eval.yaml")
    results = {}
    for method, file in config["results"].items():
        if Path(file).stem in fits:
            results[method] = file.removeprefix("../../")
    return results


SUBJECTS = ("Subject 13", "Subject 14")


def mean_error(figures: dict, method: str, group: str) -> float:
    """Return the mean similarity error, normalised."""
    mean, _ = figures[method, "similarity", "normalised", group]
    return mean


def check_order(figures: dict) -> None:
    """Fail unless Convex is below Alternate below PMP for each subject, as in the
    paper.
    """
    for group in SUBJECTS:
        convex = mean_error(figures, "Convex", group)
        alternate = mean_error(figures, "Alternate", group)
        pmp = mean_error(figures, "PMP", group)
        assert convex < alternate < pmp, group


ON_A_SLICE = {
    "Convex": ("0.289", "0.289"),
    "Alternate": ("0.326", "0.319"),
    "Alternate+": ("0.282", "0.283"),
    "PMP": ("0.384", "0.403"),
    "Alternate, six views": ("0.280", "0.282"),
    "Convex+refine": ("0.287", "0.282"),
    "Mean shape": ("0.541", "0.565"),
    "Global": ("0.285", "0.281"),
    "People": ("0.214", "0.208"),
}
"""Mean similarity errors, normalised, of subjects 13 and 14 on every hundredth frame:
441 images.
"""


@pytest.mark.real_data
def test_a_slice_of_the_paper_s_table(project, real_data, tmp_path):
    fits = (*TABLE_FITS, *FURTHER_FITS, "global")
    figures = paper_report(project, real_data, tmp_path, 100, fits, people=True)
    for method, both in ON_A_SLICE.items():
        for group, stated in zip(SUBJECTS, both, strict=True):
            mean = mean_error(figures, method, group)
            assert within(mean, stated), (method, group, mean, stated)
    check_order(figures)


@pytest.mark.slow
@pytest.mark.real_data
def test_turned_images(project, real_data, tmp_path):
    run = runner(project, tmp_path, f"data={real_data / 'mocap'}")
    run("learn-dict", "mocap/learn-dict")
    run("project", "mocap/project")
    images = load(tmp_path / "results/mocap/landmarks.h5")
    some = images.take(np.arange(0, len(images), turned_images.EVERY))
    dictionary = str(tmp_path / "results/mocap/dictionary.h5")
    stated = table(project / "docs/accuracy.md", "| median | most")
    for method in ("convex", "convex+refine"):
        change = turned_images.measure_change(some, dictionary, method)
        median, most, _ = stated[f"`{method}`"]
        assert within(float(np.median(change)), median), method
        assert within(float(change.max()), most), method


OF_OTHER_TESTS = {"Posterior", "Sequences"}


@pytest.mark.slow
@pytest.mark.real_data
def test_the_paper_s_table_on_motion_capture(project, real_data, tmp_path):
    """Of every fifth frame; neighbours of 24 a second are alike, and the means those of
    all.
    """
    figures = paper_report(project, real_data, tmp_path, every=5)
    rows = rows_below_the_header(table(project / "docs/accuracy.md", PAPER_TABLE))
    checked = 0
    for method in rows.keys() - OF_OTHER_TESTS:
        ours = rows[method][::2]
        for group, stated in zip(SUBJECTS, ours, strict=True):
            mean = mean_error(figures, method, group)
            assert within(mean, stated), (method, group, mean, stated)
            checked += 1
    assert checked == 2 * 7
    check_order(figures)


def cells_of(line: str) -> list[str]:
    """Return the cells of a row of a table but the first."""
    _first, *cells = [cell.strip() for cell in line.strip("|").split("|")]
    return cells


def test_the_published_figures_are_quoted_alike(project):
    """In docs/accuracy.md and experiments/published.yaml."""
    rows = table(project / "docs/accuracy.md", PAPER_TABLE)
    for method, errors in pages.quoted("mocap")["rows"].items():
        for column, group in ((1, "Subject 13"), (3, "Subject 14")):
            assert float(rows[method][column]) == errors[group]


def test_the_readme_names_the_figures_of_the_documentation(project):
    """README's table has its methods across; the paper's figure stands in brackets."""
    stated = table(project / "docs/accuracy.md", PAPER_TABLE)
    lines = (project / "README.md").read_text(encoding="utf-8").splitlines()
    header = next(line for line in lines if line.startswith("| | Convex"))
    methods = cells_of(header)
    assert methods == ["Convex", "Alternate", "Alternate+", "PMP"]
    for column, subject in ((0, "subject 13"), (2, "subject 14")):
        row = next(line for line in lines if line.startswith(f"| {subject}"))
        for method, cell in zip(methods, cells_of(row), strict=True):
            ours, paper = stated[method][column : column + 2]
            assert cell == (ours if paper == "–" else f"{ours} (*{paper}*)")


IN_TEXTS_ALONE = {"0.280", "0.868", "0.804", "0.805"}
"""A median and the mean objectives."""


TEXTS = [
    ("README.md", "The paper's table", "All figures"),
    ("docs/experiments.md", "| in the paper", "## Your own"),
    ("docs/accuracy.md", "**Where alternation", "![Boxes"),
]
"""A page, and where a text about the table begins and ends."""


@pytest.mark.parametrize(("page", "begin", "end"), TEXTS)
def test_texts_name_the_errors_of_the_table(project, page, begin, end):
    """Numbers of three digits in the texts about the table are numbers of the table."""
    rows = table(project / "docs/accuracy.md", PAPER_TABLE)
    in_the_table = {cell for cells in rows.values() for cell in cells}
    text = (project / page).read_text(encoding="utf-8")
    section = text.partition(begin)[2].partition(end)[0]
    named = set(re.findall(r"\b0\.\d{3}\b", section))
    assert len(named) >= 6
    assert named <= in_the_table | IN_TEXTS_ALONE
