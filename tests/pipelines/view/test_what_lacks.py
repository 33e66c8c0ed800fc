"""A page says what its files lack, and shows the rest; what cannot be shown is refused."""

from pathlib import Path

import numpy as np
import pytest

from shapefit.config import ViewConfig
from shapefit.errors import InputError
from shapefit.io import write_dictionary
from shapefit.pipelines.view.run import make_page, run


def test_a_result_with_all_it_needs_says_nothing(desk):
    edges = np.array([[0, 1], [1, 2]])
    made = desk.view(desk.result(), truth=(desk.truth(edges=edges),))
    assert made.notes == "Aligned with result by the best similarity: truth."
    assert made.data["edges"] == edges.tolist()
    assert [layer["name"] for layer in made.data["layers"]] == ["result", "truth"]
    assert made.outcome.done == 6


def test_without_observed_landmarks(desk):
    made = desk.view(desk.result(extras={}))
    assert "no observed landmarks; add the landmark file" in made.notes
    assert made.data["seen"] is None
    assert made.data["flat"]


@pytest.mark.parametrize(
    "frame",
    [np.arange(5.0), np.array(3.0), np.full(6, "first", dtype=object), np.zeros((6, 2))],
    ids=["other rows", "one", "text", "pairs"],
)
def test_numbers_of_frames_that_are_not_one_per_item_are_left_out(desk, frame):
    assert desk.view(desk.result(extras={"frame": frame})).data["seen"] is None


def test_the_landmark_file_gives_the_observed_landmarks(desk):
    made = desk.view(desk.result(extras={}), desk.landmarks())
    assert "observed" not in made.notes
    assert made.data["seen"]["shape"] == [6, 5, 2]


def test_without_edges(desk):
    assert "No edges are known" in desk.view(desk.result()).notes


def test_edges_that_the_result_carries(desk):
    extras = {"edges": np.array([[0, 4]])}
    assert desk.view(desk.result(extras=extras)).data["edges"] == [[0, 4]]


def test_failed_items_are_counted_and_have_no_number(desk):
    shapes = desk.shapes(6)
    shapes[[1, 4]] = np.nan
    made = desk.view(desk.result(shapes=shapes))
    assert "result has no shape of 2 frames" in made.notes
    assert len(made.data["items"]) == 6
    assert "no shape of 6 frames" in desk.view(desk.result(shapes=np.nan * shapes)).notes


def test_landmarks_alone(desk):
    made = desk.view(desk.landmarks())
    assert "nothing in 3D" in made.notes
    assert made.data["layers"] == []


def test_shapes_alone_have_no_image(desk):
    made = desk.view(desk.truth(edges=np.array([[0, 1]])))
    assert (made.data["flat"], made.notes) == (False, "")


def test_csv_shows_points(desk):
    rows = [f"i{i},{name},{i},{j},1" for i in range(3) for j, name in enumerate("abc")]
    csv = desk.folder / "points.csv"
    csv.write_text("\n".join(["item,landmark,x,y,z", *rows]), encoding="utf-8")
    made = desk.view(csv)
    assert [layer["role"] for layer in made.data["layers"]] == ["result"]


def test_a_dictionary_that_is_gone_or_changed_is_named(desk):
    gone = '{"dictionary": "/nowhere/dict.h5"}'
    made = desk.view(desk.result(attributes={"config": gone}))
    assert "its dictionary dict.h5 no longer exists; -d DICT.h5 names another" in made.notes
    changed = desk.truth()
    made = desk.view(desk.result(attributes={"config": f'{{"dictionary": "{changed}"}}'}))
    assert "has changed since the fit" in made.notes


def test_frames_that_only_one_result_has(desk):
    one = desk.result("one.h5", n=2)
    other = desk.result("other.h5", n=3, items=("i1", "i2", "i3"))
    made = desk.view(one, other)
    assert made.data["items"] == ["i0", "i1", "i2", "i3"]
    assert "one has no shape of 2 frames" in made.notes


def test_landmarks_are_matched_by_name(desk):
    shapes = desk.shapes(2)
    one = desk.result("one.h5", n=2, shapes=shapes)
    order = [3, 0, 4]
    names = ("d", "a", "e")
    other = desk.result("other.h5", n=2, shapes=shapes[:, :, order], landmark_names=names)
    made = desk.view(one, other)
    assert made.data["landmarks"] == list("abcde")
    first, second = (layer["points"] for layer in made.data["layers"])
    assert first["shape"] == second["shape"] == [2, 5, 3]


