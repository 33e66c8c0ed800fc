"""What an evaluation writes: tables, page, figures, warnings; and what stops it."""

import json
from itertools import pairwise
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.figure import Figure

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


def test_the_report_has_errors_failures_and_where_they_come_from(desk, truth, results):
    shapes = results.shapes.copy()
    shapes[6] = np.nan
    desk.write("convex.h5", results.replaced(shapes=shapes, objective=np.arange(7.0)))
    counted, outcome, last = desk.run()
    assert counted.total == outcome.done
    assert {path.name for path in last.written} == FILES
    assert {path.name for path in desk.config.output.iterdir()} == FILES
    assert [(f.item, f.reason[:8]) for f in outcome.failures] == [("item6", "convex: ")]
    assert outcome.done == N
    assert outcome.warnings == ()
    assert last.warnings == ()
    errors = metrics.similarity(in_columns(shapes), truth.as_columns())
    np.testing.assert_array_equal([*desk.errors(**SIZES).values()], errors)
    first, group = (
        desk.row(**SIZES, group="Subject 13", sequence=s) for s in ("13_01", "")
    )
    assert float(first["mean"]) == pytest.approx(errors[:4].mean())
    assert float(group["mean"]) == pytest.approx((errors[:4].mean() + errors[4]) / 2)
    assert first["images"] == "4"
    assert group["images"] == "5"
    line, _, failed = last.note.splitlines()
    mean = 1000 * float(group["mean"])
    assert line.startswith(f"convex  Subject 13  error aligned {mean:.1f} mean, ")
    assert failed == "convex  failed: 1 of 7"
    document = json.loads(desk.text("report.json"))
    assert last.data() == document
    (method,) = document["methods"]
    assert method["images"] == N
    assert method["failed"] == 1
    assert method["mean_objective"] == 3
    assert document["config"]["match"] == "item"
    files = {str(desk.config.truth[0]), str(*desk.config.results["convex"])}
    assert set(document["inputs"]) == files
    assert "<li>convex, item6: " in desk.text("report.html")


def test_groups_that_match_nothing_are_refused(desk):
    with pytest.raises(
        InputError, match=r"groups: no sequence matches.*13_01, 13_02, 14_01"
    ):
        desk.run(groups={"Subject 15": "15_*"})


def test_error_bars_have_their_tables_and_the_factors_that_make_them_true(
    desk, with_bars
):
    files = {
        "convex": desk.folder / "convex.h5",
        "posterior": desk.write("p.h5", with_bars),
    }
    *_, last = desk.run(results=files)
    shares = desk.errors(method="posterior", metric="inside_90")
    stated = last.numbers.share_inside_regions
    assert stated["convex"] is None
    assert stated["posterior"] == pytest.approx(np.mean([*shares.values()]))
    row = desk.row(metric="inside_90", group="Subject 13")
    assert float(row["mean"]) == pytest.approx(np.mean([*shares.values()][:5]))
    assert row["images"] == "25"
    assert not desk.errors(method="convex", metric="inside_90")
    document = json.loads(desk.text("report.json"))
    assert document["calibration"][0]["counted"] == 25
    assert f"90% bars hold {100 * float(row['mean']):.0f}%" in last.note
    (factors,) = json.loads(desk.text("error_bars.json")).values()
    desk.write("p.h5", with_bars.replaced(shape_sd=factors["90%"] * with_bars.shape_sd))
    desk.run(results=files)
    inside = [
        float(desk.row(metric="inside_90", group=f"Subject {n}")["mean"])
        for n in (13, 14)
    ]
    assert (25 * inside[0] + 10 * inside[1]) / 35 == pytest.approx(
        np.ceil(36 * 0.9) / 35
    )


