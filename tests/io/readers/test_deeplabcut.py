"""Tables of DeepLabCut, as they are spelled."""

import h5py
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tests.io.readers import made
from tests.io.readers.made import read_images


@pytest.fixture
def labels(tmp_path, points, confidence):
    """A table of labelled images."""
    path = tmp_path / "labels.h5"
    made.write_deeplabcut_fixed(path, points, confidence)
    return path


def test_labels_of_images(labels, read):
    assert read(labels).items[1] == "labels/animal0/img00001"


def test_a_folder_of_labelled_images_is_a_video(labels, read):
    images = [f"labeled/a/img{number}.png" for number in range(6)]
    images.append("labeled/b/img4.png")
    with h5py.File(labels, "a") as file:
        del file["df_with_missing/axis1"]
        file["df_with_missing/axis1"] = np.array(images, "S")
    items = [item for item in read(labels).items if item.startswith("labels/b")]
    assert items == ["labels/b/animal0/img4", "labels/b/animal1/img4"]


CSV = """scorer,,,me,me,me,me
bodyparts,,,nose,nose,tail,tail
coords,,,x,y,x,y
labeled-data,video,img1.png,1,2,3,4
labeled-data,video,img2.png,,,5,6
labeled-data,video,img3.png,7,8
"""


def test_paths_in_three_columns_and_rows_that_end_early(tmp_path, read):
    path = tmp_path / "labels.csv"
    path.write_text(CSV)
    images = read(path)
    missing = np.isnan(images.landmarks[..., 0])
    assert images.items == ("labels/img1", "labels/img2", "labels/img3")
    assert missing.tolist() == [[False, False], [True, False], [False, True]]
    assert images.confidence is None


DRESSES = [
    ("\n", "\r\n"),
    ("scorer", "\ufeffscorer"),
    (",", " , "),
    ("12.5", '"12.5"'),
    (",,,", ",nan,NA,"),
    ("12.5", "1.25e1"),
    ("4,\n", "4,\n\n\n"),
]
"""What is replaced in PLAIN, and by what."""


UNSEEN = [np.nan, np.nan]


POINTS_OF_PLAIN = [
    [[12.5, -3], [0.001, 2]],
    [UNSEEN, [5, 6]],
    [[1, 2], [3, 4]],
]


PLAIN = """scorer,net,net,net,net,net,net
bodyparts,a,a,a,b,b,b
coords,x,y,likelihood,x,y,likelihood
42150,12.5,-3,0.5,1e-3,2,1
42151,,,,5,6,0.25
42153,1,2,1,3,4,
"""


@pytest.mark.parametrize(("old", "new"), DRESSES)
def test_csv_is_read_in_every_dress(tmp_path, read, old, new):
    path = tmp_path / "p.csv"
    path.write_bytes(PLAIN.replace(old, new).encode())
    images = read(path)
    assert images.items == ("p/42150", "p/42151", "p/42153")
    assert_array_equal(images.landmarks, POINTS_OF_PLAIN)
    assert images.confidence.tolist() == [[0.5, 1], [0, 0.25], [1, 1]]


OF_INDIVIDUALS = """\
scorer,n,n,n,n,n,n
individuals,one,one,one,one,single,single
bodyparts,a,a,b,b,c,c
coords,x,y,x,y,x,y
0,1,2,3,4,5,6
"""


def test_a_landmark_that_an_individual_lacks_is_unseen(tmp_path, read):
    path = tmp_path / "t.csv"
    path.write_text(OF_INDIVIDUALS)
    one, single = read(path).landmarks
    assert_array_equal(one, [[1, 2], [3, 4], UNSEEN])
    assert_array_equal(single, [UNSEEN, UNSEEN, [5, 6]])


OF_AN_ENSEMBLE = """\
scorer,n,n,n,n,n
bodyparts,a,a,a,a,a
coords,x,y,likelihood,x_ens_var,y_ens_var
0,1,2,0.5,9,9
1,-1,-1,-1,9,9
2,3,4,1,9,9
3,7,8,-1,9,9
"""
"""Newer versions write -1 for what they did not find."""


@pytest.fixture
def of_an_ensemble(tmp_path):
    path = tmp_path / "t.csv"
    path.write_text(OF_AN_ENSEMBLE)
    return path


def test_animals_that_were_not_found_are_left_out(of_an_ensemble):
    images, notes = read_images(of_an_ensemble)
    assert images.items == ("t/0", "t/2")
    assert images.landmarks[:, 0].tolist() == [[1, 2], [3, 4]]
    assert "2 items without a landmark left out" in "\n".join(notes)


def test_variances_of_ensembles_are_left_out(of_an_ensemble):
    _, notes = read_images(of_an_ensemble)
    assert "columns left out: x_ens_var, y_ens_var" in "\n".join(notes)
