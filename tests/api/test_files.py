"""What is read is written as it was, with one landmark per row; names are imported when
used.
"""

import subprocess
import sys

import h5py
import pytest
from numpy.testing import assert_array_equal

import shapefit
from tests.api.conftest import run_command, same_file


def test_every_name_is_there_and_no_other():
    assert set(shapefit.__all__) <= set(dir(shapefit))
    for name in shapefit.__all__:
        assert getattr(shapefit, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'lift'"):
        _ = shapefit.lift


@pytest.fixture
def result_file(tmp_path, people, views):
    path = tmp_path / "result.h5"
    files = {
        "landmarks": str(views),
        "dictionary": str(people["sparse-coding"]),
        "output": str(path),
    }
    run_command("fit", **files, method="convex", save={"proof": False})
    return path


def check_files(paths, read, write, points, again):
    """Fail unless what is read of files has their points, and is written as it was."""
    for path in paths:
        record = read(path)
        with h5py.File(path) as file:
            assert_array_equal(getattr(record, points), file[points][()])
        write(again, record)
        same_file(path, again)


def test_shapes_that_are_read_are_written_as_they_were(sample, tmp_path):
    paths = [sample / "people_test.h5", sample / "cars.h5"]
    functions = (shapefit.read_shapes, shapefit.write_shapes)
    check_files(paths, *functions, "shapes", tmp_path / "again.h5")


def test_landmarks_that_are_read_are_written_as_they_were(sample, views, tmp_path):
    paths = [views, sample / "cars_views.h5"]
    functions = (shapefit.read_landmarks, shapefit.write_landmarks)
    check_files(paths, *functions, "landmarks", tmp_path / "again.h5")


def test_dictionaries_that_are_read_are_written_as_they_were(people, tmp_path):
    functions = (shapefit.read_dictionary, shapefit.write_dictionary)
    check_files(people.values(), *functions, "atoms", tmp_path / "again.h5")


def test_results_that_are_read_are_written_as_they_were(result_file, tmp_path):
    functions = (shapefit.read_results, shapefit.write_results)
    check_files([result_file], *functions, "shapes", tmp_path / "again.h5")
    assert shapefit.read_results(result_file).attributes["method"] == "convex"


def test_importing_the_package_imports_nothing_else():
    source = "import sys, shapefit; dir(shapefit); print(*sys.modules)"
    command = [sys.executable, "-c", source]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    loaded = set(done.stdout.split())
    assert not loaded & {"numpy", "pydantic", "h5py", "scipy"}
    assert not [name for name in loaded if name.startswith("shapefit.")]


def test_keys_of_input_say_how_files_are_read(project):
    folder = project / "sample_data/openpose"
    images = shapefit.read_landmarks(folder, keypoints="body_25", track="nearest")
    assert images.landmark_names[:2] == ("Nose", "Neck")
    assert set(images.sequences) == {"openpose/person 1", "openpose/person 2"}


def test_an_unknown_key_of_input_names_the_nearest(project):
    folder = project / "sample_data/openpose"
    fault = r"landmarks\.keypoint: .*; did you mean `keypoints`"
    with pytest.raises(shapefit.InputError, match=fault):
        shapefit.read_landmarks(folder, keypoint="body_25")