def test_parts_and_many_files_of_the_truth_have_the_report_of_one_file(
    desk, with_bars, truth, rng
):
    """To the last bit, with failed images, labels of outliers and a truth in any
    order.
    """
    shapes = with_bars.shapes.copy()
    shapes[[0, 5]] = np.nan
    labels = {name: rng.random((N, 5)) < 0.4 for name in ("outliers", "corrupted")}
    results = put(with_bars.with_points(shapes), labels)
    wanted = {"metrics": ("similarity", "camera", "precision", "recall")}

    def written(parts):
        methods = {"m": parts, "other": [desk.folder / "convex.h5"]}
        desk.run(**wanted, results=methods, truth=sorted(desk.folder.glob("truth*.h5")))
        tables = [desk.text(name) for name in ("report.csv", "error_bars.json")]
        failures = json.loads(desk.text("report.json"))["methods"][0]["failures"]
        return *tables, sorted(desk.text("per_image.csv").splitlines()), failures

    whole = written([desk.write("whole.h5", results)])
    for ends in ([0, 2, 4, 7], [0, 1, 7]):
        parts = [
            desk.write(f"part{a}.h5", results.take(slice(a, b)))
            for a, b in pairwise(ends)
        ]
        assert written(parts) == whole
    (desk.folder / "truth.h5").unlink()
    order = rng.permutation(N)
    for n in range(3):
        write_shapes(desk.folder / f"truth{n}.h5", truth.take(order[n::3]))
    assert written(parts) == whole


@pytest.mark.parametrize("plots", ["svg", "png", "pdf"])
def test_figures_lie_beside_the_page_which_has_them_too(desk, with_bars, plots):
    desk.write("convex.h5", with_bars)
    *_, last = desk.run(plots=plots)
    drawn = {f"{name}.{plots}" for name in FIGURES | {"bars"}}
    assert {path.name for path in last.written} == FILES | drawn | {"error_bars.json"}
    assert last.written[0].name == "report.html"
    starts = {"svg": b"<?xml", "png": b"\x89PNG", "pdf": b"%PDF"}
    for name in drawn:
        data = (desk.config.output / name).read_bytes()
        assert data.startswith(starts[plots])
    page = desk.text("report.html")
    assert page.count("<figure>") == 5
    assert "<script" not in page
    before = {name: (desk.config.output / name).read_bytes() for name in drawn}
    desk.run(plots=plots)
    assert page == desk.text("report.html")
    for name, data in before.items():
        assert (desk.config.output / name).read_bytes() == data


def test_figures_need_no_alignment_and_no_sequences(desk, truth, results):
    desk.write("convex.h5", results.replaced(sequences=None))
    write_shapes(desk.folder / "truth.h5", truth.replaced(sequences=None))
    keys = {"plots": "svg", "groups": {}}
    *_, last = desk.run(metrics=["reprojection"], **keys)
    assert {path.name for path in last.written} == FILES | {"errors.svg"}
    *_, last = desk.run(metrics=["similarity"], **keys)
    drawn = {f"{name}.svg" for name in FIGURES - {"sequences"}}
    assert {path.name for path in last.written} == FILES | drawn


def test_without_matplotlib_there_are_tables_and_a_note(desk, monkeypatch):
    monkeypatch.setattr(evaluate, "find_spec", lambda _: None)
    *_, last = desk.run(plots="svg")
    assert {path.name for path in last.written} == FILES
    (note,) = last.warnings
    assert "pip install matplotlib" in note
    assert "pip install matplotlib" in desk.text("report.html")
    *_, last = desk.run(plots="none")
    assert last.warnings == ()


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
    assert [row["landmark"] for row in rows] == [*truth.landmark_names]
    onto = similarity_transform(results.as_columns(), truth.as_columns())
    apart = onto.apply(results.as_columns()) - truth.as_columns()
    expected = np.linalg.norm(apart, axis=1)
    means = [float(row["mean"]) for row in rows]
    np.testing.assert_allclose(means, expected.mean(axis=0))
    medians = [float(row["median"]) for row in rows]
    np.testing.assert_allclose(medians, np.median(expected, axis=0))
    assert {row["images"] for row in rows} == {str(N)}


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


