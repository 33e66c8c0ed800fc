"""What cannot be shown is refused with the place and the fix, and nothing is written."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest

from shapefit.config import ViewConfig
from shapefit.errors import InputError
from shapefit.io import write_dictionary
from shapefit.pipelines.view.run import run


def refused(desk, *files, **settings):
    with pytest.raises(InputError) as error:
        desk.view(*files, **settings)
    assert not (desk.folder / "page.html").exists()
    return str(error.value)


def test_no_images(desk):
    assert "holds no images" in refused(desk, desk.result(n=0))


def test_no_item_fits(desk):
    assert "items: no item of" in refused(desk, desk.result(), items=("x*",))


def test_a_truth_of_other_items(desk):
    truth = desk.truth(items=tuple("uvwxyz"))
    assert "truth: has none of the 6 items, such as 'i0'" in refused(
        desk, desk.result(), truth=(truth,)
    )


def test_a_match_that_no_result_has(desk):
    found = refused(desk, desk.result(), truth=(desk.truth(),), match="true_model")
    assert "match: no result has the dataset 'true_model'" in found


def test_y_axes_that_differ(desk):
    up = desk.result("up.h5", y_axis="up")
    assert "y_axis is 'up'" in refused(desk, desk.result(), up)


def test_a_dictionary_is_not_shown(desk, made_dictionary):
    path = desk.folder / "dict.h5"
    write_dictionary(path, made_dictionary)
    assert "is a shapefit-dictionary file; give results, shapes or landmarks" in refused(desk, path)


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


def test_damaged_files_are_named(desk):
    path = desk.result()
    path.write_bytes(path.read_bytes()[:2000])
    assert "result.h5: cannot be read" in refused(desk, path)


@pytest.mark.parametrize("form", [h5py.Empty("f8"), np.zeros((2, 2)), [1, 2], 3.0])
def test_a_format_that_is_no_text(desk, form):
    path = desk.result()
    with h5py.File(path, "r+") as file:
        file.attrs["format"] = form
    assert "result.h5: has a format that is no text; give one of" in refused(desk, path)


def test_a_table_without_end(desk):
    assert "/dev/zero:1: is not text (a zero byte)" in refused(desk, Path("/dev/zero"))


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
