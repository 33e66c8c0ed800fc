"""The experiments of the paper: what is measured, and the pages of it."""

import csv
import json
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from scipy.special import kolmogorov

import shapefit
from experiments import pages, sensitivity
from experiments.__main__ import write_points, write_recovery
from shapefit.evaluation.page import ORIGIN


def table(page):
    """Return the rows of all tables of a page, by first cell."""
    rows = {}
    for line in page.splitlines():
        if "|" in line:
            first, *cells = re.split(r" *\| *", line.strip("| "))
            rows[first] = cells
    return rows


@pytest.fixture(scope="module")
def recovery(tmp_path_factory):
    """The folder of a recovery experiment, and its page."""
    folder = tmp_path_factory.mktemp("recovery")
    page = write_recovery(folder, landmarks=(10, 20, 60), active=(1, 2, 3), trials=40)
    return folder, page


@pytest.fixture(scope="module")
def recovered_shares(recovery):
    """Landmarks and active atoms -> the share of trials in which they are recovered."""
    folder, _ = recovery
    with (folder / "recovery.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["p", "z", "trials", "success"]
    assert {row["trials"] for row in rows} == {"40"}
    return {(int(row["p"]), int(row["z"])): float(row["success"]) for row in rows}


def test_the_shares_of_the_paper_are_quoted():
    paper = pages.quoted_shares()
    assert len(paper) == 100
    assert paper[10, 1] == 0.95
    assert paper[40, 8] == 0.55


def test_recovery_is_written_beside_the_paper(recovery, recovered_shares):
    _, page = recovery
    paper = pages.quoted_shares()
    shared = recovered_shares.keys() & paper.keys()
    deviations = [recovered_shares[kind] - paper[kind] for kind in shared]
    largest = max(deviations, key=abs)
    assert len(recovered_shares) == 9
    assert abs(largest) < 0.15
    assert f"The largest deviation is {largest:+.2f}" in page


def test_recovery_has_a_picture_and_a_page(recovery):
    folder, page = recovery
    assert (folder / "recovery.png").read_bytes()[1:4] == b"PNG"
    assert (folder / "recovery.md").read_text(encoding="utf-8") == page


# Corruption


@pytest.fixture
def images(rng):
    """Images of nine landmarks, a third of them hidden, in the first all."""
    w = rng.standard_normal((1500, 9, 2))
    w[rng.random((1500, 9)) < 1 / 3] = np.nan
    w[0] = np.nan
    return shapefit.Landmarks(w)


SHARES = [0.0, 0.3, 1.0]


def replaced_landmarks(images, corrupted):
    """Return which visible landmarks differ."""
    before = images.landmarks
    differs = (corrupted.landmarks != before) & np.isfinite(before)
    return differs.any(axis=2)


@pytest.mark.parametrize("share", SHARES)
def test_the_share_of_the_visible_landmarks_is_replaced(images, share):
    corrupted = sensitivity.corrupt(images, share)
    wrong = corrupted.extras["corrupted"]
    seen = sensitivity.visible_landmarks(images)
    have_a_box = seen.sum(axis=1) > 1
    changed = replaced_landmarks(images, corrupted)
    deviations = wrong.sum(axis=1) - share * seen.sum(axis=1)
    assert_array_equal(sensitivity.visible_landmarks(corrupted), seen)
    assert np.abs(deviations).max() < 1
    assert_array_equal(changed[have_a_box], wrong[have_a_box])


@pytest.mark.parametrize("share", SHARES[1:])
def test_landmarks_are_placed_uniformly_inside_the_grown_box(images, share):
    """By a test of Kolmogorov and Smirnov; the box is grown by a tenth on each side."""
    corrupted = sensitivity.corrupt(images, share)
    boxed = sensitivity.visible_landmarks(images).sum(axis=1) > 1
    wrong = corrupted.extras["corrupted"][boxed]
    before = images.landmarks[boxed]
    low = np.nanmin(before, axis=1)[:, None]
    high = np.nanmax(before, axis=1)[:, None]
    in_box = (corrupted.landmarks[boxed] - low) / (high - low)
    places = np.sort((in_box[wrong].ravel() + 0.1) / 1.2)
    assert kolmogorov(np.sqrt(len(places)) * distance_from_uniform(places)) > 1e-3


def distance_from_uniform(places):
    """Return the largest distance of an empirical distribution from the uniform one."""
    count = len(places)
    ranks = np.arange(count)
    below = (places - ranks / count).max()
    above = ((ranks + 1) / count - places).max()
    return max(below, above)


# Sensitivity


@pytest.fixture(scope="module")
def points(project):
    """The error of half the people against lambda, in groups by sequence; and the
    errors of each sequence by lambda.
    """
    samples = project / "sample_data"
    truth = shapefit.read_shapes(samples / "people_test.h5")
    images = shapefit.read_landmarks(samples / "people_views.csv")
    dictionary = shapefit.learn(shapefit.read_shapes(samples / "people_train.h5"), k=8)
    experiment = sensitivity.Experiment(
        "lambda",
        "lambda",
        (0.1, 1.0),
        project / "configs/paper/fit-convex.yaml",
        lambda _: (images, dictionary),
        lambda: truth,
        options=lambda value: {"lam": value},
        groups={"all of them": "*"},
        every=2,
    )
    expected = {}
    for lam in experiment.values:
        fit = shapefit.fit(images[::2], dictionary, lam, method="convex")
        expected[lam] = errors_by_sequence(shapefit.evaluate(fit, truth))
    return sensitivity.measure(experiment), expected


def errors_by_sequence(measured):
    """Return the errors of the images of each sequence."""
    errors = measured.errors["similarity", "normalised"]
    names = np.array(measured.sequences)
    return [errors[names == name] for name in dict.fromkeys(measured.sequences)]


def test_statistics_are_means_of_those_of_the_sequences(points):
    found, expected = points
    assert [point.value for point in found] == [0.1, 1.0]
    for point in found:
        sequences = expected[point.value]
        means = [errors.mean() for errors in sequences]
        quartiles = [np.percentile(errors, (25, 50, 75)) for errors in sequences]
        p25, median, p75 = np.mean(quartiles, axis=0)
        assert point.images == sum(map(len, sequences))
        assert point.mean == pytest.approx(np.mean(means))
        assert point.p25 == pytest.approx(p25)
        assert point.median == pytest.approx(median)
        assert point.p75 == pytest.approx(p75)
        assert point.seconds_per_image > 0


def test_points_of_an_experiment_come_back(points, tmp_path):
    found, _ = points
    write_points(tmp_path, found)
    expected = [replace(point, value=str(point.value)) for point in found]
    assert sensitivity.read_points(tmp_path) == expected


def test_tables_and_figures_of_an_experiment(points, tmp_path):
    found, _ = points
    first, *_ = found
    write_points(tmp_path, found)
    rows = table((tmp_path / "sweep.md").read_text(encoding="utf-8"))
    assert rows["0.1"][0] == f"{first.mean:.3f} / {first.median:.3f}"
    assert (tmp_path / "sweep.png").stat().st_size > 5000


def test_points_may_have_names(points, tmp_path):
    found, _ = points
    named = [
        replace(point, value=name) for point, name in zip(found, "ab", strict=True)
    ]
    write_points(tmp_path, named)


def test_images_that_failed_are_a_share_of_those_that_were_lifted(points):
    found, _ = points
    failed = [replace(point, failed=point.images) for point in found]
    assert table(sensitivity.table_of(failed))["0.1"][1] == "50 %"


# Pages

SUMMARY = {
    "method": "Convex",
    "metric": "similarity",
    "unit": "normalised",
    "group": "Subject 13",
    "sequence": None,
}


REPORT = {
    "config": {"groups": {"Subject 13": "13_*", "Subject 14": "14_*"}},
    "methods": [
        {"name": "Alternate", "mean_objective": 0.8046},
        {"name": "Alternate+", "mean_objective": None},
    ],
    "summaries": [
        {**SUMMARY, "mean": 0.2891},
        {**SUMMARY, "sequence": "13_01", "mean": 0.9},
        {**SUMMARY, "unit": "m", "mean": 0.07},
    ],
}


SWEEPS = {
    "timing": ("convex", "mean-shape"),
    "timing-pmp": ("pmp",),
    **dict.fromkeys(pages.SENSITIVITIES, ("0.5",)),
}
"""Folder -> the values of its points."""


@pytest.fixture(scope="module")
def reports(tmp_path_factory, points):
    """Reports as `make paper` leaves them."""
    folder = tmp_path_factory.mktemp("reports")
    mocap = folder / "mocap"
    mocap.mkdir()
    (mocap / "report.json").write_text(json.dumps(REPORT), encoding="utf-8")
    page = f"<h1>Errors</h1>\n{ORIGIN}<dl></dl>\n"
    (mocap / "report.html").write_text(page, encoding="utf-8")
    point = replace(points[0][0], seconds_per_image=5e-4, mean=0.25)
    for name, values in SWEEPS.items():
        write_points(folder / name, [replace(point, value=value) for value in values])
    return folder


def test_the_index_sets_numbers_beside_those_of_the_paper(reports):
    page = pages.index(reports)
    rows = table(page)
    assert rows["Convex"] == ["0.289", "*0.259*", "–", "*0.258*"]
    assert rows["Alternate"] == ["–", "*0.293*", "–", "*0.308*"]
    assert rows["convex"] == ["0.5", "*330*"]
    assert rows["mean-shape"] == ["0.5", "–"]
    assert rows["pmp"] == ["0.5", "*3020*"]
    assert rows["0.5"] == ["0.250"]
    assert "Mean objective: Alternate 0.805, Alternate+ –. The paper's" in page
    assert "*Alternate 0.24, Alternate+ 0.17*" in page


def test_the_index_links_figures_reports_and_sweeps(reports):
    page = pages.index(reports)
    linked = set(re.findall(r"\]\(([\w-]+/\w+\.md)\)", page))
    sweeps = {f"{name}/sweep.md" for name in (*pages.SENSITIVITIES, "timing")}
    assert "(mocap/errors.svg)" in page
    assert "(mocap/sequences.svg)" in page
    assert "(mocap/report.html)" in page
    assert linked >= sweeps


@pytest.fixture
def mocap(reports, tmp_path):
    """A copy of the report on motion capture."""
    return shutil.copytree(reports / "mocap", tmp_path / "mocap")


def report_page(folder):
    return (folder / "report.html").read_text(encoding="utf-8")


def test_published_rows_are_added_to_a_report(mocap):
    page = pages.add_published("mocap", mocap)
    report = report_page(mocap)
    header = ["Subject 13", "*the paper*", "Subject 14", "*the paper*"]
    assert table(page)["method"] == header
    assert table(page)["PMP"] == ["–", "*0.390*", "–", "*0.393*"]
    assert "- Sequences 14_31 and 14_36 are one motion." in page
    assert "<td>PMP</td><td>–</td><td>0.390</td>" in report
    assert "<li>Sequences 14_31 and 14_36 are one motion.</li>" in report


def test_published_rows_are_added_once(mocap):
    page = pages.add_published("mocap", mocap)
    once = report_page(mocap)
    again = pages.add_published("mocap", mocap)
    assert again == page
    assert report_page(mocap) == once


def test_published_rows_change_nothing_else_of_a_report(mocap):
    before = report_page(mocap)
    pages.add_published("mocap", mocap)
    after = report_page(mocap)
    head, _, rest = after.partition("<section")
    _, _, tail = rest.partition("</section>\n")
    assert head + tail == before
