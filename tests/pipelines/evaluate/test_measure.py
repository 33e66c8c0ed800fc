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
from tests.columns import put

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


def test_every_metric_in_its_units(results, truth):
    quarter = rotation_about(np.array([0.0, 1, 0]), np.full(N, np.pi / 6))
    results = results.replaced(rotation=quarter @ results.rotation)
    found = measured(results, truth)
    similarity = metrics.similarity(results.as_columns(), truth.as_columns())
    camera = metrics.camera(
        results.as_columns(), truth.as_columns(), results.column("true_rotation")
    )
    scale = truth.as_columns().std(axis=-1).mean(axis=-1)
    observed = results.column("landmarks").swapaxes(1, 2)
    reprojection = metrics.reprojection(in_columns(results.landmarks_fitted), observed)
    expected = {
        ("similarity", "normalised"): similarity / scale,
        ("similarity", "m"): similarity,
        ("camera", "normalised"): camera / scale,
        ("camera", "m"): camera,
        ("rotation", "deg"): np.full(N, 30.0),
        ("reprojection", "px"): reprojection,
        ("reprojection", "box"): (
            reprojection / np.linalg.norm(np.ptp(observed, axis=2), axis=1)
        ),
    }
    assert found.errors.keys() == expected.keys()
    for kind, values in expected.items():
        np.testing.assert_allclose(found.errors[kind], values)
    assert found.failures == {}
    assert found.warnings == ()
    assert found.bars is None
    boxed = with_column(
        results, "bounding_box", np.tile(np.uint8([9, 9, 1, 2]), (N, 1))
    )
    box = measured(boxed, truth, metrics=["reprojection"]).errors["reprojection", "box"]
    np.testing.assert_allclose(box, reprojection / np.sqrt(5))
    plain = truth.replaced(unit="normalised")
    assert set(measured(results, plain, metrics=SHAPES).errors) == {
        ("similarity", "normalised")
    }


def test_items_and_landmarks_are_matched_by_name(results, truth):
    order = [4, 2, 0, 1]  # the truth lacks the foot and has a tail instead
    shapes = np.concatenate(
        [np.full((N, 3, 1), 1e6), truth.as_columns()[:, :, order]], axis=-1
    )
    names = ("tail", *(NAMES[i] for i in order))
    true = Shapes(
        shapes.swapaxes(1, 2), landmark_names=names, items=ITEMS, unit="m"
    ).take([3, 1, 5, 0, 4, 2, 6])
    found = measured(results, true)
    expected = metrics.similarity(
        results.as_columns()[:, :, order], truth.as_columns()[:, :, order]
    )
    np.testing.assert_allclose(found.errors["similarity", "m"], expected)
    # The reprojection error needs no truth, and keeps all landmarks.
    whole = measured(results, truth)
    np.testing.assert_array_equal(
        found.errors["reprojection", "px"], whole.errors["reprojection", "px"]
    )
    assert found.warnings == (
        f"{FILE}: landmarks in the results alone are left out: foot",
        f"{FILE}: landmarks in the truth alone are left out: tail",
    )


def test_another_dataset_can_name_the_truth(results, truth):
    models = np.array([f"item{i}" for i in (0, 0, 2, 2, 0, 2, 9)], dtype=object)
    results = with_column(results, "true_model", models)
    results = results.replaced(
        shapes=truth.as_columns()[[0, 0, 2, 2, 0, 2, 0]].swapaxes(1, 2)
    )
    found = measured(results, truth.take([2, 0]), "true_model", SHAPES)
    np.testing.assert_allclose(found.errors["similarity", "m"][:6], 0, atol=1e-12)
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


@pytest.mark.parametrize("case", FAILURES)
def test_an_image_that_fails_is_listed_with_the_reason(results, truth, case):
    changes, reason = FAILURES[case]
    results = with_column(results, "bounding_box", np.tile([0.0, 0, 3, 4], (N, 1)))
    results = results.replaced(
        status=np.array(["optimal"] * 3 + ["degenerate input"] * 4)
    )
    for name, value in changes.items():
        results = changed(results, name, 3, value)
    found = measured(results, truth)
    assert list(found.failures) == ["item3"]
    assert found.failures["item3"].startswith(reason)
    for (metric, _), values in found.errors.items():
        assert set(np.flatnonzero(np.isnan(values))) <= {3}
        if (
            case == "empty"
        ):  # what is left of a shape without extent is the extent of the truth
            assert np.isnan(values[3]) == (metric == "rotation")


