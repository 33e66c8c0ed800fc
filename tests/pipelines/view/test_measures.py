"""Measures of a page: errors, trust, angles, and their units."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.evaluation import metrics
from shapefit.io import (
    read_results,
    read_shapes,
)
from shapefit.pipelines.view.layers import change_metres_to_cm_or_mm
from shapefit.records.columns import in_columns
from tests.columns import in_rows
from tests.pipelines.view.conftest import decoded, write_truth

STATUS = ["optimal", "converged", "iteration limit", "degenerate", "x", "optimal"]


REASONS = np.array(["", "", "", "wide error bars", "", "implausible landmarks"], object)


EXPECTED_ERRORS = np.array([1.0, 3, 5, 90, 7, 90])


OUTLIERS = np.eye(6, 5, dtype=bool)


@pytest.fixture
def judged(desk):
    """A result of six images with measures of all kinds, in px."""
    extras = {
        "landmarks": in_rows(desk.shapes(6))[..., :2],
        "p_value": np.linspace(0, 1, 6),
        "expected_error": EXPECTED_ERRORS,
        "outliers": OUTLIERS,
        "reasons": REASONS,
    }
    sd = np.full((6, 3, 5), 2.0)
    sd[1, :, 2] = np.nan
    return desk.result(extras=extras, status=np.array(STATUS), shape_sd=sd)


@pytest.fixture
def truth_in_mm(desk, judged):
    return desk.truth(unit="mm")


@pytest.fixture
def errors(judged, truth_in_mm):
    """Errors against the truth and expected errors, in mm."""
    shapes = read_results(judged).as_columns()
    truth = read_shapes([truth_in_mm]).as_columns()
    error = metrics.similarity_error(shapes, truth)
    expected = metrics.convert_expected_error(shapes, truth, EXPECTED_ERRORS)
    return error, expected


@pytest.fixture
def page(desk, judged, truth_in_mm):
    """The data of their page."""
    return desk.view(judged, truth=(truth_in_mm,)).data


def measures_of(page):
    """Return name -> measure of the first layer."""
    return {measure["name"]: measure for measure in page["layers"][0]["measures"]}


def test_measures_of_each_image_have_their_unit(page, judged, errors):
    """Expected errors are in px in the file: units never mix."""
    error, expected_error = errors
    result = read_results(judged)
    projected = result.as_columns()[:, :2]
    seen = in_columns(result.column("landmarks"))
    reprojection = metrics.reprojection(projected, seen)
    expected = {
        "error against the truth": ("mm", error),
        "expected error": ("mm", expected_error),
        "p-value": ("", np.linspace(0, 1, 6)),
        "reprojection": ("px", reprojection),
    }
    measures = measures_of(page)
    assert list(measures) == list(expected)
    for name, (unit, values) in expected.items():
        shown = decoded(measures[name]["values"])
        assert measures[name]["unit"] == unit
        assert_allclose(shown, values, rtol=0.004)


def test_what_is_not_optimal_is_named(page):
    status = page["layers"][0]["status"]
    shown = [status["words"][code] for code in decoded(status["codes"])]
    assert shown == ["", "", "iteration limit", "degenerate", "x", ""]


def test_outliers_are_marked(page):
    assert_array_equal(decoded(page["outliers"]), OUTLIERS)


def test_the_header_tells_trust_and_errors(page, errors):
    error, expected_error = errors
    typical = np.median(expected_error[REASONS == ""])
    assert [fact["text"] for fact in page["facts"]] == [
        "6 images",
        "4 of 6 trusted",
        f"error against the truth {np.median(error):.2g} mm",
        f"typical error {typical:.2g} mm",
    ]


UNITS_OF_A_PAGE = [
    ([0.06, 0.2], [6, 20], "cm"),
    ([0.002, 0.2], [2, 200], "mm"),
]
"""Two lengths in metres, as they are shown, and in which unit."""


@pytest.mark.parametrize(("lengths", "shown", "expected"), UNITS_OF_A_PAGE)
def test_lengths_of_a_page_have_one_unit(lengths, shown, expected):
    measures = []
    for length in lengths:
        values = np.full(3, length)
        measures.append({"name": "error", "values": values, "unit": "m"})
    layers = [{"measures": [measure]} for measure in measures]
    unit, factor = change_metres_to_cm_or_mm(layers)
    assert [measure["values"][0] for measure in measures] == pytest.approx(shown)
    assert [measure["unit"] for measure in measures] == [expected] * 2
    assert unit == expected
    assert factor == shown[0] / lengths[0]


def test_pixels_stay_pixels():
    length = {"name": "error", "values": np.full(3, 0.06), "unit": "m"}
    pixels = {"name": "p", "values": np.ones(3), "unit": "px"}
    change_metres_to_cm_or_mm([{"measures": [length, pixels]}])
    assert pixels["unit"] == "px"
    assert_array_equal(pixels["values"], 1)


@pytest.fixture
def sized(desk):
    """A result whose unit is two metres, with an expected error of one unit."""
    extras = {"metres_per_unit": np.full(6, 2.0), "expected_error": np.ones(6)}
    return desk.result(extras=extras)


def test_errors_are_in_metres(desk, sized):
    page = desk.scene(sized, truth=(desk.truth(unit="m"),))
    error, expected, *_ = page["layers"][0]["measures"]
    assert error["unit"] == "cm"
    assert expected["unit"] == "cm"
    assert_allclose(expected["values"], 200)


def test_errors_are_else_in_the_unit_of_the_truth(desk, sized):
    page = desk.scene(sized, truth=(desk.truth(unit="unknown"),))
    error, expected, *_ = page["layers"][0]["measures"]
    assert error["unit"] == ""
    assert expected["unit"] == ""


def test_what_was_seen_of_joints_is_seen_of_the_landmarks_that_stand_for_them(desk):
    """Where the landmarks of the detector are shown, for the truth has their names."""
    detected = ("RKnee", "Nose", "LHip", "RHip")
    seen = in_rows(desk.shapes(6))[..., :2]
    columns = {
        "landmarks": seen,
        "input_shapes": in_rows(desk.shapes(6, 4)),
        "input_landmark_names": np.array(detected, dtype=object),
    }
    joints = ("pelvis", "rhip", "rknee", "lhip", "lknee")
    result = desk.result(landmark_names=joints, extras=columns)
    truth = desk.folder / "of_names.h5"
    write_truth(truth, desk.shapes(6, 4), landmark_names=detected)
    page = desk.scene(result, truth=(truth,))
    rows = [joints.index(joint) for joint in ("rknee", "pelvis", "lhip", "rhip")]
    expected = in_columns(seen)[:, :, rows]
    expected[:, :, detected.index("Nose")] = np.nan
    assert page["landmarks"] == detected
    assert_allclose(page["observed"], expected)


def test_joint_angles_have_bands_from_the_error_bars(desk):
    names = ("rhip", "rknee", "rankle", "neck", "head")
    bent = np.array([[0.0, 0, 0], [0, 10, 0], [10, 10, 0], [0, -10, 0], [0, -12, 0]]).T
    shapes = np.tile(bent, (6, 1, 1))
    sd = np.full((6, 3, 5), 0.1)
    result = desk.result(shapes=shapes, shape_sd=sd, landmark_names=names)
    knee = measures_of(desk.view(result).data)["knee angle r"]
    expected_sd = np.degrees(0.01 * 2)
    assert knee["unit"] == "°"
    assert_allclose(decoded(knee["values"]), 90, atol=1e-4)
    assert_allclose(decoded(knee["sd"]), expected_sd, rtol=0.01)
