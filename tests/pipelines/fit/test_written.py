"""`fit` writes TRC, tables, meshes and angles, and what it stores lets `convert` do so
later.
"""

import csv
import re
from pathlib import Path

import h5py
import numpy as np
import pytest

from shapefit.config import load_config
from shapefit.dictionary.model import Dictionary
from shapefit.errors import InputError
from shapefit.geometry.joint_angles import measurable_angles, measure_angles
from shapefit.geometry.normalisation import normalise
from shapefit.io import write_dictionary
from shapefit.io.skeletons import FURTHER, PEOPLE, joint_columns
from shapefit.pipelines.convert import convert_files
from shapefit.pipelines.fit.run import run as fit
from shapefit.pipelines.view.reading import read_inputs
from tests.io.files import save

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
    mean = normalise(atoms.mean(0)).points
    names = tuple(f"point{j}" for j in range(10))
    lengths = np.array([10.0, 20.0, 30.0])
    write_dictionary(
        path,
        Dictionary(atoms, names, mean, edges=EDGES, edge_length=lengths, unit="cm"),
    )
    return path


def run(command, name, output, *overrides, **arguments):
    config = load_config(name, None, overrides, {"output": output, **arguments})
    outcomes = list(command(config))
    written = [path.name for outcome in outcomes for path in outcome.written]
    rows = dict(row for outcome in outcomes for row in outcome.rows)
    return written, rows.get("Metres", "")


def points(path):
    lines = path.read_text(encoding="utf-8").splitlines()[5:]
    numbers = np.array([line.split("\t") for line in lines], dtype=float)
    return numbers[:, 2:].reshape(len(lines), -1, 3)


def total(found):
    i, j = EDGES.T
    return np.linalg.norm(found[:, i] - found[:, j], axis=2).sum(axis=1)


def test_a_fit_is_written_in_metres_at_once_or_later(tmp_path, films, measured):
    given = {"landmarks": [films], "dictionary": measured}
    written, note = run(fit, "fit", tmp_path / "now.trc", **given)
    assert written == ["now_a.trc", "now_b.trc"]
    assert "in m by the size of the training shapes, y up as in the image" in note
    run(fit, "fit", tmp_path / "result.h5", **given)
    written, _ = run(
        convert_files, "convert", tmp_path / "later.trc", files=[tmp_path / "result.h5"]
    )
    assert written == ["later_a.trc", "later_b.trc"]
    for name in "ab":
        now, later = (
            points(tmp_path / f"{when}_{name}.trc") for when in ("now", "later")
        )
        np.testing.assert_array_equal(now, later)
        np.testing.assert_allclose(total(now), 0.6)


def test_without_a_size_height_is_asked_for(tmp_path, films, dictionary):
    given = {"landmarks": [films], "dictionary": dictionary}
    with pytest.raises(InputError, match=r"man\.trc: .*give it, e\.g\. `height=1\.78`"):
        run(fit, "fit", tmp_path / "man.trc", **given)
    assert not list(tmp_path.glob("man*"))
    _, note = run(fit, "fit", tmp_path / "man.trc", "height=0.5", **given)
    assert "in m by height 0.5 m" in note
    assert np.ptp(
        points(tmp_path / "man_a.trc")[..., 1], axis=1
    ).max() == pytest.approx(0.5, 0.2)


def heights(path):
    return np.ptp(points(path)[..., 1], axis=1)


def test_a_height_is_stored_and_used_later(tmp_path, films, dictionary):
    given = {"landmarks": [films], "dictionary": dictionary}
    run(fit, "fit", tmp_path / "now.trc", "height=0.5", **given)
    run(fit, "fit", tmp_path / "result.h5", "height=0.5", **given)
    with h5py.File(tmp_path / "result.h5") as file:
        np.testing.assert_array_equal(file["stated_height"], np.full(8, 0.5))
    files = {"files": [tmp_path / "result.h5"]}
    run(convert_files, "convert", tmp_path / "later.trc", **files)
    run(convert_files, "convert", tmp_path / "taller.trc", "height=0.75", **files)
    for name in "ab":
        now = heights(tmp_path / f"now_{name}.trc")
        later = heights(tmp_path / f"later_{name}.trc")
        np.testing.assert_array_equal(now, later)
        taller = heights(tmp_path / f"taller_{name}.trc")
        np.testing.assert_allclose(taller, 1.5 * now)
    (content,), *_ = read_inputs(load_config("view", None, (), files))
    sizes = content.values["metres_per_unit"]
    on_the_page = sizes * np.ptp(content.values["shapes"][:, 1], axis=1)
    in_files = [heights(tmp_path / f"now_{name}.trc") for name in "ab"]
    np.testing.assert_allclose(on_the_page, np.concatenate(in_files), rtol=1e-9)


def test_a_height_cannot_be_stored_in_csv(tmp_path, films, dictionary):
    given = {"landmarks": [films], "dictionary": dictionary}
    with pytest.raises(InputError, match=r"height: a CSV file keeps .* in \.h5"):
        run(fit, "fit", tmp_path / "man.csv", "height=0.5", **given)


