"""netCDF of movement: what makes it load there, and that our reader returns it."""

from dataclasses import replace

import h5py
import numpy as np
import pytest

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
    n, p, _ = scene.result.shapes.shape
    anna = replace(
        scene.result,
        shape_sd=np.ones((n, p, 3)),
        trusted=np.ones(n, bool),
        reasons=np.array([""] * n, object),
    )
    ben = replace(
        anna,
        items=tuple(f"film/ben/{i}" for i in range(n)),
        sequences=("film/ben",) * n,
        frames=np.arange(9, 9 + n),
        trusted=np.zeros(n, bool),
        reasons=np.array(["far"] * n, object),
    )
    return concatenate([anna, ben])


def test_names_axes_and_attributes_are_those_that_movement_validates(tmp_path, two):
    save(tmp_path / "poses.nc", two)
    with h5py.File(tmp_path / "poses.nc") as file:
        attributes = dict(file.attrs)
        axes = attributes.pop("axes")
        assert attributes == {
            "ds_type": "poses",
            "source_software": "shapefit",
            "time_unit": "seconds",
            "fps": 25.0,
        }
        assert axes == "y up, the axis z of the extrinsics; position from the camera"
        for axis in AXES:
            assert file[axis].is_scale
            assert file[axis].attrs["NAME"].decode() == axis
        for name in ("position", "confidence", "shape_sd"):
            dataset = file[name]
            wanted = AXES if name == "position" else (AXES[0], *AXES[2:])
            assert tuple(dim[0].name.strip("/") for dim in dataset.dims) == wanted
            assert dataset.dtype == np.float64
        assert file["position"].shape == (6, 3, 15, 2)
        assert file["space"].asstr()[()].tolist() == ["x", "y", "z"]
        assert file["individuals"].asstr()[()].tolist() == ["film_anna", "film_ben"]
        assert file["position"].attrs["units"] == "m"
        np.testing.assert_allclose(file["time"], np.arange(7, 13) / 25)
        confidence = file["confidence"][:, 0]
        deviations = file["shape_sd"][()]
    expected = [[1, np.nan], [1, np.nan], [1, 0], [1, 0], [np.nan, 0], [np.nan, 0]]
    np.testing.assert_array_equal(confidence, expected)
    unit = two.metres_per_unit[0]
    np.testing.assert_allclose(deviations[0, :, 0], np.sqrt(3) * unit)
    assert np.isnan(deviations[0, :, 1]).all()


def test_points_unit_and_rate_come_back(tmp_path, scene):
    note = save(tmp_path / "poses.nc", scene.result).note
    assert note.startswith("in m by the size of the training shapes, y up")
    read = read_shapes([tmp_path / "poses.nc"])
    assert read.unit == "m"
    assert read.frame_rate == 25.0
    assert read.landmark_names == scene.result.landmark_names
    np.testing.assert_allclose(read.as_columns(), scene.y_up, atol=1e-9)


def test_without_a_frame_rate_times_are_frames(tmp_path, scene):
    summary = save(tmp_path / "poses.nc", replace(scene.result, frame_rate=None))
    assert "times are numbers of frames" in " ".join(summary.warnings)
    with h5py.File(tmp_path / "poses.nc") as file:
        assert file.attrs["time_unit"] == "frames"
        assert "fps" not in file.attrs
        assert file["time"][()].tolist() == [7, 8, 9, 10]
    assert read_shapes([tmp_path / "poses.nc"]).frame_rate is None


def test_sequences_of_several_rates_are_refused(tmp_path, scene):
    one = replace(scene.result, frame_rate=None, times=np.arange(4) / 25)
    other = replace(
        one,
        items=tuple("abcd"),
        sequences=("film/ben",) * 4,
        times=np.arange(4) / 50,
    )
    with pytest.raises(InputError, match="have 25 and 50 frames per second; convert"):
        save(tmp_path / "poses.nc", concatenate([one, other]))
    assert not [*tmp_path.iterdir()]
