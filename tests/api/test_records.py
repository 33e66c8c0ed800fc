"""Arrays of detectors to people, as the command lifts them; and what a fit shows and
hands on.
"""

import csv
import json
import sys
from unittest.mock import Mock

import numpy as np
import pytest

import shapefit
from shapefit.config import load_config
from shapefit.pipelines import convert
from tests.api.conftest import run_command


@pytest.fixture(scope="module")
def visible(project):
    return shapefit.read_landmarks(
        project / "sample_data/openpose", keypoints="body_25", track="nearest"
    )


@pytest.fixture(scope="module")
def keypoints(visible):
    """One person (n, 25, 3) with confidences."""
    landmarks = np.nan_to_num(np.asarray(visible.landmarks)[:36])
    return np.dstack([landmarks, np.asarray(visible.confidence)[:36]])


@pytest.fixture(scope="module")
def found(keypoints):
    return shapefit.fit(keypoints, "people", keypoints="body_25")


def test_a_fit_is_the_command_on_the_same_array(found, keypoints, tmp_path):
    np.save(tmp_path / "landmarks.npy", keypoints)
    config = {"landmarks": (str(tmp_path / "landmarks.npy"),), "dictionary": "people"}
    (tmp_path / "fit.yaml").write_text(
        json.dumps({"keypoints": "body_25", "method": "sequences"})
    )
    assert found.attributes["method"] == "sequences"
    wanted = json.loads(found.attributes["config"])
    given = {
        key: wanted[key]
        for key in ("lambda", "tolerance", "prior", "method", "keypoints", "save")
    }
    run_command("fit", **config, **given, output=str(tmp_path / "result.h5"))
    result = shapefit.read_results(tmp_path / "result.h5")
    for name in ("shapes", "shape_sd", "p_value", "trusted"):
        np.testing.assert_array_equal(getattr(found, name), getattr(result, name))


def test_one_image_has_the_method_for_single_images(keypoints):
    given = {"skeleton": {"head": 1.5, "hips": 1.15}, "camera": {"focal": "none"}}
    alone = shapefit.fit(keypoints[0], "people", keypoints="body_25", **given)
    assert len(alone) == 1
    assert alone.attributes["method"] == "posterior"
    config = shapefit.fit(
        keypoints, "people", keypoints="body_25", config="people", **given
    )
    np.testing.assert_array_equal(config[0].shapes, alone.shapes)


def test_a_prior_without_a_table_has_one_drawn(world):
    """As one of an earlier version, or of arrays: p-values are about those of the
    stored one.
    """
    people = shapefit.read_dictionary(world.dictionary("people with a prior"))
    learned = {
        name: values
        for name, values in people.learned.items()
        if name != "p_value_table"
    }
    images = shapefit.read_landmarks(world.images("people"))
    stored, drawn = (
        shapefit.fit(images, one, method="posterior", camera={"focal": "none"})
        for one in (people, people.replaced(learned=learned))
    )
    np.testing.assert_allclose(drawn.p_value, stored.p_value, atol=0.02)


@pytest.mark.parametrize(
    ("landmarks", "options", "message"),
    [
        (
            np.ones((3, 25, 3)),
            {},
            r"not 15; name them, as in `keypoints=body_25` or `keypoints=",
        ),
        (
            np.ones((3, 17, 2)),
            {},
            r"not 15; name them, as in `keypoints=coco_17` or `keypoints=",
        ),
        (np.full((3, 25, 2), 9.0), {"keypoints": "body_26"}, "body_25"),
        (np.full((3, 15, 3), 7.0), {}, "third numbers run from 7 to 7"),
    ],
)
def test_arrays_that_cannot_be_are_refused(landmarks, options, message):
    with pytest.raises(shapefit.InputError, match=message):
        shapefit.fit(landmarks, "people", **options)


