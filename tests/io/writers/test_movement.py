"""netCDF of movement: what makes it load there, and that our reader returns it."""

from dataclasses import replace

import h5py
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.errors import InputError
from shapefit.io import read_shapes
from shapefit.records import concatenate
from tests.io.files import save

AXES = ("time", "space", "keypoints", "individuals")


@pytest.fixture
def two(scene):
    """Anna in the frames 7 to 10, and Ben, who is not trusted, in 9 to 12; with error
    bars.
    """
    count = len(scene.result)
    anna = replace(
        scene.result,
        shape_sd=np.ones_like(scene.result.shapes),
        trusted=np.ones(count, bool),
        reasons=np.array([""] * count, object),
    )
    ben = replace(
        anna,
        items=tuple(f"film/ben/{i}" for i in range(count)),
        sequences=("film/ben",) * count,
        frames=np.arange(9, 9 + count),
        trusted=np.zeros(count, bool),
        reasons=np.array(["far"] * count, object),
    )
    return concatenate([anna, ben])


FULL = """
import resource, sys
import numpy as np
import shapefit

sys.dont_write_bytecode = True  # or modules that are cut off stay on the disk
resource.setrlimit(resource.RLIMIT_FSIZE, (1_000, 1_000))
fit = shapefit.Fit(np.ones((9, 15, 3)), unit="m", frame_rate=25.0)
try:
    shapefit.write_results(sys.argv[1], fit)
except shapefit.InputError as error:
    print(error)
"""


def test_a_full_disk_is_told(tmp_path, run_python):
    done = run_python(FULL, tmp_path / "poses.nc")
    assert "cannot be written: File too large" in done.stdout
    assert (done.returncode, done.stderr) == (0, "")
    assert list(tmp_path.iterdir()) == []


@pytest.fixture
def poses(tmp_path, two):
    """The file of both, open."""
    path = tmp_path / "poses.nc"
    save(path, two)
    with h5py.File(path) as file:
        yield file


def test_attributes_are_those_that_movement_validates(poses):
    attributes = dict(poses.attrs)
    axes = attributes.pop("axes")
    assert axes == "y up, the axis z of the extrinsics; position from the camera"
    assert attributes == {
        "ds_type": "poses",
        "source_software": "shapefit",
        "time_unit": "seconds",
        "fps": 25.0,
    }


@pytest.mark.parametrize("axis", AXES)
def test_axes_are_scales_of_their_names(poses, axis):
    assert poses[axis].is_scale
    assert poses[axis].attrs["NAME"].decode() == axis


WITHOUT_SPACE = ("time", "keypoints", "individuals")


@pytest.mark.parametrize(
    ("name", "axes"),
    [("position", AXES), ("confidence", WITHOUT_SPACE), ("shape_sd", WITHOUT_SPACE)],
)
def test_datasets_have_the_axes_that_movement_validates(poses, name, axes):
    dataset = poses[name]
    scales = tuple(dimension[0].name.strip("/") for dimension in dataset.dims)
    assert scales == axes
    assert dataset.dtype == np.float64


def test_names_and_times_along_the_axes(poses):
    assert poses["position"].shape == (6, 3, 15, 2)
    assert poses["position"].attrs["units"] == "m"
    assert poses["space"].asstr()[()].tolist() == ["x", "y", "z"]
    assert poses["individuals"].asstr()[()].tolist() == ["film_anna", "film_ben"]
    assert_allclose(poses["time"], np.arange(7, 13) / 25)


def test_confidence_says_who_is_trusted_in_which_frames(poses):
    confidence = poses["confidence"][:, 0]
    expected = [[1, np.nan], [1, np.nan], [1, 0], [1, 0], [np.nan, 0], [np.nan, 0]]
    assert_array_equal(confidence, expected)


def test_error_bars_are_in_metres(poses, two):
    anna, ben = np.moveaxis(poses["shape_sd"][0], 1, 0)
    expected = np.sqrt(3) * two.metres_per_unit[0]
    assert_allclose(anna, expected)
    assert np.isnan(ben).all()


def test_points_unit_and_rate_come_back(tmp_path, scene):
    path = tmp_path / "poses.nc"
    summary = save(path, scene.result)
    read = read_shapes([path])
    assert summary.note.startswith("in m by the size of the training shapes, y up")
    assert read.unit == "m"
    assert read.frame_rate == 25.0
    assert read.landmark_names == scene.result.landmark_names
    assert_allclose(read.as_columns(), scene.y_up, atol=1e-9)


def test_without_a_frame_rate_times_are_frames(tmp_path, scene):
    path = tmp_path / "poses.nc"
    summary = save(path, replace(scene.result, frame_rate=None))
    assert "times are numbers of frames" in " ".join(summary.warnings)
    with h5py.File(path) as file:
        assert file.attrs["time_unit"] == "frames"
        assert "fps" not in file.attrs
        assert file["time"][()].tolist() == [7, 8, 9, 10]
    assert read_shapes([path]).frame_rate is None


def test_sequences_of_several_rates_are_refused(tmp_path, scene):
    at_25 = replace(scene.result, frame_rate=None, times=np.arange(4) / 25)
    at_50 = replace(
        at_25,
        items=tuple("abcd"),
        sequences=("film/ben",) * 4,
        times=np.arange(4) / 50,
    )
    both = concatenate([at_25, at_50])
    with pytest.raises(InputError, match="have 25 and 50 frames per second; convert"):
        save(tmp_path / "poses.nc", both)
    assert not [*tmp_path.iterdir()]
