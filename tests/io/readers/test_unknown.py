"""Files that are no recordings: each is named for what it is, in one line."""

import bz2
import gzip
import io
import lzma
import pickle
import zipfile

import h5py
import numpy as np
import pytest

from shapefit.errors import InputError
from shapefit.io import open_landmarks
from shapefit.io.formats import FORMATS
from shapefit.io.listing import find_kind
from shapefit.io.options import InputOptions

TEXT = b"scorer,a,a,a\nbodyparts,nose,nose,nose\ncoords,x,y,likelihood\n0,1,2,0.5\n"


def archive() -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as packed:
        packed.writestr("archive/data.pkl", pickle.dumps({"weight": 1}))
    return file.getvalue()


def refusal(path) -> str:
    with pytest.raises(InputError) as error, open_landmarks([path]):
        pass
    text = str(error.value)
    assert text.startswith(str(path))
    assert "\n" not in text
    return text


@pytest.mark.parametrize("name", ["walk.json", "walk.csv", "walk.csv.gz", "walk"])
@pytest.mark.parametrize(
    ("content", "found"),
    [
        (gzip.compress(TEXT), "is compressed; unpack it first"),
        (bz2.compress(TEXT), "is compressed; unpack it first"),
        (lzma.compress(TEXT), "is compressed; unpack it first"),
        (archive(), "is a zip archive, as models of PyTorch"),
        (pickle.dumps({"weight": 1}, 2), "is a pickle of Python"),
        (pickle.dumps({"weight": 1}, 5), "is a pickle of Python"),
        (b"MATLAB 5.0 MAT-file".ljust(124) + b"\0\1IM", "is a file of MATLAB"),
        (b"CDF\2" + bytes(60), "is netCDF 3; write it as netCDF 4"),
    ],
    # contents hold the time at which they were made, and make no stable names
    ids=["gzip", "bzip2", "xz", "zip", "pickle 2", "pickle 5", "mat", "netcdf 3"],
)
def test_files_of_another_kind(tmp_path, name, content, found):
    path = tmp_path / name
    path.write_bytes(content)
    assert found in refusal(path)


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
