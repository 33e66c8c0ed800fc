"""Which truth belongs to which image, what can be measured, and what fails and why."""

from pathlib import Path

import numpy as np
import pytest

from shapefit.config import EvalConfig
from shapefit.errors import InputError
from shapefit.evaluation import metrics
from shapefit.geometry.rotations import random_rotations, rotation_about
from shapefit.io.records import ResultSet, ShapeSet
from shapefit.pipelines.evaluate.judge import Truth, judge
from shapefit.pipelines.items import Keys, keys_of

FILE = Path("/results/convex.h5")
NAMES = ("head", "left", "right", "foot", "hand")
METRICS = ("similarity", "camera", "rotation", "reprojection")
N = 6


@pytest.fixture
def truth(rng):
    return ShapeSet(
        shapes=rng.standard_normal((N, 3, len(NAMES))),
        landmark_names=NAMES,
        items=tuple(f"item{i}" for i in range(N)),
        sequences=("walk", "walk", "run", "run", "run", "run"),
        unit="m",
    )


@pytest.fixture
def rotations(rng):
    return random_rotations(N, rng)


@pytest.fixture
def fields(truth, rotations, rng):
    """Fields of a good result: the truth turned, blown up to pixels and a little wrong."""
    shapes = 100 * (rotations @ truth.shapes) + 5 * rng.standard_normal(truth.shapes.shape)
    fitted = shapes[:, :2] + 1
    observed = shapes[:, :2].swapaxes(-1, -2).copy()
    observed[0, 0] = np.nan
    return {
        "shapes": shapes,
        "landmarks_fitted": fitted,
        "rotation": rotation_about(np.array([0.0, 1, 0]), np.full(N, np.pi / 6)) @ rotations,
        "landmark_names": NAMES,
        "items": truth.items,
        "sequences": truth.sequences,
        "unit": "px",
        "columns": {"true_rotation": rotations, "landmarks": observed},
    }


def judged(fields, truth, match="item", metrics=METRICS):
    config = EvalConfig.model_construct(match=match, metrics=metrics)
    return judge(FILE, ResultSet(**fields), Truth(truth, keys_of([truth]), truth.take), config)


def test_every_metric_in_its_units(fields, truth, rotations):
    judgement = judged(fields, truth)
    errors = judgement.errors
    assert set(errors) == {
        ("similarity", "normalised"),
        ("similarity", "m"),
        ("camera", "normalised"),
        ("camera", "m"),
        ("rotation", "deg"),
        ("reprojection", "px"),
        ("reprojection", "box"),
    }
    similarity = metrics.similarity(fields["shapes"], truth.shapes)
    scale = truth.shapes.std(axis=-1).mean(axis=-1)
    np.testing.assert_allclose(errors["similarity", "m"], similarity)
    np.testing.assert_allclose(errors["similarity", "normalised"], similarity / scale)
    camera = metrics.camera(fields["shapes"], truth.shapes, rotations)
    np.testing.assert_allclose(errors["camera", "m"], camera)
    np.testing.assert_allclose(errors["camera", "normalised"], camera / scale)
    np.testing.assert_allclose(errors["rotation", "deg"], 30)
    np.testing.assert_allclose(errors["reprojection", "px"], np.sqrt(2))
    observed = fields["columns"]["landmarks"]
    sides = np.nanmax(observed, axis=1) - np.nanmin(observed, axis=1)
    box = np.sqrt(2) / np.linalg.norm(sides, axis=-1)
    np.testing.assert_allclose(errors["reprojection", "box"], box)
    assert (judgement.failures, judgement.warnings) == ({}, ())


def test_a_given_box_measures_the_reprojection(fields, truth):
    corners, sides = np.full((N, 2), 1e3), np.array([[3.0, 4.0], [12.0, 5.0], *4 * [[8.0, 6.0]]])
    fields["columns"]["bounding_box"] = np.concatenate([corners, sides], axis=1)
    box = judged(fields, truth, metrics=["reprojection"]).errors["reprojection", "box"]
    np.testing.assert_allclose(box, np.sqrt(2) / np.array([5.0, 13, 10, 10, 10, 10]))


