"""HDF5 that is written: its digest is that of what stands in the file."""

import h5py
import numpy as np
import pytest

from shapefit.errors import InputError
from shapefit.io.contents import digest_contents
from shapefit.io.formats import record_writer
from shapefit.io.hdf5_file import read_seal
from shapefit.io.layout import CONTENTS, LANDMARKS
from shapefit.records import Landmarks

EXTRAS = {
    "flags": np.array([True, False, True]),
    "group/inner/values": np.arange(6, dtype=np.float32).reshape(3, 2),
    "texts": np.array(["", "ü", "a\0"], object),
    "nothing": np.zeros((3, 0)),
}
FILE_EXTRAS = {
    "one": np.array(2.5),
    "group/labels": np.array(["x", "longer"], object),
    "none": np.zeros((0, 2), np.int16),
}


def write_sealed(path, records):
    with record_writer(path, LANDMARKS) as writer:
        writer.seal = {}
        writer.attributes.update(
            {"text": "", "count": 3, "share": 0.5, "version": "x", "name": "ü"}
        )
        for record in records:
            writer.append(record)


def some_landmarks(rng, n, extras, file_extras):
    return Landmarks(
        landmarks=rng.normal(size=(n, 4, 2)),
        landmark_names=tuple("abcd"),
        items=tuple(map(str, range(n))),
        extras=extras,
        file_extras=file_extras,
    )


def test_the_digest_of_what_is_written_is_that_of_the_file(tmp_path):
    path = tmp_path / "sealed.h5"
    record = some_landmarks(np.random.default_rng(0), 3, EXTRAS, FILE_EXTRAS)
    write_sealed(path, [record, record.take(slice(0, 2))])
    seal = read_seal(path)
    assert seal.stated == seal.found
    with h5py.File(path) as file:
        found = digest_contents(file, lambda name, rows: file[name][rows])
        assert file.attrs[CONTENTS] == found
        assert {"group", "group/inner"} <= set(file) | {
            f"group/{n}" for n in file["group"]
        }


def test_rows_that_fill_chunks_are_digested_in_order(tmp_path):
    rng = np.random.default_rng(1)
    path = tmp_path / "large.h5"
    parts = [some_landmarks(rng, n, {}, {}) for n in (10, 9000, 1, 5000, 0, 7)]
    write_sealed(path, parts)
    seal = read_seal(path)
    assert seal.stated == seal.found
    with h5py.File(path) as file:
        stored = file["landmarks"][:]
    assert np.array_equal(stored, np.concatenate([part.points for part in parts]))


def test_a_name_with_the_character_nul_is_refused_and_nothing_is_written(tmp_path):
    """HDF5 would cut it off, and two names could become one."""
    path = tmp_path / "landmarks.h5"
    points = np.ones((2, 3, 2))
    record = Landmarks(points, landmark_names=tuple("pqr"), items=("a\0", "a"))
    with pytest.raises(InputError, match=r"/item: the name .* has a character NUL"):
        write_sealed(path, [record])
    assert not path.exists()
