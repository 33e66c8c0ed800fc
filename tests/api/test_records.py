"""Arrays of detectors to people, as the command lifts them; and what a fit shows and
hands on.
"""

import csv
import json
import sys
from unittest.mock import Mock

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

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
    confidence = np.asarray(visible.confidence)[:36]
    return np.dstack([landmarks, confidence])


KEYS_OF_THE_FIT = ("lambda", "tolerance", "prior", "method", "keypoints", "save")


@pytest.fixture(scope="module")
def found(keypoints):
    return shapefit.fit(keypoints, "people", keypoints="body_25")


def test_a_fit_is_the_command_on_the_same_array(found, keypoints, tmp_path):
    array = tmp_path / "landmarks.npy"
    output = tmp_path / "result.h5"
    np.save(array, keypoints)
    config = json.loads(found.attributes["config"])
    keys = {key: config[key] for key in KEYS_OF_THE_FIT}
    files = {"landmarks": (str(array),), "output": str(output)}
    run_command("fit", **files, dictionary="people", **keys)
    result = shapefit.read_results(output)
    assert found.attributes["method"] == "sequences"
    for name in ("shapes", "shape_sd", "p_value", "trusted"):
        assert_array_equal(getattr(found, name), getattr(result, name))


STATED = {
    "keypoints": "body_25",
    "skeleton": {"head": 1.5, "hips": 1.15},
    "camera": {"focal": "none"},
}
"""Keys that leave nothing to estimate."""


def test_one_image_has_the_method_for_single_images(keypoints):
    alone = shapefit.fit(keypoints[0], "people", **STATED)
    by_config = shapefit.fit(keypoints, "people", config="people", **STATED)
    assert len(alone) == 1
    assert alone.attributes["method"] == "posterior"
    assert_array_equal(by_config[0].shapes, alone.shapes)


def p_values(images, dictionary):
    fit = shapefit.fit(images, dictionary, method="posterior", camera={"focal": "none"})
    return fit.p_value


def test_a_prior_without_a_table_has_one_drawn(world):
    """As one of an earlier version, or of arrays: p-values are about those of the
    stored one.
    """
    people = shapefit.read_dictionary(world.dictionary("people with a prior"))
    images = shapefit.read_landmarks(world.images("people"))
    learned = dict(people.learned)
    del learned["p_value_table"]
    without_table = people.replaced(learned=learned)
    expected = p_values(images, people)
    assert_allclose(p_values(images, without_table), expected, atol=0.02)


WRONG_ARRAYS = [
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
]


@pytest.mark.parametrize(("landmarks", "options", "message"), WRONG_ARRAYS)
def test_arrays_that_cannot_be_are_refused(landmarks, options, message):
    with pytest.raises(shapefit.InputError, match=message):
        shapefit.fit(landmarks, "people", **options)


def test_a_fit_is_one_line(found):
    sizes = "36 images, 21 landmarks, method sequences, 36 trusted"
    assert repr(found) == f"<shapefit.Fit: {sizes}, in unknown>"


def test_a_fit_has_parts(found):
    part = found[4:9]
    assert len(found) == 36
    assert part.items == found.items[4:9]
    assert_array_equal(part.shapes, found.shapes[4:9])
    assert_array_equal(part.frames, found.frames[4:9])
    assert_array_equal(found[-1].shapes, found.shapes[-1:])


def test_a_fit_has_the_part_of_flags(found):
    trusted = found[found.trusted]
    assert len(trusted) == int(found.trusted.sum())


def metres_of(fit):
    """Return the table of joints in metres of a fit of unknown frame rate."""
    warning = "times are numbers of frames; set `frame_rate`"
    with pytest.warns(UserWarning, match=warning):
        return fit.metres


@pytest.fixture
def converted(found, tmp_path):
    """The rows of joints in metres that `convert` writes."""
    result = tmp_path / "fit.h5"
    output = tmp_path / "x.metres.csv"
    shapefit.write_results(result, found)
    arguments = {"files": [str(result)], "output": str(output)}
    list(convert.convert_files(load_config("convert", arguments=arguments)))
    with output.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_joints_in_metres_are_those_that_convert_writes(found, converted):
    table = metres_of(found)
    landmarks = [row["landmark"] for row in converted]
    assert list(table.dtype.names) == [*converted[0], "sequence"]
    for name in ("frame", "time", "x", "y", "z", "sd"):
        expected = [float(row[name]) for row in converted]
        assert_allclose(table[name], expected, rtol=1e-6)
    assert table["landmark"].tolist() == landmarks


