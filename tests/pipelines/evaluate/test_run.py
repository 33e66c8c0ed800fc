"""What an evaluation writes: tables, page, figures, warnings; and what stops it."""

import json
from itertools import pairwise
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.figure import Figure
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.config import EvalConfig
from shapefit.errors import InputError
from shapefit.evaluation import figures, metrics
from shapefit.geometry.procrustes import similarity_transform
from shapefit.io import write_shapes
from shapefit.pipelines.evaluate import run as evaluate
from shapefit.records import Fit
from shapefit.records.columns import in_columns
from tests.columns import put
from tests.pipelines.fitted import texts

from .conftest import N

FILES = {
    "per_image.csv",
    "per_landmark.csv",
    "report.csv",
    "report.html",
    "report.json",
}
FIGURES = {"errors", "sequences", "landmarks", "examples"}
SIZES = {"metric": "similarity", "unit": "m"}


@pytest.fixture
def failed(desk, results):
    """Evaluate results of which the last image failed; return the shapes and the
    outcomes.
    """
    shapes = results.shapes.copy()
    shapes[6] = np.nan
    objective = np.arange(7.0)
    desk.write("convex.h5", results.replaced(shapes=shapes, objective=objective))
    return shapes, desk.run()


def test_a_report_has_its_files(desk, failed):
    _, (*_, last) = failed
    assert {path.name for path in last.written} == FILES
    assert {path.name for path in desk.config.output.iterdir()} == FILES


def test_an_image_that_failed_is_told(desk, failed):
    _, (counted, outcome, last) = failed
    (failure,) = outcome.failures
    assert counted.total == outcome.done
    assert failure.item == "item6"
    assert failure.reason.startswith("convex: ")
    assert outcome.done == N
    assert outcome.warnings == ()
    assert last.warnings == ()
    assert last.note.splitlines()[-1] == "convex  failed: 1 of 7"
    assert "<li>convex, item6: " in desk.text("report.html")


def test_the_report_has_errors_and_their_means(desk, truth, failed):
    shapes, (*_, last) = failed
    errors = metrics.similarity_error(in_columns(shapes), truth.as_columns())
    sequence = desk.row(**SIZES, group="Subject 13", sequence="13_01")
    group = desk.row(**SIZES, group="Subject 13", sequence="")
    mean_of_sequence = errors[:4].mean()
    mean_of_group = (mean_of_sequence + errors[4]) / 2
    line, *_ = last.note.splitlines()
    assert_array_equal([*desk.errors(**SIZES).values()], errors)
    assert float(sequence["mean"]) == pytest.approx(mean_of_sequence)
    assert float(group["mean"]) == pytest.approx(mean_of_group)
    assert sequence["images"] == "4"
    assert group["images"] == "5"
    in_mm = 1000 * float(group["mean"])
    assert line.startswith(f"convex  Subject 13  error aligned {in_mm:.1f} mean, ")


def test_the_report_says_where_its_numbers_come_from(desk, failed):
    _, (*_, last) = failed
    document = json.loads(desk.text("report.json"))
    (method,) = document["methods"]
    files = {str(desk.config.truth[0]), str(*desk.config.results["convex"])}
    assert last.data() == document
    assert method["images"] == N
    assert method["failed"] == 1
    assert method["mean_objective"] == 3
    assert document["config"]["match"] == "item"
    assert set(document["inputs"]) == files


def test_groups_that_match_nothing_are_refused(desk):
    fault = r"groups: no sequence matches.*13_01, 13_02, 14_01"
    with pytest.raises(InputError, match=fault):
        desk.run(groups={"Subject 15": "15_*"})


@pytest.fixture
def with_and_without_bars(desk, with_bars):
    """Files of two methods, of which `posterior` has error bars."""
    return {
        "convex": desk.folder / "convex.h5",
        "posterior": desk.write("p.h5", with_bars),
    }


def test_error_bars_have_their_tables(desk, with_and_without_bars):
    *_, last = desk.run(results=with_and_without_bars)
    shares = [*desk.errors(method="posterior", metric="inside_90").values()]
    stated = last.numbers.share_inside_regions
    row = desk.row(metric="inside_90", group="Subject 13")
    first_of_calibration, *_ = json.loads(desk.text("report.json"))["calibration"]
    assert stated["convex"] is None
    assert stated["posterior"] == pytest.approx(np.mean(shares))
    assert float(row["mean"]) == pytest.approx(np.mean(shares[:5]))
    assert row["images"] == "25"
    assert not desk.errors(method="convex", metric="inside_90")
    assert first_of_calibration["counted"] == 25
    assert f"90% bars hold {100 * float(row['mean']):.0f}%" in last.note