def test_a_truth_without_unit_of_its_own_is_given_once(fields, truth):
    plain = ShapeSet(truth.shapes, NAMES, truth.items, unit="normalised")
    assert set(judged(fields, plain, metrics=["similarity"]).errors) == {
        ("similarity", "normalised")
    }


def test_items_are_matched_by_name_not_by_place(fields, truth):
    expected = judged(fields, truth)
    shuffled = judged(fields, truth.take([3, 1, 5, 0, 4, 2]))
    for kind, values in expected.errors.items():
        np.testing.assert_allclose(shuffled.errors[kind], values)


def test_landmarks_are_matched_by_name_and_others_left_out(fields, truth):
    order = [4, 2, 0, 1]  # the truth lacks the foot and has a tail instead
    tail = np.full((N, 3, 1), 1e6)
    shapes = np.concatenate([tail, truth.shapes[:, :, order]], axis=-1)
    names = ("tail", *(NAMES[i] for i in order))
    judgement = judged(fields, ShapeSet(shapes, names, truth.items, unit="m"))
    expected = metrics.similarity(fields["shapes"][:, :, order], truth.shapes[:, :, order])
    np.testing.assert_allclose(judgement.errors["similarity", "m"], expected)
    # The reprojection error needs no truth, and keeps all landmarks.
    np.testing.assert_allclose(judgement.errors["reprojection", "px"], np.sqrt(2))
    assert "in the results alone are left out: foot" in judgement.warnings[0]
    assert "in the truth alone are left out: tail" in judgement.warnings[1]


def test_another_dataset_can_name_the_truth(fields, truth):
    models = truth.take([2, 0])
    fields["shapes"] = truth.shapes[[0, 0, 2, 2, 0, 2]]
    fields["columns"] = {
        "true_model": np.array(["item0", "item0", "item2", "item2", "item0", "item2"], dtype=object)
    }
    judgement = judged(fields, models, "true_model", ["similarity"])
    np.testing.assert_allclose(judgement.errors["similarity", "m"], np.zeros(N), atol=1e-12)
    assert judgement.items == truth.items


class TestFailures:
    def test_an_item_without_shape_is_listed_with_its_status(self, fields, truth):
        for name in ("shapes", "landmarks_fitted", "rotation"):
            fields[name][2] = np.nan
        fields["status"] = np.array(["solved", "solved", "too few landmarks", *3 * ["solved"]])
        judgement = judged(fields, truth)
        (reason,) = judgement.failures.values()
        assert list(judgement.failures) == ["item2"]
        assert "too few landmarks" in reason
        for values in judgement.errors.values():
            assert np.flatnonzero(np.isnan(values)).tolist() == [2]

    def test_an_item_without_truth_is_listed_in_every_metric(self, fields, truth):
        judgement = judged(fields, truth.take([0, 1, 2, 3, 5]))
        assert judgement.failures == {"item4": "the truth has no item 'item4'"}
        for values in judgement.errors.values():
            assert np.flatnonzero(np.isnan(values)).tolist() == [4]

    def test_an_item_with_two_landmarks_is_listed(self, fields, truth):
        fields["shapes"][1, :, 2:] = np.nan
        assert judged(fields, truth, metrics=["similarity"]).failures == {
            "item1": "only 2 landmarks are known on both sides"
        }

    def test_an_empty_shape_lacks_its_rotation_alone_and_is_listed_with_that(self, fields, truth):
        fields["shapes"][3] = [[320.0], [240.0], [0.0]]
        fields["landmarks_fitted"][3] = [[320.0], [240.0]]
        fields["rotation"][3] = np.nan
        judgement = judged(fields, truth)
        reason = "no rotation (deg): the shape is empty, with all its landmarks at one point"
        assert judgement.failures == {"item3": reason}
        for (metric, _), values in judgement.errors.items():
            lost = [3] if metric == "rotation" else []
            assert np.flatnonzero(np.isnan(values)).tolist() == lost
        # what is left of a shape without extent is the extent of the truth
        centred = truth.shapes[3] - truth.shapes[3].mean(axis=-1, keepdims=True)
        expected = np.linalg.norm(centred, axis=0).mean()
        for metric in ("similarity", "camera"):
            assert judgement.errors[metric, "m"][3] == pytest.approx(expected)

    @pytest.mark.parametrize("sides", [(0.0, 0.0), (np.nan, 4.0)])
    def test_an_item_with_no_box_to_measure_by_is_listed(self, fields, truth, sides):
        boxes = np.tile([0.0, 0, 3, 4], (N, 1))
        boxes[3, 2:] = sides
        fields["columns"]["bounding_box"] = boxes
        judgement = judged(fields, truth)
        assert list(judgement.failures) == ["item3"]
        assert "reprojection (box)" in judgement.failures["item3"]

    def test_partial_shapes_are_judged_on_the_rest_with_a_warning(self, fields, truth):
        fields["shapes"][1, :, 0] = np.nan
        judgement = judged(fields, truth, metrics=["similarity"])
        expected = metrics.similarity(fields["shapes"][1:2, :, 1:], truth.shapes[1:2, :, 1:])
        np.testing.assert_allclose(judgement.errors["similarity", "m"][1], expected[0])
        assert "1 images lack some of the 5 landmarks" in judgement.warnings[0]


