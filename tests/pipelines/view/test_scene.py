"""Sides, recordings, and what a page says of what its files lack; what is refused."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from shapefit.config import ViewConfig
from shapefit.errors import InputError
from shapefit.io import read_shapes, write_dictionary
from shapefit.io.skeletons import installed_skeletons
from shapefit.pipelines.view.reading import Frames
from shapefit.pipelines.view.run import write_page as run
from shapefit.pipelines.view.scene import find_recordings, find_sides, make_scene
from tests.io.files import mirror_pairs
from tests.pipelines.view.conftest import write_truth


def test_names_of_other_files():
    names = [
        "nose",
        "L_ear",
        "R_ear",
        "HipLeft",
        "HipRight",
        "left",
        "lone",
        "left_toe",
        "HEAD",
    ]
    assert find_sides(names) == [0, 1, 2, 1, 2, 0, 0, 0, 0]
    rat = ["HeadL", "SpineL", "HipL", "KneeL", "HipR", "KneeR", "XL"]
    assert find_sides(rat) == [0, 0, 1, 1, 2, 2, 0]


@pytest.mark.parametrize("name", installed_skeletons())
def test_the_pairs_of_detectors(name):
    skeleton = installed_skeletons()[name]
    sides = np.array(find_sides(skeleton.landmark_names))
    right, left = np.array(mirror_pairs(skeleton)).T
    assert (sides[right] == 2).all()
    assert (sides[left] == 1).all()
    assert np.count_nonzero(sides) == 2 * len(left)


def frames_of(numbers, **groups):
    starts = np.cumsum([0, *map(len, groups.values())]).tolist()
    sequences = tuple(
        zip([name.replace("_", "/") for name in groups], starts, strict=False)
    )
    items = tuple("".join(groups.values()))
    numbers = (
        np.full(len(items), np.nan) if numbers is None else np.array(numbers, float)
    )
    return Frames(items, sequences, 1, numbers)


@pytest.mark.parametrize(
    ("groups", "numbers", "expected"),
    [
        ({"v_1": "abc", "v_2": "de"}, [7, 8, 9, 8, 9], ([[0, 1]], [0, 1, 2, 1, 2])),
        ({"v_1": "abc", "v_2": "de"}, None, ([[0], [1]], [0, 1, 2, 0, 1])),
        (
            {"v_1": "abc", "v_2": "de"},
            [7, 8, np.nan, 8, 9],
            ([[1], [0]], [0, 1, 2, 0, 1]),
        ),
        ({"v_1": "abc", "v_2": "de"}, [1, 2, 3, 4, 5], ([[0], [1]], [0, 1, 2, 0, 1])),
        ({"v_1": "abc", "w_1": "de"}, [7, 8, 9, 8, 9], ([[0], [1]], [0, 1, 2, 0, 1])),
        (
            {"v_1": "ab", "w_1": "c", "v_2": "de"},
            [7, 9, 7, 8, 9],
            ([[0, 2], [1]], [0, 2, 0, 1, 2]),
        ),
    ],
)
def test_individuals_of_a_video_are_seen_at_once(groups, numbers, expected):
    content = SimpleNamespace(role="result", name="r")
    recordings, times = find_recordings([content], frames_of(numbers, **groups))
    assert sorted(recordings) == sorted(expected[0])
    assert times.tolist() == expected[1]


@pytest.mark.parametrize(
    ("files", "recordings", "times"),
    [(2, [[0, 1]], [0, 1, 1, 2]), (1, [[0], [1]], [0, 1, 0, 1])],
)
def test_files_of_one_individual_each_are_seen_at_once(files, recordings, times):
    found = find_recordings(
        [SimpleNamespace(role="shapes")] * files,
        frames_of([0, 1, 1, 2], anna="ab", ben="cd"),
    )
    assert found[0] == recordings
    assert found[1].tolist() == times


@pytest.mark.parametrize(
    ("numbers", "step", "times"),
    [
        ([4, 5, 9, 10], 1, [0, 1, 5, 6]),
        ([4, 6, 8, 14], 2, [0, 1, 2, 5]),
        ([4, 7, 8, 13], 2, [0, 1, 2, 4]),  # every second of those that are there
        ([0, 1, 2, 10**9], 1, [0, 1, 2, 3]),  # no numbers of frames
        (None, 1, [0, 1, 2, 3]),
    ],
)
def test_missing_frames_are_gaps_on_the_page(numbers, step, times):
    frames = frames_of(numbers, walk="abcd")._replace(step=step)
    assert find_recordings([], frames)[1].tolist() == times


def test_a_page_plays_at_the_true_times(desk):
    extras = {"frame": np.array([0, 1, 2, 60, 61, 62])}
    page = desk.scene(desk.result(sequences=("v",) * 6, extras=extras), frame_rate=30.0)
    assert page["times"].tolist() == [0, 1, 2, 60, 61, 62]
    assert [fact["text"] for fact in page["facts"]][:2] == ["6 frames", "30 Hz"]


def test_a_result_with_all_it_needs_says_nothing(desk):
    edges = np.array([[0, 1], [1, 2]])
    made = desk.view(desk.result(), truth=(desk.truth(edges=edges),))
    assert made.notes == ""
    assert made.data["edges"] == edges.tolist()
    assert [layer["name"] for layer in made.data["layers"]] == ["result", "truth"]
    assert made.outcome.done == 6


def test_a_page_says_what_it_lacks(desk):
    edges = np.array([[0, 4]])
    truth = desk.truth(edges=edges[:, ::-1])
    for fields, lacks in (
        ({"extras": {}}, "no observed landmarks; add the landmark file"),
        ({}, "No edges are known"),
    ):
        made = desk.view(desk.result(**fields))
        assert lacks in made.notes
        assert len(made.data["items"]) == 6
        assert made.data["flat"]
    made = desk.view(desk.result(extras={"edges": edges}))
    assert made.data["edges"] == edges.tolist()
    made = desk.view(desk.result(extras={}), desk.landmarks())
    assert "observed" not in made.notes
    assert made.data["observed"]["shape"] == [6, 5, 2]
    made = desk.view(desk.landmarks())
    assert made.data["layers"] == []
    made = desk.view(truth)
    assert not made.data["flat"]
    assert made.notes == ""


def test_shapes_of_other_landmarks_are_not_shown(desk):
    truth = desk.truth(landmark_names=["a", "b", "x", "y", "z"])
    made = desk.view(desk.result(), truth)
    assert (
        "Not shown, as result has fewer than 3 landmarks of the same names: truth."
        in made.notes
    )
    assert [layer["name"] for layer in made.data["layers"]] == ["result"]
    made = desk.view(
        desk.result(), desk.truth(landmark_names=["a", "b", "c", "y", "z"])
    )
    assert [layer["name"] for layer in made.data["layers"]] == ["result", "truth"]


@pytest.mark.parametrize(
    ("names", "joined"),
    [
        (
            ("RHip", "RKnee", "RAnkle", "Neck", "C7"),
            {("RHip", "RKnee"), ("RKnee", "RAnkle")},
        ),
        (
            ("SpineF", "SpineM", "SpineL", "HipL", "tail"),
            {("SpineF", "SpineM"), ("SpineM", "SpineL"), ("SpineL", "HipL")},
        ),
        (("RHip", "x", "y", "z", "SpineM"), set()),
    ],
)
def test_bones_are_known_by_most_of_the_names(desk, made_dictionary, names, joined):
    """Also where those of the dictionary join none of the landmarks that are shown."""
    path = desk.folder / "dict.h5"
    write_dictionary(path, made_dictionary)
    made = desk.view(desk.result(landmark_names=names), dictionary=path)
    shown = {(names[a], names[b]) for a, b in made.data["edges"]}
    assert shown - {("RHip", "Neck")} == joined
    assert ("No edges are known" in made.notes) == (not joined)


def test_landmarks_of_other_items_than_the_shapes_are_warned_of(desk):
    result, text = desk.result(), "No shape matches the landmarks"
    assert text not in desk.view(result, desk.landmarks()).notes
    assert text in desk.view(result, desk.landmarks(items=tuple("uvwxyz"))).notes


def test_items_and_landmarks_of_several_results_are_matched_by_name(desk):
    shapes = desk.shapes(2)
    one = desk.result("one.h5", n=2, shapes=shapes)
    other = desk.result("other.h5", n=3, items=("i1", "i2", "i3"))
    made = desk.view(one, other)
    assert made.data["items"] == ["i0", "i1", "i2", "i3"]
    names = ("d", "a", "e")
    other = desk.result(
        "other.h5", n=2, shapes=shapes[:, :, [3, 0, 4]], landmark_names=names
    )
    page = desk.scene(one, other)
    assert page["landmarks"] == tuple("abcde")
    first, second = (layer["points"] for layer in page["layers"])
    np.testing.assert_array_equal(second[:, :, [0, 3, 4]], first[:, :, [0, 3, 4]])
    assert np.isnan(second[:, :, 1:3]).all()


@pytest.fixture
def parts(desk):
    """Results of 100 images in ten parts."""
    return tuple(
        desk.result(
            f"part-{part}.h5",
            n=10,
            items=tuple(f"i{n}" for n in range(10 * part, 10 * part + 10)),
        )
        for part in range(10)
    )


def test_parts_are_one_result(parts):
    page = make_scene(ViewConfig(files={"fit": parts, "two": parts[::-1]}))
    assert page["items"] == tuple(f"i{n}" for n in range(100))
    for layer in page["layers"]:
        assert np.isfinite(layer["points"]).all()
    page = make_scene(ViewConfig(files={"fit": parts}, items=("i1?",)))
    assert page["items"] == tuple(f"i{n}" for n in range(10, 20))
    parts[1].write_bytes(parts[1].read_bytes()[:1000])
    with pytest.raises(InputError, match="part-1"):
        make_scene(ViewConfig(files={"fit": parts}))


def refused(desk, *files, **settings):
    with pytest.raises(InputError) as error:
        desk.view(*files, **settings)
    assert not (desk.folder / "page.html").exists()
    return str(error.value)


def test_atoms_of_a_dictionary_are_shown_as_shapes(desk, made_dictionary):
    path = desk.folder / "dict.h5"
    write_dictionary(path, made_dictionary)
    scene = desk.scene(path)
    assert [layer["role"] for layer in scene["layers"]] == ["shapes"]
    assert len(scene["items"]) == made_dictionary.k


def test_what_cannot_be_shown_is_refused(desk, made_dictionary):
    path = desk.folder / "dict.h5"
    write_dictionary(path, made_dictionary)
    result = desk.result()
    assert "/dev/zero:1: " in refused(desk, Path("/dev/zero"))
    found = refused(desk, result, truth=(desk.truth(),), match="true_model")
    assert "there is no dataset 'true_model' with one name per image" in found
    truth = desk.truth(items=tuple("uvwxyz"))
    found = refused(desk, result, truth=(truth,))
    assert (
        "none of its 6 images is in the truth, which has no 'i0'; give the truth"
        in found
    )
    assert "no item fits, or there are none" in refused(desk, desk.result(n=0))


def shapes_file(desk, name, n, **fields):
    items = tuple(f"{name}/{number}" for number in range(n))
    path = desk.folder / f"{name}.h5"
    return write_truth(
        path, desk.shapes(n), items=items, sequences=(name,) * n, **fields
    )


def test_files_of_one_recording_are_individuals_of_one_layer(desk):
    names = ("rhip", "rknee", "rankle", "lhip", "head")
    how = {"landmark_names": names, "unit": "m", "frame_rate": 25.0}
    anna = shapes_file(desk, "man_anna", 4, frames=np.arange(4), **how)
    emil = shapes_file(desk, "man_emil", 3, frames=np.arange(3) + 1, **how)
    page = desk.scene(anna, emil)
    (layer,) = page["layers"]
    assert page["recordings"] == [[0, 1]]
    assert layer["name"] == "man_anna, man_emil"
    expected = np.concatenate(
        [read_shapes([path]).as_columns() for path in (anna, emil)]
    )
    np.testing.assert_allclose(layer["points"], expected)
    (angle,) = [m for m in layer["measures"] if m["name"] == "knee angle r"]
    assert np.isfinite(angle["values"]).all()
    assert np.ptp(angle["values"]) > 0


def test_files_with_and_without_frames_are_not_one_recording(desk):
    """A file whose frames nobody numbered is alone, whatever its place."""
    first = shapes_file(desk, "first", 3, frames=np.arange(3))
    second = shapes_file(desk, "second", 3)
    assert desk.scene(first, second)["recordings"] == [[0], [1]]
    assert desk.scene(second, first)["recordings"] == [[0], [1]]


def test_a_page_that_cannot_be_leaves_the_old_one(desk, rng):
    result = desk.result()
    images = desk.folder / "images"
    desk.view(result)
    page = desk.folder / "page.html"
    before = page.read_bytes()
    images.mkdir()
    (desk.folder / "broken").mkdir()
    (desk.folder / "broken/i0.png").write_bytes(rng.bytes(100))
    for settings, found in (
        ({"output": "-"}, "not written to a terminal"),
        ({"output": desk.folder}, "it is a folder"),
        ({"images": desk.folder / "none"}, "there is no folder"),
        ({"images": images}, "no item has an image, such as"),
        (
            {"images": desk.folder / "broken"},
            "no photograph can be read, such as i0.png",
        ),
        ({"items": ("x*",)}, "no item fits"),
    ):
        with pytest.raises(InputError, match=found):
            list(
                run(
                    ViewConfig(
                        **({"files": {"r": (result,)}, "output": page} | settings)
                    )
                )
            )
        assert page.read_bytes() == before
    with pytest.raises(ValueError, match="would replace an input"):
        ViewConfig(files={"result": (result,)}, output=result)
