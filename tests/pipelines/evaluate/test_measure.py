"""Which truth belongs to which image, what can be measured, and what fails and why."""

from pathlib import Path

import numpy as np
import pytest

from shapefit.config import EvalConfig
from shapefit.errors import InputError
from shapefit.evaluation import metrics
from shapefit.evaluation.calibration import find_squares
from shapefit.geometry.rotations import rotation_about
from shapefit.pipelines.evaluate.measure import measure
from shapefit.records import Fit, Shapes
from shapefit.records.columns import in_columns
from tests.columns import in_rows, put

from .conftest import ITEMS, NAMES, N

FILE = Path("/results/convex.h5")
METRICS = ("similarity", "camera", "rotation", "reprojection")
SHAPES = ["similarity"]


def measured(results, truth, match="item", metrics=METRICS, **keys):
    config = EvalConfig.model_construct(match=match, metrics=metrics, **keys)
    return measure(FILE, results, truth, config)


def changed(results, name, row, value):
    """Return the results with one row of a column changed."""
    values = results.column(name).copy()
    values[row] = value
    return with_column(results, name, values)


def with_column(results, name, values):
    if values is None:
        return results.without([name])
    return put(results, {name: values})


@pytest.fixture
def errors(results, truth):
    """Metric -> the errors of the images, in the unit of the truth or of the images."""
    shapes = results.as_columns()
    true = truth.as_columns()
    observed = in_columns(results.column("landmarks"))
    fitted = in_columns(results.landmarks_fitted)
    return {
        "similarity": metrics.similarity(shapes, true),
        "camera": metrics.camera(shapes, true, results.column("true_rotation")),
        "reprojection": metrics.reprojection(fitted, observed),
    }


def assert_same_errors(found, expected):
    assert found.errors.keys() == expected.keys()
    for kind, values in expected.items():
        np.testing.assert_allclose(found.errors[kind], values)


def test_every_metric_in_its_units(results, truth, errors):
    turn = rotation_about(np.array([0.0, 1, 0]), np.full(N, np.pi / 6))
    turned = results.replaced(rotation=turn @ results.rotation)
    found = measured(turned, truth)
    size = truth.as_columns().std(axis=-1).mean(axis=-1)
    box = np.linalg.norm(np.ptp(results.column("landmarks"), axis=1), axis=1)
    expected = {
        ("similarity", "normalised"): errors["similarity"] / size,
        ("similarity", "m"): errors["similarity"],
        ("camera", "normalised"): errors["camera"] / size,
        ("camera", "m"): errors["camera"],
        ("rotation", "deg"): np.full(N, 30.0),
        ("reprojection", "px"): errors["reprojection"],
        ("reprojection", "box"): errors["reprojection"] / box,
    }
    assert_same_errors(found, expected)
    assert found.failures == {}
    assert found.warnings == ()
    assert found.bars is None


def test_a_bounding_box_is_the_size_of_an_image(results, truth, errors):
    boxes = np.tile(np.uint8([9, 9, 1, 2]), (N, 1))
    boxed = with_column(results, "bounding_box", boxes)
    found = measured(boxed, truth, metrics=["reprojection"])
    expected = errors["reprojection"] / np.sqrt(5)
    np.testing.assert_allclose(found.errors["reprojection", "box"], expected)


def test_a_truth_without_a_unit_has_no_errors_in_one(results, truth):
    plain = truth.replaced(unit="normalised")
    found = measured(results, plain, metrics=SHAPES)
    assert set(found.errors) == {("similarity", "normalised")}


SHARED = [4, 2, 0, 1]
"""Landmarks of the results that the next truth has, in its order."""


@pytest.fixture
def tailed_truth(truth):
    """The truth in another order, which lacks the foot and has a tail instead."""
    tail = np.full((N, 1, 3), 1e6)
    shapes = np.concatenate([tail, truth.shapes[:, SHARED]], axis=1)
    names = ("tail", *(NAMES[i] for i in SHARED))
    record = Shapes(shapes, landmark_names=names, items=ITEMS, unit="m")
    return record.take([3, 1, 5, 0, 4, 2, 6])


def test_items_and_landmarks_are_matched_by_name(results, truth, tailed_truth):
    found = measured(results, tailed_truth)
    expected = metrics.similarity(
        results.as_columns()[:, :, SHARED], truth.as_columns()[:, :, SHARED]
    )
    np.testing.assert_allclose(found.errors["similarity", "m"], expected)
    assert found.warnings == (
        f"{FILE}: landmarks in the results alone are left out: foot",
        f"{FILE}: landmarks in the truth alone are left out: tail",
    )