def test_without_truth_an_image_fails_in_every_metric_and_a_partial_shape_in_none(
    results, truth
):
    found = measured(results, truth.take([0, 1, 2, 3, 5, 6]))
    assert found.failures == {"item4": "it has no true shape"}
    for values in found.errors.values():
        assert np.flatnonzero(np.isnan(values)).tolist() == [4]
    partial = results.as_columns().copy()
    partial[1, :, 0] = np.nan
    found = measured(
        results.replaced(shapes=partial.swapaxes(1, 2)), truth, metrics=SHAPES
    )
    expected = metrics.similarity(partial[1:2, :, 1:], truth.as_columns()[1:2, :, 1:])
    np.testing.assert_allclose(found.errors["similarity", "m"][1], expected[0])


@pytest.mark.parametrize(
    ("absent", "skipped"),
    [
        ("true_rotation", {"camera", "rotation"}),
        ("landmarks", {"reprojection"}),
        ("landmarks_fitted", {"reprojection"}),
        ("rotation", {"rotation"}),
    ],
)
def test_metrics_without_their_datasets_are_named(results, truth, absent, skipped):
    found = measured(with_column(results, absent, None), truth)
    assert {metric for metric, _ in found.errors} == set(METRICS) - skipped
    named = " and ".join(metric for metric in METRICS if metric in skipped)
    assert found.warnings == (f"{FILE}: no {named} without `{absent}`",)
    metric = min(skipped)
    with pytest.raises(
        InputError, match=f"no {metric} without `{absent}`; add the metric"
    ):
        measured(with_column(results, absent, None), truth, metrics=[metric])


def test_sequences_are_those_of_the_results_else_of_the_truth_else_one(results, truth):
    assert measured(results, truth).sequences == truth.sequences
    plain = results.replaced(sequences=None)
    sequences = measured(plain, truth.take([0, 1, 2, 3, 4, 5])).sequences
    assert sequences == (*truth.sequences[:6], "")
    assert measured(plain, truth.replaced(sequences=None)).sequences == ("all",) * N


def test_inputs_that_cannot_be_compared_are_errors(results, truth):
    names = ("head", "left", "x", "y", "z")
    with pytest.raises(InputError, match=r"has 2 of its landmarks.*at least 3"):
        measured(results.replaced(landmark_names=names), truth)
    boxed = with_column(results, "bounding_box", np.ones((N, 4)))
    for name in ("true_rotation", "bounding_box"):
        wrong = with_column(boxed, name, boxed.column(name)[:, :2])
        with pytest.raises(InputError, match=f"convex.h5:/{name}: has the shape"):
            measured(wrong, truth)
    with pytest.raises(InputError, match="holds no shapes"):
        measured(results.take([]), truth)
    with pytest.raises(InputError, match="truth: holds no shapes; give results"):
        measured(results, truth.take([]))
    with pytest.raises(
        InputError, match=r"none of its 7 images is in the truth.*set `match`"
    ):
        measured(
            results.replaced(status=np.array(["optimal"] * N)),
            truth.replaced(items=tuple("abcdefg")),
        )


def walk_of(shapes, **sequences):
    """Frames of shapes (n, 3, p) in sequences (name -> its number of frames)."""
    order = [name for name, count in sequences.items() for _ in range(count)]
    frames = np.array([i for count in sequences.values() for i in range(count)])
    items = tuple(f"{name}/{i}" for name, i in zip(order, frames, strict=True))
    return {
        "landmark_names": NAMES,
        "items": items,
        "sequences": tuple(order),
        "unit": "m",
        "frames": frames,
        "shapes": shapes.swapaxes(1, 2),
    }


