"""HDF5 files: what is stored, carried and read, and names and texts that no other file can hold."""

import h5py
import numpy as np

from shapefit.io import (
    open_landmarks,
    read_dictionary,
    read_results,
    read_shapes,
)
from tests.io.files import save


def read_landmarks(*paths):
    with open_landmarks(paths) as source:
        return list(source.batches(3))


def test_files_are_laid_out_as_promised(shape_file, landmark_file, result_file, dictionary_file):
    expected = {
        shape_file: ("shapefit-shapes", {"shapes": (5, 4, 3), "mesh_vertices": (5, 6, 3)}),
        landmark_file: ("shapefit-landmarks", {"landmarks": (5, 4, 2), "confidence": (5, 4)}),
        result_file: (
            "shapefit-result",
            {"shapes": (5, 4, 3), "landmarks_fitted": (5, 4, 2), "transforms": (5, 7, 2, 3)},
        ),
        dictionary_file: ("shapefit-dictionary", {"atoms": (7, 4, 3), "mean_shape": (4, 3)}),
    }
    for path, (form, shapes_of) in expected.items():
        with h5py.File(path) as file:
            assert file.attrs["format"] == form
            assert file.attrs["version"] == 2
            assert file.attrs["unit"] in {"m", "px", "normalised"}
            for name, shape in shapes_of.items():
                assert file[name].shape == shape
                assert file[name].dtype == np.float64
            names = h5py.check_string_dtype(file["landmark_names"].dtype)
            assert names.encoding == "utf-8"
            assert names.length


def test_one_point_a_row_in_the_file_one_a_column_in_memory(shape_file, shapes):
    with h5py.File(shape_file) as file:
        np.testing.assert_array_equal(file["shapes"][2, 1], shapes.shapes[2, :, 1])
        np.testing.assert_array_equal(file["mesh_vertices"][4, 5], shapes.mesh_vertices[4, :, 5])
    assert read_shapes([shape_file]).shapes.flags.c_contiguous


def test_three_images_do_not_make_rows_of_the_camera_matrix(landmark_file, tmp_path):
    (chunk, _) = read_landmarks(landmark_file)
    assert len(chunk) == 3
    np.testing.assert_array_equal(chunk.take([1]).columns["camera_matrix"], np.eye(3))
    for other in ("camera_matrix", "palette"):
        three = chunk.replaced(further={}).with_columns(whole={other: np.eye(3)})
        save(tmp_path / "three.h5", three)
        (again,) = read_landmarks(tmp_path / "three.h5")
        np.testing.assert_array_equal(again.take([1]).columns[other], np.eye(3))


def test_nested_datasets_are_carried(landmark_file, tmp_path, edit):
    edit(landmark_file, **{"camera/focal": np.arange(5.0), "camera/model": "pinhole"})
    with h5py.File(landmark_file, "a") as file:
        file["camera/focal"].attrs["per_item"] = True
    first, _ = read_landmarks(landmark_file)
    assert first.columns["camera/focal"].tolist() == [0, 1, 2]
    assert first.columns["camera/model"].item() == "pinhole"
    save(tmp_path / "again.h5", first)
    with h5py.File(tmp_path / "again.h5") as file:
        assert file["camera/model"].asstr()[()] == "pinhole"


def test_other_types_of_numbers_and_texts_are_read(landmark_file, landmarks, edit):
    edit(
        landmark_file,
        landmarks=landmarks.landmarks.swapaxes(1, 2).astype("f4"),
        confidence=np.ones((5, 4), bool),
        item=np.array([b"a", b"b", b"c", b"d", b"e"]),
    )
    first, second = read_landmarks(landmark_file)
    assert first.items + second.items == tuple("abcde")
    assert first.landmarks.dtype == np.float64
    np.testing.assert_allclose(first.landmarks, landmarks.landmarks[:3], rtol=1e-6)
    assert (first.confidence == 1).all()


def test_optional_datasets_may_be_missing(shape_file, dictionary_file, result_file, edit):
    edit(shape_file, sequence=None, edges=None, mesh_vertices=None, mesh_faces=None)
    found = read_shapes([shape_file])
    assert found.sequences is found.edges is found.mesh_vertices is found.mesh_faces is None
    edit(dictionary_file, edges=None, mesh_vertices=None, mesh_faces=None, objective_trace=None)
    assert read_dictionary(dictionary_file).objective_trace.shape == (0,)
    edit(result_file, coefficients=None, status=None, transforms=None)
    assert read_results(result_file).coefficients is None


def test_a_landmark_with_half_a_position_is_unseen(landmark_file, landmarks, edit):
    points = landmarks.landmarks.swapaxes(1, 2).copy()
    points[0, 0] = (1.0, np.nan)
    first, _ = read_landmarks(edit(landmark_file, landmarks=points))
    assert np.isnan(first.landmarks[0, :, 0]).all()


def test_a_dataset_whose_name_is_not_utf8_is_refused(shape_file, landmark_file, problems):
    for path, read in ((shape_file, read_shapes), (landmark_file, open_landmarks)):
        with h5py.File(path, "a") as file:
            file[b"\xff\xfe"] = np.zeros(8)
        (line,) = problems(read, [path])
        assert line.startswith(f"{path}: cannot be read (a name is not UTF-8)")