class TestSkippedMetrics:
    @pytest.mark.parametrize(
        ("absent", "skipped"),
        [
            ("true_rotation", {"camera", "rotation"}),
            ("landmarks", {"reprojection"}),
            ("landmarks_fitted", {"reprojection"}),
            ("rotation", {"rotation"}),
        ],
    )
    def test_are_named_with_what_they_lack(self, fields, truth, absent, skipped):
        fields.pop(absent, None)
        fields["columns"].pop(absent, None)
        judgement = judged(fields, truth)
        assert {metric for metric, _ in judgement.errors} == set(METRICS) - skipped
        assert len(judgement.warnings) == len(skipped)
        for metric, warning in zip(sorted(skipped), sorted(judgement.warnings), strict=True):
            assert f"no {metric} without the dataset `{absent}`" in warning

    def test_nothing_left_to_measure_is_an_error(self, fields, truth):
        del fields["rotation"]
        with pytest.raises(InputError, match="no rotation without the dataset `rotation`; add"):
            judged(fields, truth, metrics=["rotation"])


class TestSequences:
    def test_else_from_the_truth(self, fields, truth):
        fields["sequences"] = None
        judgement = judged(fields, truth.take([0, 1, 2, 3, 4]))
        assert judgement.sequences == ("walk", "walk", "run", "run", "run", "")

    def test_else_there_is_one(self, fields, truth):
        fields["sequences"] = None
        plain = ShapeSet(truth.shapes, NAMES, truth.items)
        assert judged(fields, plain).sequences == ("all",) * N


class TestInputErrors:
    def test_too_few_landmarks_match(self, fields, truth):
        fields["landmark_names"] = ("head", "left", "x", "y", "z")
        with pytest.raises(InputError, match=r"has 2 of its landmarks.*at least 3"):
            judged(fields, truth)

    @pytest.mark.parametrize("name", ["true_rotation", "landmarks", "bounding_box"])
    def test_dataset_of_wrong_shape(self, fields, truth, name):
        fields["columns"]["bounding_box"] = np.ones((N, 4))
        fields["columns"][name] = fields["columns"][name][:, :2]
        with pytest.raises(InputError, match=f"convex.h5:/{name}: has the shape"):
            judged(fields, truth)

    def test_no_images(self, fields, truth):
        with pytest.raises(InputError, match="holds no images"):
            judge(
                FILE, ResultSet(**fields).take([]), Truth(truth, Keys(()), truth.take), EvalConfig
            )