def test_trust_of_joints_is_that_of_convert(found, converted):
    assert {row["trusted"] for row in converted} == {"true"}
    assert metres_of(found)["trusted"].all()


@pytest.fixture(scope="module")
def small(visible):
    """A fit of a body of 1.2 m, by a method that trusts nothing."""
    images = visible.replaced(frame_rate=25)[:12]
    return shapefit.fit(images, "people", method="convex", height=1.2)


def test_a_table_in_metres_has_times_and_trust(small):
    table = small.metres
    assert table["time"][-1] == 11 / 25
    assert not table["trusted"].any()


def test_another_height_scales_the_metres(small):
    x = small.metres["x"]
    x_of_tall = small.to_metres(height=1.8)["x"]
    assert_allclose(x_of_tall - x_of_tall[0], 1.5 * (x - x[0]), atol=1e-9)


def test_the_height_of_a_body_is_that_of_the_fit(small, tmp_path):
    path = tmp_path / "small.metres.csv"
    shapefit.write_results(path, small)
    written = np.genfromtxt(path, delimiter=",", names=True)
    assert_allclose(written["x"], small.metres["x"], rtol=1e-6)


def test_what_has_no_size_has_no_metres(keypoints):
    atoms = shapefit.read_dictionary("people").atoms[:, :15]
    dictionary = shapefit.Dictionary(atoms=atoms)
    fit = shapefit.fit(keypoints[:2, :15, :2], dictionary)
    fault = r"metres is not known .*; give it, .* `height=1"
    with pytest.raises(shapefit.InputError, match=fault):
        _ = fit.metres


class Table(dict):
    """Stands for a DataFrame where pandas is not installed."""

    def __init__(self, columns):
        super().__init__(columns)
        self.attrs = {}


IN_PANDAS = pytest.mark.parametrize(
    "pandas", [Mock(DataFrame=Table), pytest.param(None, marks=pytest.mark.slow)]
)
"""A stand-in, and pandas itself, which need not be installed."""


FRAMES = np.arange(36)


@IN_PANDAS
def test_tables_of_other_libraries(found, monkeypatch, pandas):
    if pandas is not None:
        monkeypatch.setitem(sys.modules, "pandas", pandas)
    table = found.to_pandas()
    points = np.column_stack([table["x"], table["y"], table["z"]])
    assert list(table)[:5] == ["item", "landmark", "x", "y", "z"]
    assert list(table["frame"]) == np.repeat(FRAMES, 21).tolist()
    assert list(table["time"]) == list(table["frame"])
    assert_array_equal(points, found.shapes.reshape(-1, 3))
    assert table.attrs == {"unit": "unknown", "y_axis": "down"}


@IN_PANDAS
def test_times_that_are_not_known_are_frames(found, monkeypatch, pandas):
    if pandas is not None:
        monkeypatch.setitem(sys.modules, "pandas", pandas)
    clock = np.where(FRAMES < 9, np.nan, 3.0 * FRAMES)
    table = found.replaced(times=clock).to_pandas()
    expected = np.where(np.isnan(clock), FRAMES, clock)
    assert list(table["time"]) == np.repeat(expected, 21).tolist()


class TestTextsOfADictionary:
    """Of two atoms of three landmarks."""

    ATOMS = np.arange(18.0).reshape(2, 3, 3)

    @pytest.mark.parametrize(
        ("name", "texts"), [("landmark_names", list("abc")), ("atom_items", list("uv"))]
    )
    def test_they_become_tuples(self, name, texts):
        dictionary = shapefit.Dictionary(self.ATOMS, **{name: texts})
        assert getattr(dictionary, name) == tuple(texts)

    @pytest.mark.parametrize(
        ("name", "texts"), [("landmark_names", list("ab")), ("atom_items", list("uvw"))]
    )
    def test_there_are_as_many_as_landmarks_or_atoms(self, name, texts):
        with pytest.raises(shapefit.InputError, match=rf"^dictionary\.{name}: has the"):
            shapefit.Dictionary(self.ATOMS, **{name: texts})
