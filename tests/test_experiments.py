"""The experiments of the paper, and the bounds of cars and of optimality beside
them.
"""

import csv
import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.special import kolmogorov

import shapefit
from benchmarks.lower_bounds import best_combination, nearest_atom
from benchmarks.optimality import sections
from experiments import pages, sensitivity
from experiments.__main__ import write_points, write_recovery
from shapefit.evaluation.metrics import similarity
from shapefit.evaluation.page import ORIGIN
from shapefit.geometry.rotations import random_rotations


def table(page):
    lines = [
        re.split(r" *\| *", line.strip("| "))
        for line in page.splitlines()
        if "|" in line
    ]
    return {line[0]: line[1:] for line in lines}


def test_recovery_is_written_beside_the_paper(tmp_path):
    page = write_recovery(tmp_path, landmarks=(10, 20, 60), active=(1, 2, 3), trials=40)
    with (tmp_path / "recovery.csv").open(newline="", encoding="utf-8") as file:
        rows = [dict(row) for row in csv.DictReader(file)]
    assert list(rows[0]) == ["p", "z", "trials", "success"]
    shares = {(int(r["p"]), int(r["z"])): float(r["success"]) for r in rows}
    assert len(shares) == 9
    assert {r["trials"] for r in rows} == {"40"}
    paper = pages.quoted_shares()
    assert len(paper) == 100
    assert paper[10, 1] == 0.95
    assert paper[40, 8] == 0.55
    for at in shares.keys() & paper.keys():
        assert abs(shares[at] - paper[at]) < 0.15
    most = max((shares[at] - paper[at] for at in shares.keys() & paper.keys()), key=abs)
    assert f"The largest deviation is {most:+.2f}" in page
    assert (tmp_path / "recovery.png").read_bytes()[1:4] == b"PNG"
    assert (tmp_path / "recovery.md").read_text(encoding="utf-8") == page


class TestCorruption:
    @pytest.fixture
    def images(self, rng):
        w = rng.standard_normal((1500, 9, 2))
        w[rng.random((1500, 9)) < 1 / 3] = np.nan
        w[0] = np.nan
        return shapefit.Landmarks(w)

    @pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
    def test_the_share_of_the_visible_landmarks_is_replaced_inside_the_grown_box(
        self, images, share
    ):
        after = sensitivity.corrupt(images, share)
        before, w, wrong = images.landmarks, after.landmarks, after.extras["corrupted"]
        seen = sensitivity.visible(images)
        np.testing.assert_array_equal(sensitivity.visible(after), seen)
        assert np.abs(wrong.sum(axis=1) - share * seen.sum(axis=1)).max() < 1
        boxed = seen.sum(axis=1) > 1
        changed = ((w != before) & np.isfinite(before)).any(axis=2)
        np.testing.assert_array_equal(changed[boxed], wrong[boxed])
        if share:
            low, high = (f(before[boxed], axis=1) for f in (np.nanmin, np.nanmax))
            place = (w[boxed] - low[:, None]) / (high - low)[:, None]
            place = (place[wrong[boxed]] + 0.1) / 1.2
            place, ranks = np.sort(place.ravel()), np.arange(place.size)
            apart = max(
                (place - ranks / len(place)).max(),
                ((ranks + 1) / len(place) - place).max(),
            )
            assert kolmogorov(np.sqrt(len(place)) * apart) > 1e-3


@pytest.fixture(scope="module")
def points(project):
    """The error of half the people against lambda, in groups by sequence."""
    shapes = shapefit.read_shapes(project / "sample_data/people_train.h5")
    truth = shapefit.read_shapes(project / "sample_data/people_test.h5")
    images = shapefit.read_landmarks(project / "sample_data/people_views.csv")
    dictionary = shapefit.learn(shapes, k=8)
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
    half = images[::2]
    expected = {}
    for lam in experiment.values:
        fit = shapefit.fit(half, dictionary, lam, method="convex")
        errors = shapefit.evaluate(fit, truth)
        values = errors.errors["similarity", "normalised"]
        names = np.array(errors.sequences)
        expected[lam] = [
            values[names == name] for name in dict.fromkeys(errors.sequences)
        ]
    return sensitivity.measure(experiment), expected