def test_factors_make_error_bars_true(desk, with_bars, with_and_without_bars):
    desk.run(results=with_and_without_bars)
    (factors,) = json.loads(desk.text("error_bars.json")).values()
    widened = with_bars.replaced(shape_sd=factors["90%"] * with_bars.shape_sd)
    desk.write("p.h5", widened)
    desk.run(results=with_and_without_bars)
    inside_13 = float(desk.row(metric="inside_90", group="Subject 13")["mean"])
    inside_14 = float(desk.row(metric="inside_90", group="Subject 14")["mean"])
    inside = (25 * inside_13 + 10 * inside_14) / 35
    assert inside == pytest.approx(np.ceil(36 * 0.9) / 35)


@pytest.fixture
def hard_results(with_bars, rng):
    """Results with failed images and labels of outliers."""
    shapes = with_bars.shapes.copy()
    shapes[[0, 5]] = np.nan
    labels = {name: rng.random((N, 5)) < 0.4 for name in ("outliers", "corrupted")}
    return put(with_bars.with_points(shapes), labels)


@pytest.fixture
def report_of(desk):
    """Evaluate the parts of a method; return all that is written of them."""

    def write(parts):
        methods = {"m": parts, "other": [desk.folder / "convex.h5"]}
        desk.run(
            metrics=("similarity", "camera", "precision", "recall"),
            results=methods,
            truth=sorted(desk.folder.glob("truth*.h5")),
        )
        images = sorted(desk.text("per_image.csv").splitlines())
        first_method, *_ = json.loads(desk.text("report.json"))["methods"]
        tables = [desk.text(name) for name in ("report.csv", "error_bars.json")]
        return *tables, images, first_method["failures"]

    return write


@pytest.mark.parametrize("ends", [[0, 2, 4, 7], [0, 1, 7]])
def test_parts_have_the_report_of_one_file(desk, hard_results, report_of, ends):
    """To the last bit."""
    whole = report_of([desk.write("whole.h5", hard_results)])
    parts = []
    for start, end in pairwise(ends):
        part = hard_results.take(slice(start, end))
        parts.append(desk.write(f"part{start}.h5", part))
    assert report_of(parts) == whole


def test_many_files_of_the_truth_have_the_report_of_one(
    desk, hard_results, truth, report_of, rng
):
    """To the last bit, in any order."""
    results = [desk.write("whole.h5", hard_results)]
    whole = report_of(results)
    (desk.folder / "truth.h5").unlink()
    order = rng.permutation(N)
    for number in range(3):
        part = truth.take(order[number::3])
        write_shapes(desk.folder / f"truth{number}.h5", part)
    assert report_of(results) == whole


STARTS = {"svg": b"<?xml", "png": b"\x89PNG", "pdf": b"%PDF"}
"""Format -> the first bytes of its files."""


PLOTS = ["svg"] + [
    pytest.param(plots, marks=pytest.mark.slow) for plots in ("png", "pdf")
]
"""Formats of figures, of which matplotlib takes longer to draw two."""


@pytest.mark.parametrize("plots", PLOTS)
def test_figures_lie_beside_the_page_which_has_them_too(desk, with_bars, plots):
    desk.write("convex.h5", with_bars)
    *_, last = desk.run(plots=plots)
    figure_names = {f"{name}.{plots}" for name in FIGURES | {"bars"}}
    names = {path.name for path in last.written}
    page = desk.text("report.html")
    assert names == FILES | figure_names | {"error_bars.json"}
    assert last.written[0].name == "report.html"
    for name in figure_names:
        data = (desk.config.output / name).read_bytes()
        assert data.startswith(STARTS[plots])
    assert page.count("<figure>") == 5
    assert "<script" not in page


@pytest.mark.parametrize("plots", PLOTS)
def test_figures_and_page_are_the_same_bytes_again(desk, with_bars, plots):
    desk.write("convex.h5", with_bars)
    desk.run(plots=plots)
    drawn = [*desk.config.output.glob(f"*.{plots}"), desk.config.output / "report.html"]
    before = {path: path.read_bytes() for path in drawn}
    desk.run(plots=plots)
    assert {path: path.read_bytes() for path in drawn} == before


@pytest.mark.parametrize(
    ("metric", "drawn"),
    [("reprojection", {"errors"}), ("similarity", FIGURES - {"sequences"})],
)
def test_figures_need_no_alignment_and_no_sequences(
    desk, truth, results, metric, drawn
):
    desk.write("convex.h5", results.replaced(sequences=None))
    write_shapes(desk.folder / "truth.h5", truth.replaced(sequences=None))
    *_, last = desk.run(metrics=[metric], plots="svg", groups={})
    names = {path.name for path in last.written}
    assert names == FILES | {f"{name}.svg" for name in drawn}


