"""Four new users, each from the files that they have to what they came for."""

import csv
import json
import resource
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from numpy.testing import assert_allclose

import shapefit
from shapefit.evaluation.metrics import similarity_error
from tests.cli.conftest import run_in


def walk(folder: Path, line: str, code: int = 0) -> tuple[str, str]:
    """Run a command as it is typed in a folder; return standard output and what it
    told.
    """
    done = run_in(folder, *line.split())
    assert done.returncode == code, done.stderr
    return done.stdout, done.stderr


LEARN_DOG = (
    "learn-dict data/animal_train.h5 -o dog.h5 --set prior.components=2"
    " --set k=16 --set iterations=2"
)


FIT_DOG = (
    "fit data/animal_walk.csv -d dog.h5 -o walk.h5"
    " --set min_confidence=0.6 --set frame_rate=25"
)


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


@pytest.fixture
def folder(project, tmp_path):
    """A folder with the sample data in `data`, and ten frames of OpenPose of one
    camera.
    """
    (tmp_path / "data").symlink_to(project / "sample_data")
    (tmp_path / "cam01").mkdir()
    for frame in sorted((project / "sample_data/openpose").iterdir())[:10]:
        (tmp_path / "cam01" / frame.name).symlink_to(frame)
    return tmp_path


def test_a_neuroscientist_lifts_an_animal_of_deeplabcut(folder):
    about_input, _ = walk(folder, "info data/animal_walk.csv")
    walk(folder, LEARN_DOG)
    _, about_fit = walk(folder, FIT_DOG)
    walk(folder, "view walk.h5 -o walk.html")
    _, about_table = walk(folder, "convert walk.h5 -o walk.metres.csv")
    table = rows_of(folder / "walk.metres.csv")
    truth = shapefit.read_shapes(folder / "data/animal_truth.h5")
    result = shapefit.read_results(folder / "walk.h5")
    error = shapefit.evaluate(result, truth, ["similarity"])
    method = "sequences (the dictionary has a prior; change with --method)"
    size = "the size of the images is not known; exact positions in metres need"
    assert "a DeepLabCut or Lightning Pose CSV" in about_input
    assert f"Method  {method}" in about_fit
    assert f"{size} --image-size" in about_fit
    assert "in m by the size of the training shapes" in about_table
    assert {row["landmark"] for row in table} >= {"withers", "left_front_paw"}
    assert {row["trusted"] for row in table} <= {"true", "false"}
    assert error.mean("similarity", "m") < 0.06  # of a dog a metre long


def as_matrix(shapes):
    """Return shapes (n, p, d) stacked as MATLAB users have them, (n d, p)."""
    return np.moveaxis(shapes, 1, 2).reshape(-1, shapes.shape[1])


def normalised(points):
    """Return points (n, d, p) about their middle, in the unit of their spread."""
    centred = points - points.mean(axis=2, keepdims=True)
    return centred / centred.std(axis=2).mean(axis=1)[:, None, None]


def shapes_of(optimum, B):
    """Return sum_i c_i R_i B_i (n, p, 3), and the coefficients (n, k)."""
    M = optimum.transforms
    c = np.linalg.norm(M, 2, axis=(2, 3))
    first = M[:, :, 0]
    second = M[:, :, 1]
    third = np.cross(first, second) / np.where(c > 0, c, 1)[..., None]
    turned = np.stack([first, second, third], axis=2)
    return np.einsum("nkab,kbp->npa", turned, B), c


@pytest.fixture
def arrays(folder):
    """W (n, 2, p) and B (k, 3, p) as MATLAB saves them; the items and landmarks."""
    people = shapefit.read_shapes(folder / "data/people_train.h5").shapes[::60]
    views = shapefit.read_landmarks(folder / "data/people_views.csv")
    visible = np.flatnonzero(np.isfinite(views.landmarks).all(axis=(0, 2)))
    path = folder / "own.mat"
    stacked = {
        "W": as_matrix(views.landmarks[:, visible]),
        "B": as_matrix(people[:, visible]),
    }
    scipy.io.savemat(path, stacked)
    model = scipy.io.loadmat(path)
    W = model["W"].reshape(12, 2, -1)
    B = model["B"].reshape(-1, 3, len(visible))
    return normalised(W), normalised(B), views.items, visible


def test_a_researcher_brings_arrays_and_a_solver(arrays):
    """Shapes by S = sum_i c_i R_i B_i are those of a fit."""
    W, B, _, _ = arrays
    optimum = shapefit.solve(W, B, 0.1)
    shapes, coefficients = shapes_of(optimum, B)
    atoms = shapefit.Dictionary(atoms=np.moveaxis(B, 1, 2))
    fit = shapefit.fit(np.moveaxis(W, 1, 2), atoms, lam=0.1)
    centred = fit.shapes - fit.shapes.mean(axis=1, keepdims=True)
    assert set(optimum.status) == {"optimal"}
    assert_allclose(fit.coefficients, coefficients, atol=1e-6)
    assert_allclose(shapes, centred, atol=1e-5)