def test_statistics_are_means_of_those_of_the_sequences(points):
    found, expected = points
    assert [point.value for point in found] == [0.1, 1.0]
    for point in found:
        parts = expected[point.value]
        assert point.images == sum(map(len, parts))
        assert point.mean == pytest.approx(np.mean([part.mean() for part in parts]))
        quartiles = np.mean(
            [np.percentile(part, (25, 50, 75)) for part in parts], axis=0
        )
        assert [point.p25, point.median, point.p75] == pytest.approx(quartiles)
        assert point.seconds_per_image > 0


def test_tables_figures_and_files_of_an_experiment(points, tmp_path):
    found, _ = points
    write_points(tmp_path, found)
    again = sensitivity.read_points(tmp_path)
    assert [replace(p, value=str(p.value)) for p in found] == again
    rows = table((tmp_path / "sweep.md").read_text(encoding="utf-8"))
    assert rows["0.1"][0] == f"{found[0].mean:.3f} / {found[0].median:.3f}"
    assert (tmp_path / "sweep.png").stat().st_size > 5000
    named = [
        replace(point, value=name) for point, name in zip(found, "ab", strict=True)
    ]
    write_points(tmp_path, named)
    failed = [replace(point, failed=point.images) for point in found]
    assert table(sensitivity.table_of(failed))["0.1"][1] == "50 %"


@pytest.fixture(scope="module")
def reports(tmp_path_factory, points):
    """Reports as `make paper` leaves them."""
    folder = tmp_path_factory.mktemp("reports")
    row = {
        "metric": "similarity",
        "unit": "normalised",
        "group": "Subject 13",
        "sequence": None,
    }
    report = {
        "config": {"groups": {"Subject 13": "13_*", "Subject 14": "14_*"}},
        "methods": [
            {"name": "Alternate", "mean_objective": 0.8046},
            {"name": "Alternate+", "mean_objective": None},
        ],
        "summaries": [
            {**row, "method": "Convex", "mean": 0.2891},
            {**row, "method": "Convex", "sequence": "13_01", "mean": 0.9},
            {**row, "method": "Convex", "unit": "m", "mean": 0.07},
        ],
    }
    (folder / "mocap").mkdir()
    (folder / "mocap/report.json").write_text(json.dumps(report), encoding="utf-8")
    page = f"<h1>Errors</h1>\n{ORIGIN}<dl></dl>\n"
    (folder / "mocap/report.html").write_text(page, encoding="utf-8")
    for name, values in {
        "timing": ("convex", "mean-shape"),
        "timing-pmp": ("pmp",),
        **dict.fromkeys(pages.SENSITIVITIES, ("0.5",)),
    }.items():
        own = [
            replace(points[0][0], value=v, seconds_per_image=5e-4, mean=0.25)
            for v in values
        ]
        write_points(folder / name, own)
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
    assert "(mocap/errors.svg)" in page
    assert "(mocap/sequences.svg)" in page
    assert "(mocap/report.html)" in page
    linked = set(re.findall(r"\]\(([\w-]+/\w+\.md)\)", page))
    assert linked >= {f"{name}/sweep.md" for name in (*pages.SENSITIVITIES, "timing")}


def test_published_rows_are_added_to_a_report_once(reports, tmp_path):
    folder = shutil.copytree(reports / "mocap", tmp_path / "mocap")
    before = (folder / "report.html").read_text(encoding="utf-8")
    page = pages.add_published("mocap", folder)
    header = ["Subject 13", "*the paper*", "Subject 14", "*the paper*"]
    assert table(page)["method"] == header
    assert table(page)["PMP"] == ["–", "*0.390*", "–", "*0.393*"]
    assert "- Sequences 14_31 and 14_36 are one motion." in page
    once = (folder / "report.html").read_text(encoding="utf-8")
    assert "<td>PMP</td><td>–</td><td>0.390</td>" in once
    assert "<li>Sequences 14_31 and 14_36 are one motion.</li>" in once
    assert pages.add_published("mocap", folder) == page
    assert (folder / "report.html").read_text(encoding="utf-8") == once
    start = once.index("<section")
    end = once.index("</section>\n")
    assert once[:start] + once[end + len("</section>\n") :] == before


