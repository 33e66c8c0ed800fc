"""What a page says of what its files lack, and what it refuses."""

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from shapefit.config import ViewConfig
from shapefit.errors import InputError
from shapefit.io import write_dictionary
from shapefit.pipelines.view.run import write_page as run
from shapefit.pipelines.view.scene import make_scene
from tests.pipelines.view.conftest import write_truth


def layer_names(made):
    return [layer["name"] for layer in made.data["layers"]]


def test_a_result_with_all_it_needs_says_nothing(desk):
    edges = np.array([[0, 1], [1, 2]])
    made = desk.view(desk.result(), truth=(desk.truth(edges=edges),))
    assert made.notes == ""
    assert made.data["edges"] == edges.tolist()
    assert layer_names(made) == ["result", "truth"]
    assert made.outcome.done == 6


LACKS = [
    ({"extras": {}}, "no observed landmarks; add the landmark file"),
    ({}, "No edges are known"),
]
"""Fields of a result, and what its page says."""


@pytest.mark.parametrize(("fields", "note"), LACKS)
def test_a_page_says_what_it_lacks(desk, fields, note):
    made = desk.view(desk.result(**fields))
    assert note in made.notes
    assert len(made.data["items"]) == 6
    assert made.data["flat"] is True


def test_edges_of_a_result_are_shown(desk):
    edges = np.array([[0, 4]])
    made = desk.view(desk.result(extras={"edges": edges}))
    assert made.data["edges"] == edges.tolist()


OF_DICTIONARY = [[0, 1]]
OF_TRUTH = [[1, 2]]
OF_SHAPES = [[2, 3]]
OF_RESULT = [[3, 4]]


@pytest.fixture
def with_edges(desk):
    """Return what views a result with others, each with edges of its own."""
    result = desk.result(extras={"edges": np.array(OF_RESULT)})
    shapes = write_truth(
        desk.folder / "shapes.h5", desk.shapes(6), edges=np.array(OF_SHAPES)
    )
    truth = desk.truth(edges=np.array(OF_TRUTH))

    def edges_with(*, shapes_too=False, truth_too=False, **settings):
        files = [result, shapes] if shapes_too else [result]
        if truth_too:
            settings["truth"] = (truth,)
        return desk.scene(*files, **settings)["edges"]

    return edges_with


def test_edges_are_of_the_dictionary_before_the_truth_before_shapes(
    with_edges, dictionary_file
):
    assert with_edges() == OF_RESULT
    assert with_edges(shapes_too=True) == OF_SHAPES
    assert with_edges(truth_too=True) == OF_TRUTH
    assert with_edges(shapes_too=True, truth_too=True) == OF_TRUTH
    assert with_edges(truth_too=True, dictionary=dictionary_file) == OF_DICTIONARY
    assert with_edges(shapes_too=True, dictionary=dictionary_file) == OF_DICTIONARY


def test_edges_to_landmarks_that_are_not_shown_are_left_out(desk):
    """The result has neither d nor e."""
    truth = desk.truth(edges=np.array([[0, 1], [3, 4], [2, 3]]))
    result = desk.result(landmark_names=("a", "b", "c", "y", "z"))
    assert desk.scene(result, truth=(truth,))["edges"] == [[0, 1]]


def test_a_file_of_landmarks_has_what_was_observed(desk):
    made = desk.view(desk.result(extras={}), desk.landmarks())
    assert "observed" not in made.notes
    assert made.data["observed"]["shape"] == [6, 5, 2]


def test_landmarks_alone_have_no_layers(desk):
    assert desk.view(desk.landmarks()).data["layers"] == []


def test_shapes_alone_lack_nothing(desk):
    made = desk.view(desk.truth(edges=np.array([[4, 0]])))
    assert made.data["flat"] is False
    assert made.notes == ""


def test_shapes_of_other_landmarks_are_not_shown(desk):
    truth = desk.truth(landmark_names=["a", "b", "x", "y", "z"])
    made = desk.view(desk.result(), truth)
    reason = "as result has fewer than 3 landmarks of the same names: truth."
    assert f"Not shown, {reason}" in made.notes
    assert layer_names(made) == ["result"]


def test_shapes_of_three_of_the_landmarks_are_shown(desk):
    truth = desk.truth(landmark_names=["a", "b", "c", "y", "z"])
    made = desk.view(desk.result(), truth)
    assert layer_names(made) == ["result", "truth"]


BONES = [
    (
        ("RHip", "RKnee", "RAnkle", "Neck", "C7"),
        {("RHip", "RKnee"), ("RKnee", "RAnkle")},
    ),
    (
        ("SpineF", "SpineM", "SpineL", "HipL", "tail"),
        {("SpineF", "SpineM"), ("SpineM", "SpineL"), ("SpineL", "HipL")},
    ),
    (("RHip", "x", "y", "z", "SpineM"), set()),
]
"""Names of landmarks, and the pairs that are joined."""


@pytest.fixture
def dictionary_file(desk, made_dictionary):
    path = desk.folder / "dict.h5"
    write_dictionary(path, made_dictionary)
    return path


@pytest.mark.parametrize(("names", "joined"), BONES)
def test_bones_are_known_by_most_of_the_names(desk, dictionary_file, names, joined):
    """Also where those of the dictionary join none of the landmarks that are shown."""
    result = desk.result(landmark_names=names)
    made = desk.view(result, dictionary=dictionary_file)
    bones = {(names[a], names[b]) for a, b in made.data["edges"]}
    assert bones - {("RHip", "Neck")} == joined
    assert ("No edges are known" in made.notes) == (not joined)