def test_shapes_of_a_researcher_are_judged_as_fits_are(arrays, folder):
    W, B, items, visible = arrays
    shapes, _ = shapes_of(shapefit.solve(W, B, 0.1), B)
    truth = shapefit.read_shapes(folder / "data/people_test.h5")
    rows = [truth.items.index(item) for item in items]
    true = truth.shapes[rows][:, visible]
    report = shapefit.evaluate(shapes, true, ["similarity"])
    expected = similarity_error(np.moveaxis(shapes, 1, 2), np.moveaxis(true, 1, 2))
    assert_allclose(report.errors["similarity", "unknown"], expected)


def test_a_researcher_is_told_of_the_solver(arrays):
    W, B, _, _ = arrays
    fault = r"for arrays there is solve\(W, B, lam\)"
    with pytest.raises(shapefit.InputError, match=fault):
        shapefit.fit(W, B)


FIT_ONE = "fit views.h5 -d people --set method=posterior --json -o one.h5"


FIT_PARTS = FIT_ONE.replace("one.h5", "parts/") + " --partition 30"


@pytest.fixture
def views(folder):
    """A file of 128 views in the folder."""
    walk(folder, "project data/people_test.h5 -o all.h5")
    walk(folder, "convert all.h5 -o views.h5 --set every=5")
    return folder / "views.h5"


def report_of(folder, line, code=0):
    """Run a command, and return what it says as JSON."""
    out, _ = walk(folder, line, code)
    return json.loads(out)


def test_an_engineer_resumes_a_run(folder, views):
    done = report_of(folder, FIT_PARTS)
    parts = sorted((folder / "parts").glob("*.h5"))
    parts[0].unlink()
    again = report_of(folder, FIT_PARTS)
    parts_again = sorted((folder / "parts").glob("*.h5"))
    at_last = report_of(folder, FIT_PARTS)
    assert done["command"] == "fit"
    assert done["done"] == 128
    assert done["failed"] == 0
    assert len(parts) > 1
    assert f"{len(parts)} of {len(parts)} parts" in json.dumps(done["summary"])
    assert 0 < again["done"] < 128
    assert parts_again == parts
    assert at_last["done"] == 0


def test_an_engineer_reads_codes_of_images_that_are_not_trusted(folder, views):
    line = f"{FIT_ONE} --fail-untrusted 0"
    report = report_of(folder, line, code=1)
    _, told = walk(folder, line.replace("--json", ""), code=1)
    assert 0 < sum(report["untrusted"].values()) < 12
    assert "are not trusted, more than --fail-untrusted allows" in told


def test_an_engineer_reads_the_code_of_a_bad_input(folder):
    (folder / "bad.h5").write_text("no landmarks")
    _, told = walk(folder, FIT_PARTS.replace("views.h5", "bad.h5"), code=2)
    assert "bad.h5: is not an HDF5 file" in told


@pytest.mark.slow
@pytest.mark.real_data
def test_a_folder_of_a_real_camera_is_a_motion_after_two_commands(real_data, tmp_path):
    """100 frames of OpenPose with a bystander; five seconds, and some for a busy
    machine.
    """
    camera = real_data / "detected/pose2sim_balancing/openpose_json/cam01_json"
    keys = "--set keypoints=body_25b --set frame_rate=60"
    program = str(Path(sys.executable).with_name("shapefit"))
    commands = (
        f"{program} fit {camera} -d people {keys} -o man.trc",
        f"{program} view man_person_1.trc -o man.html",
    )
    before = seconds_of_children()
    for command in commands:
        subprocess.run(command.split(), check=True, capture_output=True, cwd=tmp_path)
    seconds = seconds_of_children() - before
    angles = rows_of(tmp_path / "man_person_1_angles.csv")
    assert seconds < 7
    assert len(angles) == 100
    assert (tmp_path / "man.html").stat().st_size > 10_000


def seconds_of_children() -> float:
    return resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime


@pytest.mark.slow
@pytest.mark.real_data
def test_a_real_mouse_of_deeplabcut_is_lifted_by_its_own_class(real_data, tmp_path):
    for name in ("2D", "3D"):
        source = real_data / f"formats/dlc/reachingDEMO_{name}.h5"
        (tmp_path / f"{name}.h5").symlink_to(source)
    walk(tmp_path, "learn-dict 3D.h5 -o mouse.h5 --set k=8 --set prior.components=1")
    _, told = walk(tmp_path, "fit 2D.h5 -d mouse.h5 -o mouse_fit.h5")
    result = shapefit.read_results(tmp_path / "mouse_fit.h5")
    assert "Method  sequences" in told
    assert len(result) == 300
    assert np.isfinite(result.shape_sd).all()