@pytest.mark.parametrize("who", [("man", "bystander"), ("bystander", "man")])
@pytest.mark.parametrize("match", ["frame", "item"])
def test_one_individual_is_measured_against_one_truth(truth, rng, who, match):
    """By frame two people match one truth; the one whose shapes are farther from it is
    left out.
    """
    shapes = {
        "man": truth.as_columns()
        + 0.02 * rng.standard_normal(truth.as_columns().shape),
        "bystander": rng.standard_normal(truth.as_columns().shape),
    }
    counts = dict.fromkeys(who, N)
    results = Fit(**walk_of(np.concatenate([shapes[name] for name in who]), **counts))
    found = measured(
        results, Shapes(**walk_of(truth.as_columns(), subject=N)), match, SHAPES
    )
    assert set(found.sequences) == {"man"}
    assert found.failures == {}
    expected = metrics.similarity(shapes["man"], truth.as_columns())
    np.testing.assert_allclose(found.errors["similarity", "m"], expected)
    assert (
        "bystander left out: another individual fits the same true shapes better"
        in found.warnings[0]
    )
    # Two people of the truth by the same names are both measured.
    two = Shapes(**walk_of(np.concatenate([truth.as_columns()] * 2), **counts))
    assert len(measured(results, two, match, SHAPES).items) == 2 * N


def test_a_mirrored_truth_is_named(results, truth):
    mirrored = truth.replaced(
        shapes=(truth.as_columns() * [[-1.0], [1.0], [1.0]]).swapaxes(1, 2)
    )
    mirrored.shapes[0, 2:] = np.nan
    (warning,) = measured(results, mirrored, metrics=SHAPES).warnings
    assert "fit the truth better when it is mirrored" in warning
    assert "left-handed" in warning


SIDED = [
    ("head", "left", "right", "foot", "hand"),
    ("head", "l_eye", "r_eye", "foot", "hand"),
    ("head", "LEar", "REar", "lfoot", "rfoot"),
]


@pytest.mark.parametrize("names", SIDED)
def test_names_of_sides_that_are_exchanged_are_named(results, truth, names):
    """Before a mirrored truth, which would fit a little better, too."""
    results = results.replaced(landmark_names=names)
    truth = truth.replaced(landmark_names=names)
    order = [0, 2, 1, 3, 4] if names[3] == "foot" else [0, 2, 1, 4, 3]
    exchanged = results.replaced(shapes=results.as_columns()[..., order].swapaxes(1, 2))
    (warning,) = measured(exchanged, truth, metrics=SHAPES).warnings
    assert "better when left and right are exchanged" in warning
    assert measured(results, truth, metrics=SHAPES).warnings == ()


@pytest.mark.parametrize(("factor", "told"), [(1000, "9"), (0.01, "1 / ")])
def test_sizes_that_contradict_the_unit_are_named(results, truth, factor, told):
    larger = truth.replaced(shapes=(factor * truth.as_columns()).swapaxes(1, 2))
    in_metres = results.replaced(unit="m")
    (warning,) = measured(in_metres, larger, metrics=SHAPES).warnings
    assert f"the truth is {told}" in warning
    assert "both state m" in warning
    stated = with_column(results, "metres_per_unit", np.full(N, 1.0))
    (warning,) = measured(stated, larger, metrics=SHAPES).warnings
    assert "both state m" in warning
    for fine in (in_metres, results, stated):
        assert measured(fine, truth, metrics=SHAPES).warnings == ()
    assert measured(results, larger, metrics=SHAPES).warnings == ()


def test_rotations_of_another_frame_are_not_measured(results, truth):
    """The shapes are as in the truth, and the rotations say that they are not."""
    quarter = rotation_about(np.array([1.0, 0, 0]), np.full(N, np.pi / 2))
    R = results.rotation
    found = measured(results.replaced(rotation=R @ quarter), truth)
    assert ("rotation", "deg") not in found.errors
    assert "no rotation: off by 90 degrees" in found.warnings[0]
    wrong = results.replaced(
        rotation=quarter @ R, shapes=(quarter @ results.as_columns()).swapaxes(1, 2)
    )
    np.testing.assert_allclose(measured(wrong, truth).errors["rotation", "deg"], 90)