def test_the_reprojection_error_keeps_all_landmarks(results, errors, tailed_truth):
    """It needs no truth."""
    found = measured(results, tailed_truth).errors["reprojection", "px"]
    np.testing.assert_array_equal(found, errors["reprojection"])


def test_another_dataset_can_name_the_truth(results, truth):
    models = np.array([f"item{i}" for i in (0, 0, 2, 2, 0, 2, 9)], dtype=object)
    shapes = truth.shapes[[0, 0, 2, 2, 0, 2, 0]]
    named = with_column(results, "true_model", models).replaced(shapes=shapes)
    found = measured(named, truth.take([2, 0]), "true_model", SHAPES)
    of_known_models = found.errors["similarity", "m"][:6]
    np.testing.assert_allclose(of_known_models, 0, atol=1e-12)
    assert found.items == ITEMS
    assert found.failures == {"item6": "it has no true shape"}


FAILURES = {
    "shape": (
        {"shapes": np.nan},
        "the results hold no shape (status degenerate input)",
    ),
    "landmarks": (
        {"shapes": [[1], [2], *[[np.nan]] * 3]},
        "2 landmarks are on both sides",
    ),
    "nan box": (
        {"bounding_box": [0, 0, np.nan, 4]},
        "5 landmarks are on both sides, and no reprojection (box)",
    ),
    "overflow": (
        {"landmarks_fitted": 1e300},
        "5 landmarks are on both sides, and no reprojection (px), reproject",
    ),
    "empty": (
        {"shapes": 9.0, "rotation": np.nan},
        "5 landmarks are on both sides, and no rotation (deg)",
    ),
}
"""Columns of one image, and why it fails."""


@pytest.fixture
def measured_failure(results, truth):
    """What is measured where one image has these values of columns."""

    def find(changes):
        boxes = np.tile([0.0, 0, 3, 4], (N, 1))
        status = np.array(["optimal"] * 3 + ["degenerate input"] * 4)
        record = with_column(results, "bounding_box", boxes).replaced(status=status)
        for name, value in changes.items():
            record = changed(record, name, 3, value)
        return measured(record, truth)

    return find


@pytest.mark.parametrize(("changes", "reason"), FAILURES.values(), ids=FAILURES)
def test_an_image_that_fails_is_listed_with_the_reason(
    measured_failure, changes, reason
):
    found = measured_failure(changes)
    assert list(found.failures) == ["item3"]
    assert found.failures["item3"].startswith(reason)
    for values in found.errors.values():
        without_error = np.flatnonzero(np.isnan(values))
        assert set(without_error) <= {3}


def test_a_shape_without_extent_has_errors_but_for_its_rotation(measured_failure):
    """What is left of it is the extent of the truth."""
    changes, _ = FAILURES["empty"]
    found = measured_failure(changes)
    for (metric, _), values in found.errors.items():
        assert np.isnan(values[3]) == (metric == "rotation")


def test_without_truth_an_image_fails_in_every_metric(results, truth):
    found = measured(results, truth.take([0, 1, 2, 3, 5, 6]))
    assert found.failures == {"item4": "it has no true shape"}
    for values in found.errors.values():
        assert np.flatnonzero(np.isnan(values)).tolist() == [4]


def test_a_partial_shape_is_measured_where_it_is_known(results, truth):
    shapes = results.shapes.copy()
    shapes[1, 0] = np.nan
    found = measured(results.replaced(shapes=shapes), truth, metrics=SHAPES)
    known = results.as_columns()[1:2, :, 1:]
    (expected,) = metrics.similarity(known, truth.as_columns()[1:2, :, 1:])
    np.testing.assert_allclose(found.errors["similarity", "m"][1], expected)


NEEDED = [
    ("true_rotation", {"camera", "rotation"}),
    ("landmarks", {"reprojection"}),
    ("landmarks_fitted", {"reprojection"}),
    ("rotation", {"rotation"}),
]
"""A dataset, and the metrics that need it."""


@pytest.mark.parametrize(("absent", "skipped"), NEEDED)
def test_metrics_without_their_datasets_are_named(results, truth, absent, skipped):
    found = measured(with_column(results, absent, None), truth)
    left = {metric for metric, _ in found.errors}
    names = " and ".join(metric for metric in METRICS if metric in skipped)
    assert left == set(METRICS) - skipped
    assert found.warnings == (f"{FILE}: no {names} without `{absent}`",)


