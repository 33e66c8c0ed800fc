"""Files and parts of a run share what is settled of one sample."""

import json

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from shapefit.config import FitConfig
from shapefit.config.paths import ResultFolder, find_dictionaries
from shapefit.geometry.rotations import rotation_about
from shapefit.io import (
    read_dictionary,
    read_results,
)
from shapefit.pipelines.fit.fit import fit as run_file
from shapefit.pipelines.partition.run import fit_parts as run_parts
from shapefit.records import Landmarks
from tests.columns import in_rows
from tests.io.files import save

PARTS = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")


JOINTS = [f"{side}{part}" for part in PARTS for side in "lr"]
"""Joints of the dictionary that the detector finds."""


SIDES = {"l": "left", "r": "right"}


DETECTED = tuple(f"{SIDES[joint[0]]}_{joint[1:]}" for joint in JOINTS)
"""Their names in the files."""


COUNT = 40


def draw_bodies(rng):
    """Return bodies of the dictionary of people (n, 3, p), y down, 20 units from the
    camera, whose hips are further apart than the joints.
    """
    people = read_dictionary(find_dictionaries()["people"]).drop_unmarked(())
    columns = [people.landmark_names.index(joint) for joint in JOINTS]
    hips = [JOINTS.index("lhip"), JOINTS.index("rhip")]
    turns = rotation_about(np.array([0.0, 1, 0]), rng.uniform(0, 2 * np.pi, COUNT))
    components = rng.integers(len(people.prior.means), size=COUNT)
    upright = people.prior.means[components][..., columns]
    shapes = np.diag([1.0, -1, -1]) @ turns @ upright
    shapes += np.array([0, 0, 20.0])[:, None]
    middle_of_hips = shapes[..., hips].mean(axis=2, keepdims=True)
    shapes[..., hips] += 0.15 * (shapes[..., hips] - middle_of_hips)
    return shapes


@pytest.fixture(scope="module")
def halves(tmp_path_factory):
    """A folder with two files, a third of both, and the result of that; in the second
    half of the images bodies stand aside.
    """
    folder = tmp_path_factory.mktemp("halves")
    rng = np.random.default_rng(3)
    shapes = draw_bodies(rng)
    centre = np.array([960.0, 540])[:, None]
    points = 2100 * shapes[:, :2] / shapes[:, 2:] + centre
    points += 2 * rng.standard_normal(points.shape)
    points[:, 0] += np.linspace(-300, 300, COUNT)[:, None]
    images = Landmarks(
        in_rows(points),
        landmark_names=DETECTED,
        items=tuple(f"{i:03}" for i in range(COUNT)),
        unit="px",
    )
    save(folder / "a.h5", images.take(slice(17)))
    save(folder / "b.h5", images.take(slice(17, None)))
    save(folder / "both.h5", images)
    fit([folder / "both.h5"], folder / "result.h5")
    return folder


def fit(landmarks, output, **keys):
    """Fit files by people to a file or to a folder of parts; return the outcomes."""
    config = FitConfig(
        landmarks=list(map(str, landmarks)),
        dictionary="people",
        output=output,
        method="posterior",
        **keys,
    )
    run = run_parts if isinstance(output, ResultFolder) else run_file
    return list(run(config))


def shapes_in(path):
    """Return the shapes of a result or of a folder of parts."""
    files = sorted(path.glob("part-*")) if path.is_dir() else [path]
    return np.concatenate([read_results(file).shapes for file in files])


def count_cameras(outcomes):
    """Count the lines that tell the camera."""
    return sum(outcome.line.startswith("camera:") for outcome in outcomes)


def test_two_files_are_the_same_bits_as_one(halves, tmp_path):
    result = tmp_path / "one.h5"
    outcomes = fit([halves / "a.h5", halves / "b.h5"], result)
    assert count_cameras(outcomes) == 0
    assert_array_equal(shapes_in(result), shapes_in(halves / "result.h5"))


@pytest.mark.parametrize(
    ("names", "keys"), [("a b", {"workers": 2}), ("both", {"partition": 1})]
)
def test_parts_are_the_same_bits_as_one_file(halves, tmp_path, names, keys):
    inputs = [halves / f"{name}.h5" for name in names.split()]
    parts = tmp_path / "parts"
    outcomes = fit(inputs, ResultFolder(parts, **keys))
    assert count_cameras(outcomes) == 1  # of all parts once
    assert_array_equal(shapes_in(parts), shapes_in(halves / "result.h5"))


def test_a_later_run_keeps_the_parts_that_are_there(halves, tmp_path):
    parts = tmp_path / "parts"
    fit([halves / "a.h5"], ResultFolder(parts, 1))
    first = {path: path.read_bytes() for path in parts.glob("part-*")}
    fit([halves / "a.h5", halves / "b.h5"], ResultFolder(parts, 1))
    assert {path: path.read_bytes() for path in first} == first


def test_the_manifest_holds_what_was_estimated(halves, tmp_path):
    parts = tmp_path / "parts"
    fit([halves / "a.h5"], ResultFolder(parts, 1))
    first_line, *_ = (parts / "manifest.jsonl").read_text().splitlines()
    estimated = json.loads(first_line)["estimated"]
    assert {"camera", "skeleton", "prior_scale"} <= estimated.keys()
