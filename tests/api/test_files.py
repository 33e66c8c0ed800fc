"""What is read is written as it was, with one landmark per row; names are imported when
used.
"""

import subprocess
import sys

import h5py
import numpy as np
import pytest

import shapefit
from tests.api.conftest import run_command, same_file


def test_what_is_read_is_written_as_it_was(tmp_path, sample, people, views):
    command = {"landmarks": str(views), "dictionary": str(people["sparse-coding"])}
    run_command(
        "fit",
        **command,
        output=str(tmp_path / "result.h5"),
        method="convex",
        save={"proof": False},
    )
    kinds = {
        "shapes": [sample / "people_test.h5", sample / "cars.h5"],
        "landmarks": [views, sample / "cars_views.h5"],
        "dictionary": [*people.values()],
        "results": [tmp_path / "result.h5"],
    }
    for kind, paths in kinds.items():
        read, write = (
            getattr(shapefit, f"{verb}_{kind}") for verb in ("read", "write")
        )
        points = {"dictionary": "atoms", "results": "shapes"}.get(kind, kind)
        for path in paths:
            found = read(path)
            with h5py.File(path) as file:
                np.testing.assert_array_equal(getattr(found, points), file[points][()])
            write(tmp_path / "again.h5", found)
            same_file(path, tmp_path / "again.h5")
    assert found.attributes["method"] == "convex"


def test_every_name_is_there_and_no_other():
    assert set(shapefit.__all__) <= set(dir(shapefit))
    for name in shapefit.__all__:
        assert getattr(shapefit, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'lift'"):
        _ = shapefit.lift


def test_importing_the_package_imports_nothing_else():
    source = "import sys, shapefit; dir(shapefit); print(*sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", source], capture_output=True, text=True, check=True
    )
    loaded = set(done.stdout.split())
    assert not loaded & {"numpy", "pydantic", "h5py", "scipy"}
    assert not [name for name in loaded if name.startswith("shapefit.")]


def test_keys_of_input_say_how_files_are_read(project):
    people = project / "sample_data/openpose"
    images = shapefit.read_landmarks(people, keypoints="body_25", track="nearest")
    assert images.landmark_names[:2] == ("Nose", "Neck")
    assert set(images.sequences) == {"openpose/person 1", "openpose/person 2"}
    with pytest.raises(
        shapefit.InputError, match=r"landmarks\.keypoint: .*; did you mean `keypoints`"
    ):
        shapefit.read_landmarks(people, keypoint="body_25")