@pytest.mark.parametrize(("absent", "skipped"), NEEDED)
def test_a_metric_alone_without_its_dataset_is_refused(results, truth, absent, skipped):
    metric = min(skipped)
    fault = f"no {metric} without `{absent}`; add the metric"
    with pytest.raises(InputError, match=fault):
        measured(with_column(results, absent, None), truth, metrics=[metric])


def test_sequences_are_those_of_the_results(results, truth):
    assert measured(results, truth).sequences == truth.sequences


def test_sequences_are_else_those_of_the_truth(results, truth):
    plain = results.replaced(sequences=None)
    found = measured(plain, truth.take([0, 1, 2, 3, 4, 5]))
    assert found.sequences == (*truth.sequences[:6], "")


def test_without_sequences_all_images_are_one(results, truth):
    plain = results.replaced(sequences=None)
    found = measured(plain, truth.replaced(sequences=None))
    assert found.sequences == ("all",) * N


def test_results_of_other_landmarks_are_refused(results, truth):
    names = ("head", "left", "x", "y", "z")
    with pytest.raises(InputError, match=r"has 2 of its landmarks.*at least 3"):
        measured(results.replaced(landmark_names=names), truth)


@pytest.mark.parametrize("name", ["true_rotation", "bounding_box"])
def test_datasets_of_another_shape_are_refused(results, truth, name):
    boxed = with_column(results, "bounding_box", np.ones((N, 4)))
    wrong = with_column(boxed, name, boxed.column(name)[:, :2])
    with pytest.raises(InputError, match=f"convex.h5:/{name}: has the shape"):
        measured(wrong, truth)


def test_no_shapes_are_refused(results, truth):
    with pytest.raises(InputError, match="holds no shapes"):
        measured(results.take([]), truth)
    with pytest.raises(InputError, match="truth: holds no shapes; give results"):
        measured(results, truth.take([]))


def test_a_truth_of_other_items_is_refused(results, truth):
    optimal = results.replaced(status=np.array(["optimal"] * N))
    others = truth.replaced(items=tuple("abcdefg"))
    fault = r"none of its 7 images is in the truth.*set `match`"
    with pytest.raises(InputError, match=fault):
        measured(optimal, others)


def walk_of(shapes, **sequences):
    """Fields of frames of shapes (n, p, 3) in sequences (name -> its number of
    frames).
    """
    names = []
    frames = []
    for name, count in sequences.items():
        names += [name] * count
        frames += range(count)
    items = tuple(f"{name}/{i}" for name, i in zip(names, frames, strict=True))
    return {
        "landmark_names": NAMES,
        "items": items,
        "sequences": tuple(names),
        "unit": "m",
        "frames": np.array(frames),
        "shapes": shapes,
    }


@pytest.fixture
def people(truth, rng):
    """Who -> shapes: a man who is near the truth, and a bystander."""
    man = truth.shapes + 0.02 * rng.standard_normal(truth.shapes.shape)
    bystander = rng.standard_normal(truth.shapes.shape)
    return {"man": man, "bystander": bystander}


ORDERS = [("man", "bystander"), ("bystander", "man")]


def result_of(people, order):
    shapes = np.concatenate([people[name] for name in order])
    return Fit(**walk_of(shapes, **dict.fromkeys(order, N)))


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("match", ["frame", "item"])
def test_one_individual_is_measured_against_one_truth(truth, people, order, match):
    """By frame two people match one truth; the one whose shapes are farther from it is
    left out.
    """
    subject = Shapes(**walk_of(truth.shapes, subject=N))
    found = measured(result_of(people, order), subject, match, SHAPES)
    expected = metrics.similarity(in_columns(people["man"]), truth.as_columns())
    warning = "bystander left out: another individual fits the same true shapes better"
    assert set(found.sequences) == {"man"}
    assert found.failures == {}
    np.testing.assert_allclose(found.errors["similarity", "m"], expected)
    assert warning in found.warnings[0]


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("match", ["frame", "item"])
def test_two_people_of_the_truth_by_the_same_names_are_both_measured(
    truth, people, order, match
):
    twice = np.concatenate([truth.shapes] * 2)
    both = Shapes(**walk_of(twice, **dict.fromkeys(order, N)))
    found = measured(result_of(people, order), both, match, SHAPES)
    assert len(found.items) == 2 * N