def test_a_truth_without_shapes(truth, fields):
    with pytest.raises(InputError) as caught:
        judged(fields, truth.take([]))
    assert caught.value.problems == (
        f"truth: holds no shapes; give the truth of the images of {FILE}",
    )


def walk_of(shapes, names, **sequences):
    """Frames of shapes (n, 3, p) in sequences (name -> its number of frames)."""
    order = [name for name, count in sequences.items() for _ in range(count)]
    frames = np.array([i for count in sequences.values() for i in range(count)])
    items = tuple(f"{name}/{i}" for name, i in zip(order, frames, strict=True))
    return {
        "landmark_names": names, "items": items, "sequences": tuple(order), "unit": "m",
        "columns": {"frame": frames}, "shapes": shapes,
    }  # fmt: skip


@pytest.mark.parametrize("bystander_first", [False, True])
def test_one_individual_is_judged_against_one_truth(truth, rng, bystander_first):
    """By frame two people match one truth; the one whose shapes are farther from it is left out."""
    man = truth.shapes + 0.02 * rng.standard_normal(truth.shapes.shape)
    other = rng.standard_normal(truth.shapes.shape)
    both = {"man": man, "bystander": other}
    if bystander_first:
        both = dict(reversed(both.items()))
    fields = walk_of(np.concatenate([*both.values()]), NAMES, **dict.fromkeys(both, N))
    true = ShapeSet(**walk_of(truth.shapes, NAMES, subject=N))
    found = judged(fields, true, "frame", ["similarity"])
    assert set(found.sequences) == {"man"}
    assert found.failures == {}
    expected = metrics.similarity(man, truth.shapes)
    np.testing.assert_allclose(found.errors["similarity", "m"], expected)
    assert "bystander left out: man fits the same true shapes better" in found.warnings[0]
    # Two people of the truth by the same names are both judged.
    fields = walk_of(np.concatenate([man, other]), NAMES, man=N, bystander=N)
    two = ShapeSet(**walk_of(np.concatenate([truth.shapes] * 2), NAMES, man=N, bystander=N))
    assert len(judged(fields, two, "frame", ["similarity"]).items) == 2 * N


def test_a_mirrored_truth_is_said(fields, truth):
    mirrored = truth.replaced(shapes=truth.shapes * [[-1.0], [1.0], [1.0]])
    (warning,) = judged(fields, mirrored, metrics=["similarity"]).warnings
    assert "fit the truth better when it is mirrored" in warning
    assert "left-handed" in warning
    assert judged(fields, truth, metrics=["similarity"]).warnings == ()


def test_rotations_of_another_frame_are_not_measured(fields, truth, rotations):
    """The shapes lie as the truth does, and the rotations say that they do not."""
    quarter = rotation_about(np.array([1.0, 0, 0]), np.full(N, np.pi / 2))
    fields["rotation"] = rotations @ quarter
    found = judged(fields, truth)
    assert ("rotation", "deg") not in found.errors
    assert "no rotation: those of the results are 90 degrees off" in found.warnings[0]
    fields["shapes"] = quarter @ fields["shapes"]  # a wrong view is an error like any other
    fields["rotation"] = quarter @ rotations
    np.testing.assert_allclose(judged(fields, truth).errors["rotation", "deg"], 90)


def test_the_expected_error_is_set_beside_the_measured_one(fields, truth):
    fields["columns"]["expected_error"] = np.array([5.0, *[10.0] * 4, np.nan])
    found = judged(fields, truth, metrics=["similarity", "expected"])
    sizes = [np.linalg.norm(s - s.mean(2, keepdims=True), axis=(1, 2))
             for s in (fields["shapes"], truth.shapes)]  # fmt: skip
    expected = found.errors["expected", "m"]
    np.testing.assert_allclose(expected[:5], [5, 10, 10, 10, 10] * (sizes[1] / sizes[0])[:5])
    assert found.failures == {}
    assert np.isinf(expected[5])
    del fields["columns"]["expected_error"]
    found = judged(fields, truth, metrics=["similarity", "expected"])
    assert ("expected", "m") not in found.errors
    assert found.warnings == ()