def test_heights_of_results_that_are_written_together_are_their_own(
    tmp_path, images, dictionary
):
    for name, height in (("a", 0.5), ("b", 0.75)):
        path = tmp_path / f"{name}.h5"
        rows = [row for row in range(8) if images.sequences[row] == name]
        save(path, images.take(rows).replaced(frame_rate=10.0))
        given = {"landmarks": [path], "dictionary": dictionary}
        one = run(fit, "fit", tmp_path / f"of_{name}.trc", f"height={height}", **given)
        assert one[0] == [f"of_{name}.trc"]
        run(fit, "fit", tmp_path / f"of_{name}.h5", f"height={height}", **given)
    both = [tmp_path / "of_a.h5", tmp_path / "of_b.h5"]
    run(convert_files, "convert", tmp_path / "both.trc", files=both)
    for name in "ab":
        np.testing.assert_array_equal(
            heights(tmp_path / f"both_{name}.trc"), heights(tmp_path / f"of_{name}.trc")
        )


def test_a_fit_says_how_certain_joint_angles_are(project, tmp_path):
    overrides = ("keypoints=body_25", "frame_rate=25.0", "image_size=[1280, 720]")
    given = {"landmarks": [project / "sample_data/openpose"], "dictionary": "people"}
    config = {"output": tmp_path / "walk.mot", **given}
    outcomes = list(fit(load_config("fit", None, overrides, config)))
    result = dict(outcomes[-1].rows)["Result"]
    counts = re.search(
        r"72 of 72 images trusted, .*; (\d+) of 864 joint angles have a standard"
        r" deviation above 15 degrees \(elbow_flex_. \d+%, .*\.\.\.\);"
        r" for inverse kinematics write TRC$",
        result,
    )
    wide = 0
    for person in (1, 2):
        path = tmp_path / f"walk_person_{person}_sd.sto"
        body = path.read_text(encoding="utf-8").partition("endheader\n")[2]
        cells = [line.split("\t")[1:] for line in body.splitlines()[1:]]
        wide += int((np.array(cells, float) > 15).sum())
    assert int(counts[1]) == wide > 0


@pytest.mark.real_data
def test_a_real_man_is_as_large_as_a_man_and_stands_on_his_feet(real_data, tmp_path):
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
    given = {"landmarks": files, "dictionary": "people"}
    written, note = run(fit, "fit", tmp_path / "man.trc", *overrides, **given)
    assert written[0] == "man_person_1.trc"
    assert "in m by height 1.72 m, y up, the axis z of the extrinsics" in note
    joints = points(tmp_path / written[0]).transpose(1, 0, 2)
    man = dict(zip((*PEOPLE, *FURTHER[:6]), joints, strict=True))
    # The truth, from four cameras, within a quarter; OpenPose's hips are lower than the
    # prior's.
    for a, b, length in (("lhip", "lknee", 0.392), ("relbow", "rwrist", 0.249)):
        median = np.median(np.linalg.norm(man[a] - man[b], axis=1))
        assert median == pytest.approx(length, rel=0.25)
    feet = np.minimum(man["lankle"][:, 1], man["rankle"][:, 1])
    assert ((man["head"][:, 1] - feet) > 1.0).all()
    # The calibration has the floor at 0, the camera's place is as good as the size of
    # the man.
    assert min(man[joint][:, 1].min() for joint in PEOPLE) == pytest.approx(0, abs=0.15)


HINGES = tuple(
    f"{joint}_{side}" for joint in ("knee_angle", "elbow_flex") for side in "rl"
)
QUANTILE = 1.645
"""Of the normal distribution: 90% lie within so many deviations."""


@pytest.mark.slow
@pytest.mark.real_data
def test_hinges_of_a_man_on_a_beam(real_data, tmp_path):
    errors, deviations = [], []
    for camera in ("cam01", "cam03"):
        landmarks = real_data / f"detected/pose2sim_balancing/{camera}.h5"
        output = tmp_path / f"{camera}.angles.csv"
        arguments = {
            "landmarks": [str(landmarks)],
            "dictionary": "people",
            "output": str(output),
        }
        rate = ["frame_rate=60"]
        list(fit(load_config("fit", Path("sequences"), rate, arguments)))
        with output.open() as file:
            rows = list(csv.DictReader(file))
        with h5py.File(landmarks) as file:
            joints = joint_columns(file["landmark_names"].asstr()[()])
            shapes = file["true_shapes"][()].swapaxes(1, 2)
        truth = dict(
            zip(
                (angle.name for angle in measurable_angles(joints)),
                measure_angles(shapes, np.array([0.0, -1.0, 0.0]), joints)[0].T,
                strict=True,
            )
        )
        for name in HINGES:
            errors.append(np.array([float(row[name]) for row in rows]) - truth[name])
            deviations.append(np.array([float(row[f"{name}_sd"]) for row in rows]))
    distance = np.abs(errors)
    assert distance.mean() == pytest.approx(13.6, rel=0.02)
    assert (distance <= QUANTILE * np.array(deviations)).mean() == pytest.approx(
        0.936, abs=0.02
    )
