"""Error bars in a report: tables, files, what is left out, and images drawn from a prior."""

import json

import numpy as np
import pytest
from scipy.stats import chi2

from shapefit.evaluation.calibration import find_squares
from shapefit.geometry.rotations import rotation_about
from shapefit.io import write_shapes
from tests.pipelines.evaluate.conftest import N
from tests.pipelines.told import texts

OF_BARS = ("inside_50", "inside_90", "width")


@pytest.fixture
def sure(results, rng):
    """Results with error bars and plausibilities; item1 is the least plausible."""
    correlation = rng.uniform(-0.3, 0.3, (N, 5, 3))
    own = {"shape_correlation": correlation, "p_value": np.array([0.5, 0.1, *[0.9] * 5])}
    return results.replaced(
        shape_sd=rng.uniform(0.1, 0.3, (N, 3, 5)), further=results.further | own
    )


@pytest.fixture
def reported(desk, sure):
    """Run with the results `posterior.h5` beside those without error bars."""

    def run(records=sure, **changes):
        files = {"convex": desk.folder / "convex.h5", "posterior": desk.write("p.h5", records)}
        outcomes = desk.run(results=files, **changes)
        page = (desk.config.output / "report.md").read_text(encoding="utf-8")
        return page, texts(outcomes), outcomes[-1].note

    return run


def test_the_tables_hold_what_the_error_bars_are_worth(desk, reported, sure, truth):
    _, _, note = reported()
    R = sure.columns["true_rotation"]
    correlation = sure.columns["shape_correlation"].swapaxes(1, 2)
    square, width = find_squares(sure.shapes, truth.shapes, R, sure.shape_sd, correlation)
    level = chi2.cdf(square, 3)
    for metric, inside in (("inside_50", level <= 0.5), ("inside_90", level <= 0.9)):
        row = desk.row(metric=metric, group="Subject 13")
        assert float(row["mean"]) == pytest.approx(inside[:5].mean())
        assert row["images"] == "25"
    row = desk.row(metric="width", group="Subject 13", unit="m")
    assert float(row["median"]) == pytest.approx(np.median(width[:5]), rel=1 / 8192)
    shares = desk.errors(method="posterior", metric="inside_90")
    assert shares == pytest.approx((level <= 0.9).mean(axis=1))
    assert not len(desk.errors(method="convex", metric="inside_90"))
    document = json.loads((desk.config.output / "report.json").read_text(encoding="utf-8"))
    assert document["calibration"][0]["judged"] == 25
    held = 100 * (level[:5] <= 0.9).mean()
    assert any(f"90% bars hold {held:.0f}%" in line for line in note.splitlines())


def test_without_a_rotation_there_is_no_calibration(desk, reported, sure):
    own = {k: v for k, v in sure.columns.items() if k != "true_rotation"}
    page, warnings, _ = reported(sure.replaced(further=own), metrics=["similarity"])
    assert any("without the dataset `true_rotation` or a `truth_frame`" in w for w in warnings)
    assert "Error bars" not in page


def test_a_truth_in_the_frame_of_the_camera_needs_no_rotation(desk, reported, sure, truth):
    reported()
    before = desk.row(metric="inside_90", group="Subject 13")
    camera = desk.errors(method="posterior", metric="camera", unit="m")
    turned = truth.replaced(shapes=sure.columns["true_rotation"] @ truth.shapes)
    write_shapes(desk.folder / "truth.h5", turned)
    own = {k: v for k, v in sure.columns.items() if k != "true_rotation"}
    reported(sure.replaced(further=own), truth_frame="camera", metrics=["camera"])
    same = desk.errors(method="posterior", metric="camera", unit="m")
    assert same == pytest.approx(camera)
    assert desk.row(metric="inside_90", group="Subject 13") == before


def test_the_line_of_sight_meets_each_shape(desk, reported, sure, truth):
    reported()
    before = desk.errors(method="posterior", metric="camera", unit="m")
    away = truth.shapes - truth.shapes.mean(axis=2, keepdims=True)
    away = sure.columns["true_rotation"] @ away
    tilt = rotation_about(np.array([0.6, -0.8, 0.0]), np.array(0.4))
    for depth in (5.0, -5.0):
        seen = tilt @ (away + np.array([[0.0], [0.0], [depth]]))
        write_shapes(desk.folder / "truth.h5", truth.replaced(shapes=seen))
        reported(truth_frame="line-of-sight", metrics=["camera"])
        assert desk.errors(method="posterior", metric="camera", unit="m") == pytest.approx(before)
    with_camera = sure.columns | {"focal": np.full((len(sure), 2), 1000.0)}
    reported(sure.replaced(further=with_camera), truth_frame="line-of-sight", metrics=["camera"])
    by_camera = desk.errors(method="posterior", metric="camera", unit="m")
    reported(sure, truth_frame="camera", metrics=["camera"])
    tilted = desk.errors(method="posterior", metric="camera", unit="m")
    assert by_camera == pytest.approx(tilted)
    assert (tilted > 1.1 * before).all()


def test_gaps_of_the_truth_are_left_out(desk, reported, truth):
    shapes = truth.shapes.copy()
    shapes[0, :, 1] = np.nan
    write_shapes(desk.folder / "truth.h5", truth.replaced(shapes=shapes))
    reported()
    assert desk.row(metric="inside_90", group="Subject 13")["images"] == "24"


def test_a_report_has_the_factors_with_which_error_bars_are_true(desk, reported, sure):
    reported()
    path = desk.config.output / "error_bars.json"
    (factors,) = json.loads(path.read_text(encoding="utf-8")).values()
    reported(sure.replaced(shape_sd=factors["90%"] * sure.shape_sd))
    row, other = (desk.row(metric="inside_90", group=f"Subject {n}") for n in (13, 14))
    inside = (25 * float(row["mean"]) + 10 * float(other["mean"])) / 35
    assert inside == pytest.approx(np.ceil(36 * 0.9) / 35)