def test_names_are_escaped_in_page_and_figures(desk, with_bars, truth):
    names = (NASTY, "_left", "right", "foot", "hand")
    sequences = tuple(f"_{NASTY}{name}" for name in with_bars.sequences)
    items = tuple(f"{NASTY}{n}" for n in range(N))
    renamed = {"landmark_names": names, "items": items, "sequences": sequences}
    desk.write("convex.h5", with_bars.replaced(**renamed))
    write_shapes(desk.folder / "truth.h5", truth.replaced(**renamed))
    files = {f"_{NASTY}": desk.folder / "convex.h5", "_b": desk.folder / "convex.h5"}
    desk.run(plots="svg", groups={f"_{NASTY}": "*"}, results=files)
    page = desk.text("report.html")
    assert "<script" not in page
    assert "&lt;script&gt;" in page
    for name in FIGURES | {"bars"}:
        text = desk.text(f"{name}.svg")
        ElementTree.fromstring(text)
        assert "<script" not in text
        assert "\x1b" not in text + page
    # a name that begins with _ is in the legends all the same
    assert "> _b</text>" in desk.text("sequences.svg")


def test_the_examples_are_the_best_and_the_worst(desk, truth, results, monkeypatch):
    drawn = []
    monkeypatch.setattr(
        figures, "draw_examples", lambda rows, edges: drawn.append(rows) or Figure()
    )
    desk.run(plots="svg", groups={})
    errors = desk.errors(**SIZES)
    order = sorted(errors, key=errors.__getitem__)
    (rows,) = drawn
    first = [row[0].title.split(": ")[1].split(",")[0] for row in rows]
    assert first == [order[0], order[N // 2], order[-1]]
    for row in rows:
        for one in row:
            # the truth lies over the estimate as their distances say
            error = np.linalg.norm(one.truth - one.estimate, axis=0).mean()
            item = one.title.split(": ")[1].split(",")[0]
            assert error == pytest.approx(errors[item])


def test_a_landmark_of_the_truth_may_be_unknown(desk, truth, results):
    truth.shapes[0, 2] = np.nan
    write_shapes(desk.folder / "truth.h5", truth)
    desk.run()
    others = [0, 1, 3, 4]
    expected = metrics.similarity(
        results.as_columns()[:1, :, others], truth.as_columns()[:1, :, others]
    )
    assert desk.errors(**SIZES)["item0"] == pytest.approx(expected[0])


@pytest.mark.parametrize("kind", ["seen", "unseen"])
def test_truth_that_the_dictionary_was_learned_from_is_a_warning(world, tmp_path, kind):
    truth = world.shapes("people") if kind == "seen" else world.truth("people")
    config = EvalConfig(
        results=[
            world.fit("people", images=world.views("people", shapes=[str(truth)]))
        ],
        truth=[truth],
        output=tmp_path / "report",
        plots="none",
    )
    warnings = [
        text
        for text in texts(evaluate.evaluate_results(config))
        if "learned from the truth" in text
    ]
    page = (tmp_path / "report/report.html").read_text(encoding="utf-8")
    assert [
        f"the dictionary was learned from the truth, {truth}" in w for w in warnings
    ] == ([True] if kind == "seen" else [])
    assert ("learned from the truth" in page) == (kind == "seen")


def test_an_item_in_two_files_of_one_method_is_an_error(desk, results):
    results = results.replaced(status=np.array(["optimal"] * N))
    for name, rows in (("convex.h5", slice(None)), ("again.h5", [3])):
        desk.write(name, results.take(rows))
    files = {"convex": [desk.folder / "convex.h5", desk.folder / "again.h5"]}
    with pytest.raises(InputError, match="none of its 8 images is in the truth"):
        desk.run(results=files)


def test_nothing_to_measure_is_an_error_and_leaves_no_folder(desk, results):
    none = {name: np.zeros((N, 5), bool) for name in ("outliers", "corrupted")}
    desk.write("convex.h5", put(results, none))
    with pytest.raises(
        InputError, match="metrics: no image has anything to measure in recall"
    ):
        desk.run(metrics=["recall"])
    assert not desk.config.output.exists()


def test_the_page_names_the_method_of_a_result(desk, results):
    named = results.replaced(attributes={**results.attributes, "method": "convex"})
    desk.write("convex.h5", named)
    desk.run(groups={})
    (method,) = json.loads(desk.text("report.json"))["methods"]
    assert method["method"] == "convex"
    assert "convex.h5, by `fit --method convex`" in desk.text("report.html")