OTHER_ITEMS = "No shape matches the landmarks"


def test_landmarks_of_other_items_than_the_shapes_are_warned_of(desk):
    made = desk.view(desk.result(), desk.landmarks(items=tuple("uvwxyz")))
    assert OTHER_ITEMS in made.notes


def test_landmarks_of_the_items_of_the_shapes_are_not_warned_of(desk):
    made = desk.view(desk.result(), desk.landmarks())
    assert OTHER_ITEMS not in made.notes


def test_items_of_several_results_are_matched_by_name(desk):
    one = desk.result("one.h5", n=2)
    other = desk.result("other.h5", n=3, items=("i1", "i2", "i3"))
    made = desk.view(one, other)
    assert made.data["items"] == ["i0", "i1", "i2", "i3"]


def test_landmarks_of_several_results_are_matched_by_name(desk):
    shapes = desk.shapes(2)
    one = desk.result("one.h5", n=2, shapes=shapes)
    columns = [3, 0, 4]
    other = desk.result(
        "other.h5", n=2, shapes=shapes[:, :, columns], landmark_names=("d", "a", "e")
    )
    page = desk.scene(one, other)
    first, second = (layer["points"] for layer in page["layers"])
    shared = sorted(columns)
    assert page["landmarks"] == tuple("abcde")
    assert_array_equal(second[:, :, shared], first[:, :, shared])
    assert np.isnan(second[:, :, [1, 2]]).all()


def item_names(start, stop):
    return tuple(f"i{number}" for number in range(start, stop))


@pytest.fixture
def parts(desk):
    """Results of 100 images in ten parts."""
    files = []
    for part in range(10):
        items = item_names(10 * part, 10 * part + 10)
        files.append(desk.result(f"part-{part}.h5", n=10, items=items))
    return tuple(files)


def test_parts_are_one_result(parts):
    page = make_scene(ViewConfig(files={"fit": parts, "two": parts[::-1]}))
    assert page["items"] == item_names(0, 100)
    for layer in page["layers"]:
        assert np.isfinite(layer["points"]).all()


def test_items_of_parts_are_chosen(parts):
    page = make_scene(ViewConfig(files={"fit": parts}, items=("i1?",)))
    assert page["items"] == item_names(10, 20)


def test_a_damaged_part_is_named(parts):
    damaged = parts[1].read_bytes()[:1000]
    parts[1].write_bytes(damaged)
    with pytest.raises(InputError, match="part-1"):
        make_scene(ViewConfig(files={"fit": parts}))


def refused(desk, *files, **settings):
    """Return the error of a page that cannot be made."""
    with pytest.raises(InputError) as error:
        desk.view(*files, **settings)
    assert not (desk.folder / "page.html").exists()
    return str(error.value)


def test_atoms_of_a_dictionary_are_shown_as_shapes(
    desk, made_dictionary, dictionary_file
):
    scene = desk.scene(dictionary_file)
    (layer,) = scene["layers"]
    assert layer["role"] == "shapes"
    assert len(scene["items"]) == made_dictionary.k


def test_what_is_no_file_is_refused(desk):
    assert "/dev/zero:1: " in refused(desk, Path("/dev/zero"))


def test_a_truth_by_a_dataset_that_is_not_there_is_refused(desk):
    told = refused(desk, desk.result(), truth=(desk.truth(),), match="true_model")
    assert "there is no dataset 'true_model' with one name per image" in told


def test_a_truth_of_other_items_is_refused(desk):
    truth = desk.truth(items=tuple("uvwxyz"))
    told = refused(desk, desk.result(), truth=(truth,))
    fault = "none of its 6 images is in the truth, which has no 'i0'; give the truth"
    assert fault in told


def test_a_result_without_images_is_refused(desk):
    assert "no item fits, or there are none" in refused(desk, desk.result(n=0))


BROKEN_SETTINGS = {
    "a terminal": ({"output": "-"}, "not written to a terminal"),
    "a folder": ({"output": "."}, "it is a folder"),
    "no folder": ({"images": "none"}, "there is no folder"),
    "no images": ({"images": "images"}, "no item has an image, such as"),
    "broken": ({"images": "broken"}, "no photograph can be read, such as i0.png"),
    "no item": ({"items": ("x*",)}, "no item fits"),
}
"""Settings, and what is said."""


@pytest.mark.parametrize(
    ("settings", "fault"), BROKEN_SETTINGS.values(), ids=BROKEN_SETTINGS
)
def test_a_page_that_cannot_be_leaves_the_old_one(
    desk, rng, monkeypatch, settings, fault
):
    monkeypatch.chdir(desk.folder)
    page = desk.folder / "page.html"
    result = desk.result()
    desk.view(result)
    before = page.read_bytes()
    (desk.folder / "images").mkdir()
    (desk.folder / "broken").mkdir()
    (desk.folder / "broken/i0.png").write_bytes(rng.bytes(100))
    usual = {"files": {"r": (result,)}, "output": page}
    with pytest.raises(InputError, match=fault):
        list(run(ViewConfig(**usual | settings)))
    assert page.read_bytes() == before


def test_a_page_replaces_none_of_its_inputs(desk):
    result = desk.result()
    with pytest.raises(ValueError, match="would replace an input"):
        ViewConfig(files={"result": (result,)}, output=result)