BEST = [1.0, 2.0, 4.0, np.nan]


def write_result(
    path: Path,
    *,
    signed: bool = False,
    status: list[str] | None = None,
    **data: list[float],
):
    with h5py.File(path, "w") as file:
        file.attrs["config"] = json.dumps({"signed": signed})
        for name, values in data.items():
            file[name] = values
        if status is not None:
            file.create_dataset("status", data=status, dtype=h5py.string_dtype())


@pytest.fixture
def optima(tmp_path):
    status = ["optimal", "iteration limit", "optimal", "degenerate"]
    gap = [0.01, 0.03, 0.0, np.nan]
    write_result(
        tmp_path / "global.h5", objective=BEST, relative_gap=gap, status=status
    )
    refined = [1.0, 2.5, 4.0, np.nan]
    write_result(
        tmp_path / "refine.h5", objective=refined, relative_gap=[0.1, 0.5, 0.0, np.nan]
    )
    write_result(
        tmp_path / "alternate-nonnegative.h5", objective=[1.005, 2.0, 6.0, np.nan]
    )
    return tmp_path


def cells(page: str) -> dict[str, list[str]]:
    lines = [
        line.strip("|").split("|") for line in page.splitlines() if line.startswith("|")
    ]
    return {first.strip(): [entry.strip() for entry in rest] for first, *rest in lines}


def test_excess_and_the_parts_of_the_gap(optima):
    _, text, table = sections(optima)
    found = cells(table)
    assert found["Convex+refine"] == [
        "33.33%",
        "25% (25%)",
        "20.00%",
        "6.67%",
        "13.33%",
    ]
    search = (1 - 1 / 1.005 + 1 - 4 / 6) / 3
    assert found["Alternate, c >= 0"] == [
        "33.33%",
        "50% (50%)",
        "–",
        f"{search:.2%}",
        "–",
    ]
    assert found["the better of both"][:2] == ["0.00%", "0% (0%)"]
    assert "Certified to 1%: 66.67% of 3 images; largest gap 3.00%." in text


def test_results_of_another_model_are_refused(optima):
    write_result(optima / "alternate-nonnegative.h5", signed=True, objective=BEST)
    with pytest.raises(ValueError, match="another model"):
        sections(optima)


@pytest.fixture
def atoms(rng):
    """Variants of one shape, as exemplars are: a rotation fits all of them or none."""
    atoms = rng.standard_normal((3, 9)) + 0.4 * rng.standard_normal((4, 3, 9))
    return atoms - atoms.mean(axis=-1, keepdims=True)


def test_the_nearest_atom_is_the_one_that_the_shape_was_made_from(atoms, rng):
    made_from = np.array([2, 0, 3, 2])
    noise = 0.01 * rng.standard_normal((4, 3, 9))
    shapes = 5 * random_rotations(4, rng) @ (atoms[made_from] + noise) + 7
    np.testing.assert_allclose(
        nearest_atom(shapes, atoms), similarity(atoms[made_from], shapes), rtol=1e-12
    )


def test_a_combination_of_atoms_is_found_whichever_way_it_is_turned_and_sized(
    atoms, rng
):
    c = np.abs(rng.standard_normal((6, 4)))
    mixed = np.einsum("nk,kap->nap", c, atoms)
    shapes = 3 * random_rotations(6, rng) @ mixed + rng.standard_normal((6, 3, 1))
    np.testing.assert_allclose(best_combination(shapes, atoms), 3 * mixed, atol=1e-3)
    np.testing.assert_allclose(
        similarity(best_combination(shapes, atoms), shapes), 0, atol=1e-3
    )
