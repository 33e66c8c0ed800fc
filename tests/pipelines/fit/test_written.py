"""`fit` writes TRC, tables, meshes and angles, and what it stores lets `convert` do so
later.
"""

import csv
import re
from pathlib import Path

import h5py
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.config import load_config
from shapefit.dictionary.model import Dictionary
from shapefit.errors import InputError
from shapefit.geometry.joint_angles import measurable_angles, measure_angles
from shapefit.geometry.normalisation import normalise
from shapefit.io import read_results, write_dictionary
from shapefit.io.skeletons import FURTHER, PEOPLE, joint_columns
from shapefit.pipelines.convert import convert_files as convert
from shapefit.pipelines.fit.fit import fit
from shapefit.pipelines.view.reading import read_inputs
from shapefit.records.columns import in_columns
from tests.io.files import save
from tests.io.writers.conftest import parse_trc

EDGES = np.array([[0, 1], [1, 2], [2, 3]])


@pytest.fixture
def films(tmp_path, images):
    """Write the images, two sequences of four, at 10 Hz."""
    path = tmp_path / "views.h5"
    save(path, images.replaced(frame_rate=10.0))
    return path


@pytest.fixture
def measured(tmp_path, atoms):
    """Write a dictionary whose edges are 60 cm long altogether."""
    path = tmp_path / "measured.h5"
    dictionary = Dictionary(
        atoms,
        landmark_names=tuple(f"point{j}" for j in range(10)),
        mean_shape=normalise(atoms.mean(0)).points,
        edges=EDGES,
        edge_length=np.array([10.0, 20.0, 30.0]),
        unit="cm",
    )
    write_dictionary(path, dictionary)
    return path


def run(command, name, output, *overrides, **arguments):
    """Run a command; return the names of the files it wrote, and what it says about
    metres.
    """
    config = load_config(name, None, overrides, {"output": output, **arguments})
    outcomes = list(command(config))
    written = [path.name for outcome in outcomes for path in outcome.written]
    rows = dict(row for outcome in outcomes for row in outcome.rows)
    return written, rows.get("Metres", "")


@pytest.fixture
def fit_films(tmp_path, films):
    """Fit the films to a file of this name."""

    def fit_films(dictionary, name, *overrides, landmarks=films):
        arguments = {"landmarks": [landmarks], "dictionary": dictionary}
        return run(fit, "fit", tmp_path / name, *overrides, **arguments)

    return fit_films


@pytest.fixture
def convert_results(tmp_path):
    """Convert results to a file of this name."""

    def convert_results(names, output, *overrides):
        files = [tmp_path / name for name in names]
        return run(convert, "convert", tmp_path / output, *overrides, files=files)

    return convert_results


def points(path):
    """Return the points (f, p, 3) of a TRC file."""
    return np.moveaxis(parse_trc(path).points, 1, 2)


def total_length(shapes):
    """Return the length of all edges (f,)."""
    i, j = EDGES.T
    return np.linalg.norm(shapes[:, i] - shapes[:, j], axis=2).sum(axis=1)


def test_a_fit_is_written_in_metres_at_once(tmp_path, fit_films, measured):
    written, note = fit_films(measured, "now.trc")
    assert written == ["now_a.trc", "now_b.trc"]
    assert "in m by the size of the training shapes, y up as in the image" in note
    for name in written:
        assert_allclose(total_length(points(tmp_path / name)), 0.6)


def test_a_result_is_written_in_metres_later(
    tmp_path, fit_films, convert_results, measured
):
    fit_films(measured, "now.trc")
    fit_films(measured, "result.h5")
    written, _ = convert_results(["result.h5"], "later.trc")
    assert written == ["later_a.trc", "later_b.trc"]
    for name in "ab":
        now = points(tmp_path / f"now_{name}.trc")
        later = points(tmp_path / f"later_{name}.trc")
        assert_array_equal(now, later)


def test_without_a_size_height_is_asked_for(tmp_path, fit_films, dictionary):
    with pytest.raises(InputError, match=r"man\.trc: .*give it, e\.g\. `height=1\.78`"):
        fit_films(dictionary, "man.trc")
    assert not list(tmp_path.glob("man*"))