def test_the_expected_error_is_set_beside_the_measured_one(results, truth):
    wanted = ["similarity", "expected"]
    column = np.array([5.0, *[10.0] * 5, np.nan])
    found = measured(
        with_column(results, "expected_error", column), truth, metrics=wanted
    )
    sizes = [
        np.linalg.norm(s - s.mean(2, keepdims=True), axis=(1, 2))
        for s in (truth.as_columns(), results.as_columns())
    ]
    expected = found.errors["expected", "m"]
    np.testing.assert_allclose(expected[:6], (column * sizes[0] / sizes[1])[:6])
    assert found.failures == {}
    assert np.isinf(expected[6])
    found = measured(results, truth, metrics=wanted)
    assert ("expected", "m") not in found.errors
    assert found.warnings == ()


def test_labels_of_outliers_count_where_there_are_some(results, truth):
    labelled = np.zeros((N, 5), bool)
    corrupted = np.zeros((N, 5), bool)
    corrupted[0, :4] = corrupted[1, 2] = corrupted[2, 3] = True
    labelled[0, [0, 1, 4]] = labelled[1, 2] = labelled[5, 0] = True
    wanted = ["similarity", "precision", "recall"]
    results = with_column(
        with_column(results, "outliers", labelled), "corrupted", corrupted
    )
    found = measured(changed(results, "shapes", 1, np.nan), truth, metrics=wanted)
    inf, nan = np.inf, np.nan
    shares = [found.errors[name, "share"] for name in ("precision", "recall")]
    np.testing.assert_allclose(shares[0], [2 / 3, nan, inf, inf, inf, 0, inf])
    np.testing.assert_allclose(shares[1], [0.5, nan, 0, inf, inf, inf, inf])
    assert list(found.failures) == ["item1"]
    unknown = measured(with_column(results, "corrupted", None), truth, metrics=wanted)
    assert "no precision and recall without `corrupted`" in unknown.warnings[0]


def test_error_bars_are_those_of_the_frame_of_the_camera(with_bars, truth):
    """By `true_rotation`, or where the truth is in the frame of the camera."""
    R = with_bars.column("true_rotation")
    correlation = with_bars.column("shape_correlation").swapaxes(1, 2)
    square, width = find_squares(
        with_bars.as_columns(),
        truth.as_columns(),
        R,
        in_columns(with_bars.shape_sd),
        correlation,
    )
    without = with_column(with_bars, "true_rotation", None)
    turned = truth.replaced(shapes=(R @ truth.as_columns()).swapaxes(1, 2))
    for results, true, frame in (
        (with_bars, truth, "object"),
        (without, turned, "camera"),
    ):
        bars = measured(results, true, metrics=SHAPES, truth_frame=frame).bars
        np.testing.assert_allclose(bars.square, square)
        np.testing.assert_allclose(bars.width["m"], width)
        unit = true.as_columns().std(axis=-1).mean(axis=-1)
        np.testing.assert_allclose(bars.width["normalised"], width / unit[:, None])
    none = measured(without, truth, metrics=SHAPES)
    assert none.bars is None
    assert "without `true_rotation` or `truth_frame`" in none.warnings[0]


def test_images_with_at_least_so_many_observed_landmarks_are_measured(results, truth):
    observed = results.column("landmarks").copy()
    for image, visible in zip(observed, (5, 4, 3, 5, 2, 4, 5), strict=True):
        image[visible:] = np.nan
    results = changed(with_column(results, "landmarks", observed), "shapes", 0, np.nan)
    found = measured(results, truth, metrics=SHAPES, least_visible=4)
    assert found.items == ("item0", "item1", "item3", "item5", "item6")
    assert list(found.failures) == ["item0"]
    without = with_column(results, "landmarks", None)
    for records, least in ((results, 6), (without, 1)):
        with pytest.raises(
            InputError, match=f"holds no shapes with {least} observed `landmarks`"
        ):
            measured(records, truth, metrics=SHAPES, least_visible=least)