@pytest.fixture
def without_matplotlib(monkeypatch):
    monkeypatch.setattr(evaluate, "find_spec", lambda _: None)


def test_without_matplotlib_there_are_tables_and_a_note(desk, without_matplotlib):
    *_, last = desk.run(plots="svg")
    (note,) = last.warnings
    assert {path.name for path in last.written} == FILES
    assert "pip install matplotlib" in note
    assert "pip install matplotlib" in desk.text("report.html")


def test_without_plots_matplotlib_is_not_missed(desk, without_matplotlib):
    *_, last = desk.run(plots="none")
    assert last.warnings == ()


def test_files_of_an_earlier_report_are_named(desk, with_bars, results):
    desk.write("convex.h5", with_bars)
    desk.run(plots="png")
    desk.write("convex.h5", results)
    *_, last = desk.run(plots="none")
    (warning,) = last.warnings
    assert "bars.png" in warning
    assert "error_bars.json" in warning
    assert "of an earlier report" in warning


def test_every_number_that_people_read_is_in_one_unit(desk, truth, results):
    """Millimetres on the terminal, the page and the figures; metres in tables."""
    desk.write("convex.h5", results.with_points(results.shapes * 0.1))
    write_shapes(desk.folder / "truth.h5", truth.with_points(truth.shapes * 0.1))
    *_, last = desk.run(plots="svg", groups={})
    mean = 1000 * float(desk.row(**SIZES, sequence="")["mean"])
    assert f"error aligned {mean:.1f} mean" in last.note
    page = desk.text("report.html")
    assert f"<td>{mean:.1f} / " in page
    assert "error aligned (mm)" in page
    for name in ("errors", "sequences", "landmarks", "examples"):
        text = desk.text(f"{name}.svg")
        assert "mm" in text
        assert "(m)" not in text


def test_errors_of_landmarks_are_those_after_the_best_similarity(desk, truth, results):
    desk.run()
    rows = desk.rows("per_landmark.csv", unit="m")
    means = [float(row["mean"]) for row in rows]
    medians = [float(row["median"]) for row in rows]
    onto = similarity_transform(results.as_columns(), truth.as_columns())
    differences = onto.apply(results.as_columns()) - truth.as_columns()
    expected = np.linalg.norm(differences, axis=1)
    assert [row["landmark"] for row in rows] == [*truth.landmark_names]
    assert_allclose(means, expected.mean(axis=0))
    assert_allclose(medians, np.median(expected, axis=0))
    assert {row["images"] for row in rows} == {str(N)}


@pytest.fixture
def renamed(desk, with_bars, truth):
    """Evaluate by nasty names of everything; return the page."""
    names = (NASTY, "_left", "right", "foot", "hand")
    sequences = tuple(f"_{NASTY}{name}" for name in with_bars.sequences)
    items = tuple(f"{NASTY}{n}" for n in range(N))
    fields = {"landmark_names": names, "items": items, "sequences": sequences}
    result = desk.write("convex.h5", with_bars.replaced(**fields))
    write_shapes(desk.folder / "truth.h5", truth.replaced(**fields))
    files = {f"_{NASTY}": result, "_b": result}
    desk.run(plots="svg", groups={f"_{NASTY}": "*"}, results=files)
    return desk.text("report.html")


def test_names_are_escaped_in_the_page(renamed):
    assert "<script" not in renamed
    assert "&lt;script&gt;" in renamed
    assert "\x1b" not in renamed


@pytest.mark.parametrize("name", sorted(FIGURES | {"bars"}))
def test_names_are_escaped_in_figures(desk, renamed, name):
    text = desk.text(f"{name}.svg")
    ElementTree.fromstring(text)
    assert "<script" not in text
    assert "\x1b" not in text


def test_a_name_that_begins_with_a_dash_below_is_in_the_legends(desk, renamed):
    assert "> _b</text>" in desk.text("sequences.svg")


@pytest.fixture
def examples(desk, monkeypatch):
    """The rows of examples that are drawn."""
    drawn = []

    def draw(rows, edges):
        drawn.append(rows)
        return Figure()

    monkeypatch.setattr(figures, "draw_examples", draw)
    desk.run(plots="svg", groups={})
    (rows,) = drawn
    return rows


def item_of(example):
    """Return the item in the title `method: item, error`."""
    _, rest = example.title.split(": ")
    return rest.split(",")[0]