def test_a_height_is_that_of_the_shapes(tmp_path, fit_films, dictionary):
    _, note = fit_films(dictionary, "man.trc", "height=0.5")
    assert "in m by height 0.5 m" in note
    assert heights(tmp_path / "man_a.trc").max() == pytest.approx(0.5, 0.2)


def test_a_height_is_stored(tmp_path, fit_films, dictionary):
    fit_films(dictionary, "result.h5", "height=0.5")
    stated = read_results(tmp_path / "result.h5").column("stated_height")
    assert_array_equal(stated, np.full(8, 0.5))


def test_a_stored_height_is_used_later_unless_another_is_given(
    tmp_path, fit_films, convert_results, dictionary
):
    fit_films(dictionary, "now.trc", "height=0.5")
    fit_films(dictionary, "result.h5", "height=0.5")
    convert_results(["result.h5"], "later.trc")
    convert_results(["result.h5"], "taller.trc", "height=0.75")
    for name in "ab":
        now = heights(tmp_path / f"now_{name}.trc")
        later = heights(tmp_path / f"later_{name}.trc")
        taller = heights(tmp_path / f"taller_{name}.trc")
        assert_array_equal(now, later)
        assert_allclose(taller, 1.5 * now)


def test_the_page_has_the_height_of_the_files(tmp_path, fit_films, dictionary):
    fit_films(dictionary, "now.trc", "height=0.5")
    fit_films(dictionary, "result.h5", "height=0.5")
    files = {"files": [tmp_path / "result.h5"]}
    (content,), *_ = read_inputs(load_config("view", None, (), files))
    y = content.values["shapes"][:, 1]
    on_the_page = content.values["metres_per_unit"] * np.ptp(y, axis=1)
    in_files = [heights(tmp_path / f"now_{name}.trc") for name in "ab"]
    assert_allclose(on_the_page, np.concatenate(in_files), rtol=1e-9)


def heights(path):
    """Return how high the shapes (f,) of a TRC file are."""
    y = points(path)[..., 1]
    return np.ptp(y, axis=1)


def test_a_height_cannot_be_stored_in_csv(fit_films, dictionary):
    with pytest.raises(InputError, match=r"height: a CSV file keeps .* in \.h5"):
        fit_films(dictionary, "man.csv", "height=0.5")


def test_heights_of_results_that_are_written_together_are_their_own(
    tmp_path, images, fit_films, convert_results, dictionary
):
    for name, height in (("a", 0.5), ("b", 0.75)):
        path = tmp_path / f"{name}.h5"
        rows = [row for row in range(8) if images.sequences[row] == name]
        save(path, images.take(rows).replaced(frame_rate=10.0))
        for output in (f"of_{name}.trc", f"of_{name}.h5"):
            fit_films(dictionary, output, f"height={height}", landmarks=path)
    convert_results(["of_a.h5", "of_b.h5"], "both.trc")
    for name in "ab":
        together = heights(tmp_path / f"both_{name}.trc")
        alone = heights(tmp_path / f"of_{name}.trc")
        assert_array_equal(together, alone)


COUNTS = (
    r"72 of 72 images trusted, .*; (\d+) of 864 joint angles have a standard"
    r" deviation above 15 degrees \(elbow_flex_. \d+%, .*\.\.\.\);"
    r" for inverse kinematics write TRC$"
)


def count_wide(path):
    """Count the standard deviations above 15 degrees in a storage of OpenSim."""
    _, _, body = path.read_text(encoding="utf-8").partition("endheader\n")
    _labels, *rows = body.splitlines()
    cells = [row.split("\t")[1:] for row in rows]
    return (np.array(cells, float) > 15).sum()