@pytest.fixture
def parts(desk):
    """Results of 100 images in ten parts."""
    return tuple(
        desk.result(
            f"part-{part}.h5", n=10, items=tuple(f"i{n}" for n in range(10 * part, 10 * part + 10))
        )
        for part in range(10)
    )


def test_parts_are_one_result(parts):
    page = make_page(ViewConfig(files={"fit": parts, "two": parts[::-1]}))
    assert page.scene.items == tuple(f"i{n}" for n in range(100))
    for layer in page.scene.layers:
        assert np.isfinite(layer.points).all()
    page = make_page(ViewConfig(files={"fit": parts}, items=("i1?",)))
    assert page.scene.items == tuple(f"i{n}" for n in range(10, 20))


def test_files_that_cannot_be_read_are_named_and_the_others_shown(parts, tmp_path):
    for part in parts[1:3]:
        part.write_bytes(part.read_bytes()[:1000])
    (outcome,) = run(ViewConfig(files={"fit": parts}, output=tmp_path / "page.html"))
    assert [failure.item for failure in outcome.failures] == [str(part) for part in parts[1:3]]
    assert outcome.done == 80
    with pytest.raises(InputError, match="part-1") as found:
        make_page(ViewConfig(files={"fit": parts, "two": parts[1:3]}))
    assert len(found.value.problems) == 2


def refused(desk, *files, **settings):
    with pytest.raises(InputError) as error:
        desk.view(*files, **settings)
    assert not (desk.folder / "page.html").exists()
    return str(error.value)


def test_what_cannot_be_shown_is_refused(desk, made_dictionary):
    path = desk.folder / "dict.h5"
    write_dictionary(path, made_dictionary)
    result, up = desk.result(), desk.result("up.h5", y_axis="up")
    assert "items: no item of" in refused(desk, result, items=("x*",))
    assert "y_axis is 'up'" in refused(desk, result, up)
    assert "is a shapefit-dictionary file; give results, shapes" in refused(desk, path)
    assert "/dev/zero:1: " in refused(desk, Path("/dev/zero"))
    found = refused(desk, result, truth=(desk.truth(),), match="true_model")
    assert "match: no result has the dataset 'true_model'" in found
    truth = desk.truth(items=tuple("uvwxyz"))
    found = refused(desk, result, truth=(truth,))
    assert "truth: has none of the 6 items, such as 'i0'" in found
    assert "holds no images" in refused(desk, desk.result(n=0))


def test_two_files_of_one_name_with_the_same_item(desk):
    files = (desk.result("one.h5"), desk.result("two.h5"))
    with pytest.raises(InputError, match=r"has the item 'i0', which .*one.h5 has too"):
        list(run(ViewConfig(files={"both": files}, output=desk.folder / "page.html")))


def test_a_page_that_would_replace_its_input(desk):
    result = desk.result()
    with pytest.raises(ValueError, match="would replace an input"):
        ViewConfig(files={"result": (result,)}, output=result)


def test_a_terminal_and_a_folder_are_no_place_for_a_page(desk):
    result = desk.result()
    for output, found in (("-", "not written to a terminal"), (desk.folder, "it is a folder")):
        with pytest.raises(InputError, match=found):
            list(run(ViewConfig(files={"result": (result,)}, output=output)))


def test_images_that_are_not_there_or_no_images(desk, rng):
    result = desk.result()
    assert "there is no folder" in refused(desk, result, images=desk.folder / "none")
    images = desk.folder / "images"
    images.mkdir()
    assert "no item has an image, such as" in refused(desk, result, images=images)
    (images / "i0.png").write_bytes(rng.bytes(100))
    assert "i0.png: cannot be read as an image" in refused(desk, result, images=images)


def test_an_old_page_survives_a_refusal(desk):
    desk.view(desk.result())
    before = (desk.folder / "page.html").read_bytes()
    with pytest.raises(InputError):
        desk.view(desk.result(n=0))
    assert (desk.folder / "page.html").read_bytes() == before