def warnings_of_shapes(results, truth):
    return measured(results, truth, metrics=SHAPES).warnings


def test_a_mirrored_truth_is_named(results, truth):
    mirrored = truth.replaced(shapes=truth.shapes * [-1.0, 1.0, 1.0])
    mirrored.shapes[0, 2:] = np.nan
    (warning,) = warnings_of_shapes(results, mirrored)
    assert "fit the truth better when it is mirrored" in warning
    assert "left-handed" in warning


TWO_PARTNERS = [0, 2, 1, 3, 4]


FOUR_PARTNERS = [0, 2, 1, 4, 3]


SIDED = [
    (("head", "left", "right", "foot", "hand"), TWO_PARTNERS),
    (("head", "l_eye", "r_eye", "foot", "hand"), TWO_PARTNERS),
    (("head", "LEar", "REar", "lfoot", "rfoot"), FOUR_PARTNERS),
]
"""Names of landmarks, and those of the other side."""


@pytest.mark.parametrize(("names", "partners"), SIDED)
def test_names_of_sides_that_are_exchanged_are_named(results, truth, names, partners):
    """Before a mirrored truth, which would fit a little better, too."""
    exchanged = results.replaced(
        landmark_names=names, shapes=results.shapes[:, partners]
    )
    (warning,) = warnings_of_shapes(exchanged, truth.replaced(landmark_names=names))
    assert "better when left and right are exchanged" in warning


@pytest.mark.parametrize(("names", "partners"), SIDED)
def test_names_of_sides_that_are_right_are_not_named(results, truth, names, partners):
    named = results.replaced(landmark_names=names)
    assert warnings_of_shapes(named, truth.replaced(landmark_names=names)) == ()


@pytest.fixture
def sized(results):
    """Results that state metres, by their unit or by a column."""
    metres = np.full(N, 1.0)
    return [
        results.replaced(unit="m"),
        with_column(results, "metres_per_unit", metres),
    ]


@pytest.mark.parametrize(("factor", "told"), [(1000, "9"), (0.01, "1 / ")])
def test_sizes_that_contradict_the_unit_are_named(sized, truth, factor, told):
    scaled = truth.replaced(shapes=factor * truth.shapes)
    for results in sized:
        (warning,) = warnings_of_shapes(results, scaled)
        assert f"the truth is {told}" in warning
        assert "both state m" in warning


def test_sizes_that_agree_are_not_named(sized, truth):
    for results in sized:
        assert warnings_of_shapes(results, truth) == ()


@pytest.mark.parametrize("factor", [1, 1000, 0.01])
def test_results_in_pixels_may_have_any_size(results, truth, factor):
    scaled = truth.replaced(shapes=factor * truth.shapes)
    assert warnings_of_shapes(results, scaled) == ()


QUARTER_TURNS = rotation_about(np.array([1.0, 0, 0]), np.full(N, np.pi / 2))


def test_rotations_of_another_frame_are_not_measured(results, truth):
    """The shapes are as in the truth, and the rotations say that they are not."""
    turned = results.replaced(rotation=results.rotation @ QUARTER_TURNS)
    found = measured(turned, truth)
    assert ("rotation", "deg") not in found.errors
    assert "no rotation: off by 90 degrees" in found.warnings[0]


def test_rotations_that_are_wrong_with_their_shapes_are_measured(results, truth):
    wrong = results.replaced(
        rotation=QUARTER_TURNS @ results.rotation,
        shapes=in_rows(QUARTER_TURNS @ results.as_columns()),
    )
    found = measured(wrong, truth)
    np.testing.assert_allclose(found.errors["rotation", "deg"], 90)


def sizes(record):
    """Return the size of each shape: the root of the sum of squares about the mean."""
    shapes = record.shapes
    centred = shapes - shapes.mean(axis=1, keepdims=True)
    return np.linalg.norm(centred, axis=(1, 2))


def test_the_expected_error_is_set_beside_the_measured_one(results, truth):
    column = np.array([5.0, *[10.0] * 5, np.nan])
    record = with_column(results, "expected_error", column)
    found = measured(record, truth, metrics=["similarity", "expected"])
    errors = found.errors["expected", "m"]
    in_unit_of_truth = column * sizes(truth) / sizes(results)
    np.testing.assert_allclose(errors[:6], in_unit_of_truth[:6])
    assert np.isinf(errors[6])
    assert found.failures == {}


def test_without_expected_errors_there_are_none(results, truth):
    found = measured(results, truth, metrics=["similarity", "expected"])
    assert ("expected", "m") not in found.errors
    assert found.warnings == ()


