"""Files in and out; h5py is imported when the first HDF5 file is handled."""

from shapefit.io.atomic import atomic_path, check_output, digest, digests
from shapefit.io.dictionaries import read_dictionary, write_dictionary
from shapefit.io.formats import landmark_writer, result_writer
from shapefit.io.names import match_landmarks
from shapefit.io.source import (
    LandmarkSource,
    ShapeSource,
    open_landmarks,
    open_shapes,
    read_results,
    read_shapes,
    write_shapes,
)

__all__ = [
    "LandmarkSource",
    "ShapeSource",
    "atomic_path",
    "check_output",
    "digest",
    "digests",
    "landmark_writer",
    "match_landmarks",
    "open_landmarks",
    "open_shapes",
    "read_dictionary",
    "read_results",
    "read_shapes",
    "result_writer",
    "write_dictionary",
    "write_shapes",
]
