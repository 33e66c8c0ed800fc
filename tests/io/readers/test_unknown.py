"""Files that are no recordings: each is named for what it is, in one line."""

import gzip
import pickle

import h5py
import numpy as np
import pytest

from shapefit.errors import InputError
from shapefit.io import inputs, open_landmarks
from shapefit.io.detect import FORMATS, detect_format
from shapefit.io.options import InputOptions
from shapefit.io.source import find_kind

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
    [gzip.compress(b"\0" + TEXT), pickle.dumps({"weight": 1}, 2), b"CDF\2" + bytes(60)],
    ids=[
        "gzip of no text",
        "pickle",
        "netcdf 3",
    ],  # contents hold the time, and make no stable names
)
def test_files_that_are_not_text(tmp_path, name, content):
    path = tmp_path / name
    path.write_bytes(content)
    assert "neither text nor of a known format; give the landmarks that a" in refusal(path)


TIDY = b"item,landmark,x,y\ni,a,250,5\ni,b,75,125\n"
WIDE = b"frame,track_id,nose_x,nose_y,hip_x,hip_y\n0,1,10,20,30,50\n0,2,11,21,31,51\n"
ARRAY = b"[[[1,2],[3,4]]]"


@pytest.mark.parametrize(
    ("name", "content"),
    [("t.csv", TIDY), ("w.csv", WIDE), ("d.csv", TEXT), ("a.json", ARRAY), ("bare", TIDY)],
)
def test_text_that_gzip_made_smaller(tmp_path, monkeypatch, name, content):
    (tmp_path / name).write_bytes(content)
    packed = tmp_path / f"{name}.gz"
    packed.write_bytes(gzip.compress(content))
    options = InputOptions(keypoints="numbered")
    plain, found = (whole(path, options) for path in (tmp_path / name, packed))
    np.testing.assert_array_equal(found.landmarks, plain.landmarks)
    assert (found.items, found.sequences) == (plain.items, plain.sequences)
    assert detect_format(packed) is detect_format(tmp_path / name)
    packed.write_bytes(gzip.compress(content)[:-8])  # cut off
    assert "cannot be unpacked" in refusal(packed)
    packed.write_bytes(gzip.compress(content + b" " * 5_000_000))
    assert packed.stat().st_size < 10_000
    monkeypatch.setattr(inputs, "LARGEST_BYTES", 1_000_000)
    if content != TIDY:  # which is read block by block
        assert "more than 1 MB of text, and it is read whole" in refusal(packed)


def whole(path, options):
    with open_landmarks([path], options) as source:
        return source.whole()


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


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ("scorer;a;a;a", "separates its cells by semicolons; save it with commas"),
        ("scorer\ta\ta\ta", "separates its cells by tabs; save it with commas"),
        ("track,frame_idx,instance.score,nose.x,nose.y,nose.score", "the header is 'track,frame_"),
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


def test_a_folder_in_a_format_of_files_is_refused(tmp_path):
    for name in [name for name, form in FORMATS.items() if not form.together]:
        with pytest.raises(InputError, match=r"it is a folder, and .* is a file; name the files"):
            find_kind(tmp_path, InputOptions(format=name))