WITH_LABELS = ["similarity", "precision", "recall"]


@pytest.fixture
def labelled(results):
    """Results whose outliers are labelled, and which landmarks were corrupted."""
    outliers = np.zeros((N, 5), bool)
    corrupted = np.zeros((N, 5), bool)
    corrupted[0, :4] = True
    corrupted[1, 2] = True
    corrupted[2, 3] = True
    outliers[0, [0, 1, 4]] = True
    outliers[1, 2] = True
    outliers[5, 0] = True
    record = with_column(results, "outliers", outliers)
    return with_column(record, "corrupted", corrupted)


def test_labels_of_outliers_count_where_there_are_some(labelled, truth):
    without_a_shape = changed(labelled, "shapes", 1, np.nan)
    found = measured(without_a_shape, truth, metrics=WITH_LABELS)
    precision = found.errors["precision", "share"]
    recall = found.errors["recall", "share"]
    inf = np.inf
    np.testing.assert_allclose(precision, [2 / 3, np.nan, inf, inf, inf, 0, inf])
    np.testing.assert_allclose(recall, [0.5, np.nan, 0, inf, inf, inf, inf])
    assert list(found.failures) == ["item1"]


def test_without_the_truth_about_outliers_labels_are_not_judged(labelled, truth):
    unknown = with_column(labelled, "corrupted", None)
    found = measured(unknown, truth, metrics=WITH_LABELS)
    assert "no precision and recall without `corrupted`" in found.warnings[0]


@pytest.fixture
def squares(with_bars, truth):
    """How far the truth is from the shapes in their error bars, and how wide these
    are.
    """
    return find_squares(
        with_bars.as_columns(),
        truth.as_columns(),
        with_bars.column("true_rotation"),
        in_columns(with_bars.shape_sd),
        in_columns(with_bars.column("shape_correlation")),
    )


def check_bars(bars, squares, truth):
    square, width = squares
    size = truth.as_columns().std(axis=-1).mean(axis=-1)
    np.testing.assert_allclose(bars.square, square)
    np.testing.assert_allclose(bars.width["m"], width)
    np.testing.assert_allclose(bars.width["normalised"], width / size[:, None])


def test_error_bars_are_those_of_the_frame_of_the_camera(with_bars, truth, squares):
    bars = measured(with_bars, truth, metrics=SHAPES, truth_frame="object").bars
    check_bars(bars, squares, truth)


def test_error_bars_of_a_truth_in_the_frame_of_the_camera(with_bars, truth, squares):
    R = with_bars.column("true_rotation")
    without = with_column(with_bars, "true_rotation", None)
    turned = truth.replaced(shapes=in_rows(R @ truth.as_columns()))
    bars = measured(without, turned, metrics=SHAPES, truth_frame="camera").bars
    check_bars(bars, squares, turned)


def test_error_bars_of_an_unknown_frame_are_not_judged(with_bars, truth):
    without = with_column(with_bars, "true_rotation", None)
    found = measured(without, truth, metrics=SHAPES)
    assert found.bars is None
    assert "without `true_rotation` or `truth_frame`" in found.warnings[0]


@pytest.fixture
def partly_observed(results):
    """Results of images in which 5, 4, 3, 5, 2, 4 and 5 landmarks were observed."""
    observed = results.column("landmarks").copy()
    for image, count in zip(observed, (5, 4, 3, 5, 2, 4, 5), strict=True):
        image[count:] = np.nan
    return with_column(results, "landmarks", observed)


def test_images_with_at_least_so_many_observed_landmarks_are_measured(
    partly_observed, truth
):
    results = changed(partly_observed, "shapes", 0, np.nan)
    found = measured(results, truth, metrics=SHAPES, least_visible=4)
    assert found.items == ("item0", "item1", "item3", "item5", "item6")
    assert list(found.failures) == ["item0"]


def test_more_landmarks_than_any_image_has_are_refused(partly_observed, truth):
    with pytest.raises(InputError, match="holds no shapes with 6 observed `landmarks`"):
        measured(partly_observed, truth, metrics=SHAPES, least_visible=6)


def test_observed_landmarks_that_are_not_stored_are_refused(partly_observed, truth):
    without = with_column(partly_observed, "landmarks", None)
    with pytest.raises(InputError, match="holds no shapes with 1 observed `landmarks`"):
        measured(without, truth, metrics=SHAPES, least_visible=1)