def test_a_fit_says_how_certain_joint_angles_are(project, tmp_path):
    overrides = ("keypoints=body_25", "frame_rate=25.0", "image_size=[1280, 720]")
    arguments = {
        "output": tmp_path / "walk.mot",
        "landmarks": [project / "sample_data/openpose"],
        "dictionary": "people",
    }
    outcomes = list(fit(load_config("fit", None, overrides, arguments)))
    line = dict(outcomes[-1].rows)["Result"]
    told = re.search(COUNTS, line)
    deviations = [tmp_path / f"walk_person_{person}_sd.sto" for person in (1, 2)]
    wide_count = sum(count_wide(path) for path in deviations)
    assert wide_count > 0
    assert int(told[1]) == wide_count


def median_length(joints, one, other):
    return np.median(np.linalg.norm(joints[one] - joints[other], axis=1))


@pytest.mark.real_data
def test_a_real_man_is_as_large_as_a_man_and_stands_on_his_feet(real_data, tmp_path):
    """Of four cameras are the true lengths, within a quarter: OpenPose's hips are lower
    than the prior's. The calibration has the floor at 0; the camera's place is as good
    as the size of the man.
    """
    folder = real_data / "detected" / "pose2sim_balancing"
    files = [folder / "openpose_json" / "cam01_json"]
    overrides = (
        "keypoints=body_25b",
        f"camera.calibration={folder / 'Calib_qualisys.toml'}",
        "camera.name=cam_01",
        "method=sequences",
        "frame_rate=60",
        "height=1.72",
    )
    arguments = {"landmarks": files, "dictionary": "people"}
    written, note = run(fit, "fit", tmp_path / "man.trc", *overrides, **arguments)
    every_joint = np.moveaxis(points(tmp_path / written[0]), 1, 0)
    man = dict(zip((*PEOPLE, *FURTHER[:6]), every_joint, strict=True))
    feet = np.minimum(man["lankle"][:, 1], man["rankle"][:, 1])
    head = man["head"][:, 1]
    lowest = min(man[joint][:, 1].min() for joint in PEOPLE)
    assert written[0] == "man_person_1.trc"
    assert "in m by height 1.72 m, y up, the axis z of the extrinsics" in note
    assert median_length(man, "lhip", "lknee") == pytest.approx(0.392, rel=0.25)
    assert median_length(man, "relbow", "rwrist") == pytest.approx(0.249, rel=0.25)
    assert (head - feet > 1.0).all()
    assert lowest == pytest.approx(0, abs=0.15)


HINGES = ("knee_angle_r", "knee_angle_l", "elbow_flex_r", "elbow_flex_l")
QUANTILE = 1.645
"""Of the normal distribution: 90% lie within so many deviations."""


def true_angles(landmarks_file):
    """Return angle -> degrees, of the true shapes in a file."""
    with h5py.File(landmarks_file) as file:
        joints = joint_columns(file["landmark_names"].asstr()[()])
        shapes = in_columns(file["true_shapes"][()])
    names = [angle.name for angle in measurable_angles(joints)]
    up = np.array([0.0, -1.0, 0.0])
    angles, *_ = measure_angles(shapes, up, joints)
    return dict(zip(names, angles.T, strict=True))


@pytest.mark.slow
@pytest.mark.real_data
def test_hinges_of_a_man_on_a_beam(real_data, tmp_path):
    errors = []
    deviations = []
    for camera in ("cam01", "cam03"):
        landmarks = real_data / f"detected/pose2sim_balancing/{camera}.h5"
        output = tmp_path / f"{camera}.angles.csv"
        arguments = {
            "landmarks": [str(landmarks)],
            "dictionary": "people",
            "output": str(output),
        }
        config = load_config("fit", Path("sequences"), ["frame_rate=60"], arguments)
        list(fit(config))
        with output.open() as file:
            rows = list(csv.DictReader(file))
        truth = true_angles(landmarks)
        for name in HINGES:
            angles = np.array([float(row[name]) for row in rows])
            sd = np.array([float(row[f"{name}_sd"]) for row in rows])
            errors.append(angles - truth[name])
            deviations.append(sd)
    distances = np.abs(errors)
    inside = distances <= QUANTILE * np.array(deviations)
    assert distances.mean() == pytest.approx(13.6, rel=0.02)
    assert inside.mean() == pytest.approx(0.936, abs=0.02)
