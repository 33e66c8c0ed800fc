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

import shapefit
from shapefit.evaluation.metrics import similarity
from tests.cli.conftest import run_in


def walk(folder: Path, line: str, code: int = 0) -> tuple[str, str]:
    """Run a command as it is typed in a folder; return standard output and what it
    told.
    """
    done = run_in(folder, *line.split())
    assert done.returncode == code, done.stderr
    return done.stdout, done.stderr


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
    told, _ = walk(folder, "info data/animal_walk.csv")
    assert "a DeepLabCut or Lightning Pose CSV" in told
    learn = "learn-dict data/animal_train.h5 -o dog.h5 --set prior.components=2"
    walk(folder, f"{learn} --set k=16 --set iterations=2")
    keys = "--set min_confidence=0.6 --set frame_rate=25"
    _, told = walk(folder, f"fit data/animal_walk.csv -d dog.h5 -o walk.h5 {keys}")
    assert (
        "Method  sequences (the dictionary has a prior; change with --method)" in told
    )
    assert (
        "the size of the images is not known; exact positions in metres need"
        " --image-size" in told
    )
    walk(folder, "view walk.h5 -o walk.html")
    _, told = walk(folder, "convert walk.h5 -o walk.metres.csv")
    assert "in m by the size of the training shapes" in told
    table = rows_of(folder / "walk.metres.csv")
    assert {row["landmark"] for row in table} >= {"withers", "left_front_paw"}
    assert {row["trusted"] for row in table} <= {"true", "false"}
    truth = shapefit.read_shapes(folder / "data/animal_truth.h5")
    error = shapefit.evaluate(
        shapefit.read_results(folder / "walk.h5"), truth, ["similarity"]
    )
    assert error.mean("similarity", "m") < 0.06  # of a dog a metre long


def test_a_researcher_brings_arrays_and_a_solver(folder):
    """W and B as MATLAB saves them; shapes by S = sum_i c_i R_i B_i, judged as fits
    are.
    """
    people = shapefit.read_shapes(folder / "data/people_train.h5").shapes[::60]
    views = shapefit.read_landmarks(folder / "data/people_views.csv")
    visible = np.flatnonzero(np.isfinite(views.landmarks).all(axis=(0, 2)))
    stacked = {"W": views.landmarks, "B": people}
    stacked = {
        name: X[:, visible].swapaxes(1, 2).reshape(-1, len(visible))
        for name, X in stacked.items()
    }
    scipy.io.savemat(folder / "own.mat", stacked)
    model = scipy.io.loadmat(folder / "own.mat")
    W = model["W"].reshape(12, 2, -1)
    B = model["B"].reshape(-1, 3, len(visible))
    W, B = (X - X.mean(axis=2, keepdims=True) for X in (W, B))
    W, B = (X / X.std(axis=2).mean(axis=1)[:, None, None] for X in (W, B))
    found = shapefit.solve(W, B, 0.1)
    assert set(found.status) == {"optimal"}
    c = np.linalg.norm(found.transforms, 2, axis=(2, 3))
    first, second = found.transforms[:, :, 0], found.transforms[:, :, 1]
    third = np.cross(first, second) / np.where(c > 0, c, 1)[..., None]
    own = np.einsum("nkab,kbp->npa", np.stack([first, second, third], axis=2), B)
    atoms = shapefit.Dictionary(atoms=B.swapaxes(1, 2))
    fitted = shapefit.fit(W.swapaxes(1, 2), atoms, lam=0.1)
    np.testing.assert_allclose(fitted.coefficients, c, atol=1e-6)
    centred = fitted.shapes - fitted.shapes.mean(axis=1, keepdims=True)
    np.testing.assert_allclose(own, centred, atol=1e-5)
    truth = shapefit.read_shapes(folder / "data/people_test.h5")
    true = truth.shapes[[truth.items.index(item) for item in views.items]][:, visible]
    report = shapefit.evaluate(own, true, ["similarity"])
    by_hand = similarity(own.swapaxes(1, 2), true.swapaxes(1, 2))
    np.testing.assert_allclose(report.errors["similarity", "unknown"], by_hand)
    with pytest.raises(
        shapefit.InputError, match=r"for arrays there is solve\(W, B, lam\)"
    ):
        shapefit.fit(W, B)


def test_an_engineer_resumes_and_reads_codes_and_json(folder):
    walk(folder, "project data/people_test.h5 -o all.h5")
    walk(folder, "convert all.h5 -o views.h5 --set every=5")
    one = "fit views.h5 -d people --set method=posterior --json -o one.h5"
    fit = f"{one.replace('one.h5', 'parts/')} --partition 30"
    done = json.loads(walk(folder, fit)[0])
    assert done["command"] == "fit"
    assert done["done"] == 128
    assert done["failed"] == 0
    parts = sorted(path.name for path in (folder / "parts").glob("*.h5"))
    assert len(parts) > 1
    assert f"{len(parts)} of {len(parts)} parts" in json.dumps(done["summary"])
    (folder / "parts" / parts[0]).unlink()
    again = json.loads(walk(folder, fit)[0])
    assert 0 < again["done"] < 128
    assert parts == sorted(path.name for path in (folder / "parts").glob("*.h5"))
    assert json.loads(walk(folder, fit)[0])["done"] == 0
    out, _ = walk(folder, f"{one} --fail-untrusted 0", code=1)
    assert 0 < sum(json.loads(out)["untrusted"].values()) < 12
    _, told = walk(folder, f"{one.replace('--json', '')} --fail-untrusted 0", code=1)
    assert "are not trusted, more than --fail-untrusted allows" in told
    (folder / "bad.h5").write_text("no landmarks")
    _, told = walk(folder, fit.replace("views.h5", "bad.h5"), code=2)
    assert "bad.h5: is not an HDF5 file" in told


@pytest.mark.slow
@pytest.mark.real_data
def test_a_folder_of_a_real_camera_is_a_motion_after_two_commands(real_data, tmp_path):
    """100 frames of OpenPose with a bystander; five seconds, and some for a busy
    machine.
    """
    camera = real_data / "detected/pose2sim_balancing/openpose_json/cam01_json"
    command = [str(Path(sys.executable).with_name("shapefit"))]
    lines = (
        (
            f"fit {camera} -d people --set keypoints=body_25b --set frame_rate=60 -o"
            " man.trc"
        ),
        "view man_person_1.trc -o man.html",
    )
    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    for line in lines:
        subprocess.run(
            [*command, *line.split()], check=True, capture_output=True, cwd=tmp_path
        )
    assert resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before < 7
    angles = rows_of(tmp_path / "man_person_1_angles.csv")
    assert len(angles) == 100
    assert (tmp_path / "man.html").stat().st_size > 10_000


@pytest.mark.slow
@pytest.mark.real_data
def test_a_real_mouse_of_deeplabcut_is_lifted_by_its_own_class(real_data, tmp_path):
    for name in ("2D", "3D"):
        (tmp_path / f"{name}.h5").symlink_to(
            real_data / f"formats/dlc/reachingDEMO_{name}.h5"
        )
    walk(tmp_path, "learn-dict 3D.h5 -o mouse.h5 --set k=8 --set prior.components=1")
    _, told = walk(tmp_path, "fit 2D.h5 -d mouse.h5 -o mouse_fit.h5")
    assert "Method  sequences" in told
    found = shapefit.read_results(tmp_path / "mouse_fit.h5")
    assert len(found) == 300
    assert np.isfinite(found.shape_sd).all()
