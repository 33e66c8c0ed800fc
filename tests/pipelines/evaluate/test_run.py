"""What an evaluation writes: tables, page, plot, warnings; and what stops it."""

import json
from itertools import pairwise

import numpy as np
import pytest

from shapefit.config import EvalConfig
from shapefit.errors import InputError
from shapefit.evaluation import metrics
from shapefit.io import write_shapes
from shapefit.pipelines.evaluate import run as evaluate
from shapefit.records.columns import in_columns
from tests.columns import put
from tests.pipelines.fitted import texts

from .conftest import N

FILES = {"per_image.csv", "report.csv", "report.json", "report.md"}
SIZES = {"metric": "similarity", "unit": "m"}


def test_the_report_has_errors_failures_and_where_they_come_from(desk, truth, results):
    shapes = results.shapes.copy()
    shapes[6] = np.nan
    desk.write("convex.h5", results.replaced(shapes=shapes, objective=np.arange(7.0)))
    outcome, last = desk.run()
    assert {path.name for path in last.written} == FILES
    assert {path.name for path in desk.config.output.iterdir()} == FILES
    assert [(f.item, f.reason[:8]) for f in outcome.failures] == [("item6", "convex: ")]
    assert (outcome.done, outcome.warnings, last.warnings) == (N, (), ())
    errors = metrics.similarity(in_columns(shapes), truth.as_columns())
    np.testing.assert_array_equal([*desk.errors(**SIZES).values()], errors)
    first, group = (
        desk.row(**SIZES, group="Subject 13", sequence=s) for s in ("13_01", "")
    )
    assert float(first["mean"]) == pytest.approx(errors[:4].mean())
    assert float(group["mean"]) == pytest.approx((errors[:4].mean() + errors[4]) / 2)
    assert (first["images"], group["images"]) == ("4", "5")
    line, _, failed = last.note.splitlines()
    mean = 1000 * float(group["mean"])
    assert line.startswith(f"convex  Subject 13  error aligned {mean:.1f} mean, ")
    assert failed == "convex  failed: 1 of 7"
    document = json.loads(desk.text("report.json"))
    assert last.data() == document
    (method,) = document["methods"]
    assert (method["images"], method["failed"], method["mean_objective"]) == (N, 1, 3)
    assert document["config"]["match"] == "item"
    files = {str(desk.config.truth[0]), str(*desk.config.results["convex"])}
    assert set(document["inputs"]) == files
    assert "- convex, item6: " in desk.text("report.md")


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


def test_one_plot_is_drawn(desk):
    *_, last = desk.run(plots=True, metrics=["reprojection", "similarity"])
    assert {path.name for path in last.written} == FILES | {"errors.svg"}
    assert "RMS reprojection error" in desk.text("errors.svg")
    assert "(errors.svg)" in desk.text("report.md")
    desk.run(plots=True, metrics=["similarity"])
    assert "(normalised)" in desk.text("errors.svg")


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
        plots=False,
    )
    warnings = [
        text
        for text in texts(evaluate.evaluate_results(config))
        if "learned from the truth" in text
    ]
    page = (tmp_path / "report/report.md").read_text(encoding="utf-8")
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