def test_joint_angles_of_people_are_compared_in_degrees(desk, truth, rng):
    """A knee that is straight in the estimate and bent by 30 degrees in the truth."""
    names = ("rhip", "rknee", "rankle", "pelvis", "neck")
    points = rng.standard_normal((N, 5, 3))
    bend = np.deg2rad(30)
    points[:, :3] = [[0, 2, 0], [0, 1, 0], [0, 0, 0]]
    estimate = points.copy()
    points[:, 2] = [0, 1 - np.cos(bend), np.sin(bend)]
    true = truth.replaced(shapes=points, landmark_names=names)
    write_shapes(desk.folder / "truth.h5", true)
    fit = Fit(estimate, landmark_names=names, items=true.items, unit="m")
    desk.write("convex.h5", fit)
    *_, last = desk.run(metrics=["similarity"], groups={})
    (row,) = desk.rows("per_angle.csv")
    assert row["angle"] == "knee_angle_r"
    assert row["unit"] == "deg"
    assert row["images"] == "7"
    assert float(row["mean"]) == pytest.approx(30)
    assert "joint angles 30.0 mean (deg); knee_angle_r 30.0" in last.note
    assert "knee_angle_r</td><td>30.0 / 30.0</td>" in desk.text("report.html")


NASTY = '<script>alert("x")</script>&$\\frac{$_\x1b[31m'
"""A name that is a script, an entity, mathematics that fails, and a colour."""


def test_the_examples_are_the_best_and_the_worst(desk, examples):
    errors = desk.errors(**SIZES)
    order = sorted(errors, key=errors.__getitem__)
    first_of_rows = [item_of(row[0]) for row in examples]
    assert first_of_rows == [order[0], order[N // 2], order[-1]]


def test_in_examples_the_truth_lies_over_the_estimate(desk, examples):
    """As their distances say."""
    errors = desk.errors(**SIZES)
    for row in examples:
        for example in row:
            distances = np.linalg.norm(example.truth - example.estimate, axis=0)
            assert distances.mean() == pytest.approx(errors[item_of(example)])


def test_a_landmark_of_the_truth_may_be_unknown(desk, truth, results):
    truth.shapes[0, 2] = np.nan
    write_shapes(desk.folder / "truth.h5", truth)
    desk.run()
    known = [0, 1, 3, 4]
    (expected,) = metrics.similarity_error(
        results.as_columns()[:1, :, known], truth.as_columns()[:1, :, known]
    )
    assert desk.errors(**SIZES)["item0"] == pytest.approx(expected)


@pytest.fixture
def evaluated_by_people(world, tmp_path):
    """Evaluate a fit by the dictionary of people against this truth; return the
    warnings and the page.
    """

    def evaluate_fit(truth):
        views = world.views("people", shapes=[str(truth)])
        config = EvalConfig(
            results=[world.fit("people", images=views)],
            truth=[truth],
            output=tmp_path / "report",
            plots="none",
        )
        warnings = texts(evaluate.evaluate_results(config))
        page = (tmp_path / "report/report.html").read_text(encoding="utf-8")
        return warnings, page

    return evaluate_fit


def test_truth_that_the_dictionary_was_learned_from_is_a_warning(
    world, evaluated_by_people
):
    truth = world.shapes("people")
    warnings, page = evaluated_by_people(truth)
    (warning,) = [text for text in warnings if "learned from the truth" in text]
    assert f"the dictionary was learned from the truth, {truth}" in warning
    assert "learned from the truth" in page


def test_truth_that_is_new_to_the_dictionary_is_not_warned_of(
    world, evaluated_by_people
):
    warnings, page = evaluated_by_people(world.truth("people"))
    assert not any("learned from the truth" in text for text in warnings)
    assert "learned from the truth" not in page


def test_an_item_in_two_files_of_one_method_is_an_error(desk, results):
    optimal = results.replaced(status=np.array(["optimal"] * N))
    whole = desk.write("convex.h5", optimal)
    again = desk.write("again.h5", optimal.take([3]))
    with pytest.raises(InputError, match="none of its 8 images is in the truth"):
        desk.run(results={"convex": [whole, again]})


def test_nothing_to_measure_is_an_error_and_leaves_no_folder(desk, results):
    no_labels = {name: np.zeros((N, 5), bool) for name in ("outliers", "corrupted")}
    desk.write("convex.h5", put(results, no_labels))
    fault = "metrics: no image has anything to measure in recall"
    with pytest.raises(InputError, match=fault):
        desk.run(metrics=["recall"])
    assert not desk.config.output.exists()


def test_the_page_names_the_method_of_a_result(desk, results):
    named = results.replaced(attributes={**results.attributes, "method": "convex"})
    desk.write("convex.h5", named)
    desk.run(groups={})
    (method,) = json.loads(desk.text("report.json"))["methods"]
    assert method["method"] == "convex"
    assert "convex.h5, by `fit --method convex`" in desk.text("report.html")