def test_a_fit_is_one_line_and_has_parts(found):
    assert (
        repr(found)
        == "<shapefit.Fit: 36 images, 21 landmarks, method sequences, 36 trusted, in"
        " unknown>"
    )
    assert len(found) == 36
    part = found[4:9]
    assert part.items == found.items[4:9]
    np.testing.assert_array_equal(part.shapes, found.shapes[4:9])
    np.testing.assert_array_equal(part.frames, found.frames[4:9])
    np.testing.assert_array_equal(found[-1].shapes, found.shapes[-1:])
    assert len(found[found.trusted]) == int(found.trusted.sum())


def test_joints_in_metres_are_those_that_convert_writes(found, tmp_path):
    shapefit.write_results(tmp_path / "fit.h5", found)
    files = {
        "files": [str(tmp_path / "fit.h5")],
        "output": str(tmp_path / "x.metres.csv"),
    }
    for _ in convert.convert_files(load_config("convert", arguments=files)):
        pass
    with pytest.warns(
        UserWarning, match="times are numbers of frames; set `frame_rate`"
    ):
        table = found.metres
    with (tmp_path / "x.metres.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [*rows[0], "sequence"] == list(table.dtype.names)
    for name in ("frame", "time", "x", "y", "z", "sd"):
        np.testing.assert_allclose(
            [float(row[name]) for row in rows], table[name], rtol=1e-6
        )
    assert [row["landmark"] for row in rows] == table["landmark"].tolist()
    assert {row["trusted"] for row in rows} == {"true"}
    assert table["trusted"].all()


def test_the_height_of_a_body_is_that_of_the_fit(visible, tmp_path):
    images = visible.replaced(frame_rate=25)[:12]
    small = shapefit.fit(images, "people", method="convex", height=1.2)
    table, tall = small.metres, small.to_metres(height=1.8)
    assert table["time"][-1] == 11 / 25
    assert not table["trusted"].any()
    moved, twice = (each["x"] - each["x"][0] for each in (table, tall))
    np.testing.assert_allclose(twice, 1.5 * moved, atol=1e-9)
    shapefit.write_results(tmp_path / "small.metres.csv", small)
    written = np.genfromtxt(tmp_path / "small.metres.csv", delimiter=",", names=True)
    np.testing.assert_allclose(written["x"], table["x"], rtol=1e-6)


def test_what_has_no_size_has_no_metres(keypoints):
    atoms = shapefit.read_dictionary("people").atoms[:, :15]
    alone = shapefit.fit(keypoints[:2, :15, :2], shapefit.Dictionary(atoms=atoms))
    with pytest.raises(
        shapefit.InputError, match=r"metres is not known .*; give it, .* `height=1"
    ):
        _ = alone.metres


class Table(dict):
    """Stands for a DataFrame where pandas is not installed."""

    def __init__(self, columns):
        super().__init__(columns)
        self.attrs = {}


@pytest.mark.parametrize(
    "pandas", [Mock(DataFrame=Table), pytest.param(None, marks=pytest.mark.slow)]
)
def test_tables_of_other_libraries(found, monkeypatch, pandas):
    if pandas is not None:  # a stand-in where it is not installed
        monkeypatch.setitem(sys.modules, "pandas", pandas)
    table = found.to_pandas()
    assert list(table)[:5] == ["item", "landmark", "x", "y", "z"]
    assert list(table["frame"]) == np.repeat(np.arange(36), 21).tolist()
    assert list(table["time"]) == list(table["frame"])
    clock = np.where(np.arange(36) < 9, np.nan, 3.0 * np.arange(36))
    timed = found.replaced(times=clock).to_pandas()
    expected = np.where(np.isnan(clock), np.arange(36), clock)
    assert list(timed["time"]) == np.repeat(expected, 21).tolist()
    points = np.column_stack([table["x"], table["y"], table["z"]])
    np.testing.assert_array_equal(points, found.shapes.reshape(-1, 3))
    assert table.attrs == {"unit": "unknown", "y_axis": "down"}
