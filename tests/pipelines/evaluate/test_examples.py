"""The examples of eval: which images, and what of each is drawn."""

from pathlib import Path

import numpy as np
import pytest

from shapefit.errors import InputError
from shapefit.geometry.rotations import random_rotations
from shapefit.io.records import ResultSet, ShapeSet
from shapefit.pipelines.evaluate import examples
from shapefit.pipelines.evaluate.examples import Lifted, choose, examples_picture
from shapefit.pipelines.evaluate.judgement import judge
from shapefit.pipelines.evaluate.plan import check_examples

NAMES = ("head", "left", "right", "foot", "hand")
EDGES = np.array([[0, 1], [0, 2], [1, 3], [2, 4]])
ITEMS = (*(f"walk/{i:02d}" for i in range(6)), "box/00", "box/01")


@pytest.fixture
def truth(rng):
    return ShapeSet(rng.standard_normal((8, 3, 5)), NAMES, ITEMS, edges=EDGES)


@pytest.fixture
def turned(truth, rng):
    """True shapes in other frames, in another order of landmarks and items, with one unknown."""
    R = random_rotations(8, rng)
    shapes = 3 * R @ truth.shapes + rng.standard_normal((8, 3, 1))
    observed = shapes[:, :2].swapaxes(1, 2) + 0.5
    order, rows = [3, 1, 0, 2], [7, 2, 1, 0, 3, 4, 5, 6]
    return ResultSet(
        shapes=shapes[rows][:, :, order],
        landmark_names=tuple(NAMES[i] for i in order),
        items=tuple(ITEMS[i] for i in rows),
        columns={"landmarks": observed[rows][:, order]},
    )


def lifted(results, truth, file="convex.h5", match="item"):
    path = Path(file)
    return Lifted(results, judge(path, results, lambda _: truth, match, ["similarity"]))


@pytest.fixture
def poses(monkeypatch):
    """What the picture was asked to draw."""
    drawn = []
    monkeypatch.setattr(examples, "skeleton_picture", lambda *arguments: drawn.append(arguments))
    return drawn


def test_landmarks_truth_and_methods_stand_in_the_frame_of_the_first(truth, turned, poses):
    other = turned.replaced(shapes=-turned.shapes)
    methods = {"Convex": [lifted(turned, truth)], "Mirrored": [lifted(other, truth)]}
    examples_picture(["walk/02"], methods, truth)
    ((drawn, edges, y_axis),) = poses
    (pose,) = drawn
    assert list(pose.shapes) == ["truth", "Convex", "Mirrored"]
    assert (pose.title, y_axis) == ("walk/02", "down")
    np.testing.assert_array_equal(edges, EDGES)
    estimate = pose.shapes["Convex"]
    np.testing.assert_allclose(pose.shapes["truth"][:, :4], estimate[:, :4])
    np.testing.assert_allclose(pose.landmarks[:, :4], estimate[:2, :4] + 0.5)
    np.testing.assert_array_equal(pose.shapes["Mirrored"], -estimate)
    # `hand` is in the truth only: it is laid where the others put it.
    assert np.isnan(estimate[:, 4]).all()
    assert np.isnan(pose.landmarks[:, 4]).all()
    assert np.isfinite(pose.shapes["truth"]).all()


def test_images_of_one_object_are_matched_by_a_dataset(truth, turned, poses):
    models = np.array(turned.items, dtype=object)
    images = turned.replaced(
        items=tuple(f"image{i}" for i in range(8)), further={**turned.further, "model": models}
    )
    examples_picture(2, {"m": [lifted(images, truth, match="model")]}, truth)
    ((drawn, *_),) = poses
    assert [pose.title for pose in drawn] == ["image2", "image6"]
    for pose in drawn:
        np.testing.assert_allclose(pose.shapes["truth"][:, :4], pose.shapes["m"][:, :4])


def test_only_images_that_every_method_lifted_are_chosen(truth, turned, poses):
    broken = turned.shapes.copy()
    broken[turned.items.index("walk/03")] = np.nan
    rows = [i for i, item in enumerate(turned.items) if item != "walk/04"]
    methods = {
        "a": [lifted(turned.take(rows[:4]), truth), lifted(turned.take(rows[4:]), truth)],
        "b": [lifted(turned.replaced(shapes=broken), truth)],
    }
    examples_picture(["walk/*"], methods, truth)
    ((drawn, *_),) = poses
    assert sorted(pose.title for pose in drawn) == ["walk/00", "walk/01", "walk/02", "walk/05"]
    with pytest.raises(InputError, match="'walk/03'"):
        examples_picture(["walk/03"], methods, truth)


def test_the_figure_has_a_column_each_and_a_row_an_example(truth, turned):
    methods = {"Convex": [lifted(turned, truth)], "PMP": [lifted(turned, truth)]}
    figure = examples_picture(3, methods, truth)
    heads = [axes.get_title() for axes in figure.axes[:4]]
    assert heads == ["landmarks", "truth", "Convex", "PMP"]
    assert len(figure.axes) == 3 * 4


@pytest.mark.parametrize(
    ("count", "expected"),
    [(1, "4"), (2, "26"), (3, "146"), (4, "1357"), (8, "01234567"), (20, "01234567")],
)
def test_a_number_is_spread_evenly(count, expected):
    assert "".join(choose(count, "01234567")) == expected


def test_names_and_globs_keep_their_order_and_count_once():
    assert choose(["box/01", "walk/0[12]", "box/*"], ITEMS) == (
        "box/01", "walk/01", "walk/02", "box/00",
    )  # fmt: skip


def test_a_name_with_brackets_is_a_glob_too():
    assert choose(["a[1]"], ["a1", "a[1]", "b1"]) == ("a1", "a[1]")
    assert choose(["a[[]1]"], ["a1", "a[1]", "b1"]) == ("a[1]",)


class TestInputErrors:
    def test_truth_without_edges(self, truth):
        bare = truth.replaced(edges=None)
        with pytest.raises(InputError, match=r"^x.h5: has no edges.*add the dataset `edges`"):
            check_examples(2, bare, [Path("x.h5")])
        check_examples(0, bare, [Path("x.h5")])
        check_examples((), bare, [Path("x.h5")])
        check_examples(2, truth, [Path("x.h5")])

    def test_no_such_item(self):
        with pytest.raises(InputError, match=r"'wolk/02'; .*nearest are walk/02"):
            choose(["wolk/02"], ITEMS)

    def test_no_common_image(self):
        with pytest.raises(InputError, match="no image has the truth and a shape of every method"):
            choose(3, [])

    def test_more_than_a_picture_shows(self):
        with pytest.raises(InputError, match=r"21 images fit: i00, .*name at most 20"):
            choose(["i*"], [f"i{n:02d}" for n in range(21)])

    def test_no_observed_landmarks(self, truth, turned):
        bare = lifted(turned.replaced(further={}), truth, "table.csv")
        with pytest.raises(InputError, match=r"table.csv: has no dataset 'landmarks'"):
            examples_picture(1, {"m": [bare]}, truth)
