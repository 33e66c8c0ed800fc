"""Files that are no recordings: each is named for what it is, in one line."""

import gzip
import pickle

import h5py
import numpy as np
import pytest

from shapefit.errors import InputError
from shapefit.io import open_landmarks
from shapefit.io.formats import FORMATS
from shapefit.io.listing import find_kind
from shapefit.io.options import InputOptions

TEXT = b"scorer,a,a,a\nbodyparts,nose,nose,nose\ncoords,x,y,likelihood\n0,1,2,0.5\n"


def refusal(path) -> str:
    with pytest.raises(InputError) as error, open_landmarks([path]):
        pass
    text = str(error.value)
    assert text.startswith(str(path))
    assert "\n" not in text
    return text


@pytest.mark.parametrize("name", ["walk.json", "walk.csv", "walk.csv.gz", "walk"])
@pytest.mark.parametrize(
    "content",
    [gzip.compress(TEXT), pickle.dumps({"weight": 1}, 2), b"CDF\2" + bytes(60)],
    ids=["gzip", "pickle", "netcdf 3"],  # contents hold the time, and make no stable names
)
def test_files_that_are_not_text(tmp_path, name, content):
    path = tmp_path / name
    path.write_bytes(content)
    assert "neither text nor of a known format; give the landmarks that a" in refusal(path)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("calibration.toml", '[cam_0]\nname = "A"\nmatrix = [[1.0, 0.0], [0.0, 1.0]]\n'),
        ("calibration.yaml", "%YAML:1.0\n---\ncamera_matrix: !!opencv-matrix\n   rows: 3\n"),
        ("calibration.json", '{"cam_0": {"matrix": [[1, 0], [0, 1]], "size": [3, 4]}}'),
    ],
)
def test_a_calibration_is_no_file_of_landmarks(tmp_path, name, content):
    path = tmp_path / name
    path.write_text(content)
    assert refusal(path).endswith(
        "is a calibration of cameras, not landmarks; give it as --calibration"
    )


@pytest.mark.parametrize("start", ["CDF", "BZh", "RIFF", "MATLAB ", "BM"])
def test_text_with_such_a_beginning_is_text(tmp_path, start):
    path = tmp_path / "walk.csv"
    path.write_text(f"{start}é,b\n1,2\n", encoding="utf-8")
    assert "the header is" in refusal(path)


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ("scorer;a;a;a", "separates its cells by semicolons; save it with commas"),
        ("scorer\ta\ta\ta", "separates its cells by tabs; save it with commas"),
        ("track,frame_idx,instance.score,nose.x,nose.y,nose.score", "is one of SLEAP's tables"),
    ],
)
def test_tables_of_another_kind(tmp_path, line, found):
    path = tmp_path / "walk.csv"
    path.write_text(f"{line}\n")
    assert found in refusal(path)


def test_hdf5_of_another_kind_says_what_was_looked_for(tmp_path):
    path = tmp_path / "poses.h5"
    with h5py.File(path, "w") as file:
        file["data"] = np.zeros((3, 3, 4))
    text = refusal(path)
    assert "and holds data" in text
    for name in ("shapefit-landmarks", "DeepLabCut", "SLEAP", "JABS", "NWB", "movement"):
        assert name in text
    with pytest.raises(InputError, match=r"holds data; give a file of DeepLabCut.* of shapefit"):
        find_kind(path)


@pytest.mark.parametrize("name", [name for name, form in FORMATS.items() if not form.folders])
def test_a_folder_in_a_format_of_files_is_refused(tmp_path, name):
    for read in (find_kind, lambda path, options: open_landmarks([path], options).__enter__()):
        with pytest.raises(InputError, match=r"it is a folder, and .* is a file; name the files"):
            read(tmp_path, InputOptions(format=name))
