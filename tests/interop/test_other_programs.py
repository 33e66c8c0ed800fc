"""What other programs read of files that `convert` writes: OpenSim, movement, ezc3d,
bvhio and trimesh, in the environment of `make interop`.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from shapefit.cli.main import run

from shapefit.io import read_results, read_shapes

PROJECT = Path(__file__).resolve().parents[2]
PYTHON = (
    PROJECT
    / ".venv/interop"
    / ("Scripts/python.exe" if sys.platform == "win32" else "bin/python")
)

pytestmark = [pytest.mark.slow, pytest.mark.interop]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two people who walk and a car, in every format for other programs."""
    if not PYTHON.is_file():
        reason = "the other programs are not installed: run `make interop`"
        if os.environ.get("SHAPEFIT_REQUIRE_INTEROP") == "1":
            pytest.fail(reason)
        pytest.skip(reason)
    folder = tmp_path_factory.mktemp("interop")
    data = PROJECT / "sample_data"
    options = ["--frame-rate", "25", "--image-size", "1280x720"]
    walk = str(folder / "walk.h5")
    assert run(["fit", f"{data}/openpose", *options, "-o", walk]) == 0
    for suffix in ("mot", "trc", "c3d", "bvh", "nc", "toml"):
        assert run(["convert", walk, "-o", str(folder / f"walk.{suffix}")]) == 0
    cars = str(folder / "cars.h5")
    fitted = str(folder / "fitted.h5")
    learn = ["--method", "exemplars", "--set", "align=none", "-o", cars]
    assert run(["learn-dict", f"{data}/cars.h5", *learn]) == 0
    convex = ["--method", "convex+refine", "-o", fitted]
    assert run(["fit", f"{data}/cars_views.h5", "-d", cars, *convex]) == 0
    for suffix in ("obj", "ply", "glb"):
        meshes = ["-d", cars, "-o", str(folder / suffix), "--to", suffix]
        assert run(["convert", fitted, *meshes]) == 0
    return folder


def judge(*paths):
    """Return what the other programs find in files, by path."""
    script = Path(__file__).with_name("judge.py")
    command = [str(PYTHON), "-P", str(script), *map(str, paths)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout[done.stdout.index("{") :])
    return [found[str(path)] for path in paths]


@pytest.mark.parametrize("person", [1, 2])
def test_opensim_reads_all_rows_of_angles_and_of_deviations(folder, person):
    paths = [folder / f"walk_person_{person}{end}" for end in (".mot", "_sd.sto")]
    for path, found in zip(paths, judge(*paths), strict=True):
        body = path.read_text(encoding="utf-8").partition("endheader\n")[2]
        labels, *lines = body.splitlines()
        cells = np.array([line.split("\t") for line in lines], float)
        assert len(cells) == 36
        assert found["in_degrees"]
        assert found["labels"] == labels.split("\t")[1:]
        for reader in ("storage", "table"):
            assert_allclose(found[f"{reader}_times"], cells[:, 0])
            assert_allclose(found[reader], cells[:, 1:])


def test_points_in_trc_c3d_and_bvh_are_those_that_were_written(folder):
    stem = folder / "walk_person_1"
    trc, c3d, bvh = judge(*(stem.with_suffix(end) for end in (".trc", ".c3d", ".bvh")))
    written = read_shapes([stem.with_suffix(".trc")])
    expected = written.shapes
    assert trc["unit"] == "m"
    assert c3d["unit"] == "mm"
    assert trc["labels"] == c3d["labels"] == list(written.landmark_names)
    assert_allclose(trc["points"], expected, atol=1e-6)
    assert_allclose(np.array(c3d["points"]) / 1000, expected, atol=1e-6)
    bones = read_shapes([stem.with_suffix(".bvh")])
    for name, points in zip(
        bvh["labels"], np.swapaxes(bvh["points"], 0, 1), strict=True
    ):
        if name in bones.landmark_names:
            ours = bones.shapes[:, bones.landmark_names.index(name)]
            assert_allclose(points, ours, atol=1e-4, err_msg=name)


def test_movement_reads_points_times_and_names(folder):
    (poses,) = judge(folder / "walk.nc")
    assert poses["individuals"] == ["openpose_person 1", "openpose_person 2"]
    assert poses["fps"] == 25
    for person, points in enumerate(poses["points"], start=1):
        written = read_shapes([folder / f"walk_person_{person}.trc"])
        assert poses["labels"] == list(written.landmark_names)
        assert_allclose(poses["times"], np.arange(36) / 25)
        assert_allclose(points, written.shapes, atol=1e-6)
    assert 1 < poses["speed"] < 10  # m/s, of people who walk


def test_a_fit_with_the_camera_that_was_written_is_the_same(folder):
    """The reader of calibrations is our own: it reads those of Pose2Sim, too."""
    command = ["fit", f"{PROJECT}/sample_data/openpose", "--frame-rate", "25"]
    camera = ["--calibration", str(folder / "walk.toml")]
    again = folder / "again.h5"
    assert run([*command, *camera, "-o", str(again)]) == 0
    first, second = (read_results(path) for path in (folder / "walk.h5", again))
    assert_allclose(second.shapes, first.shapes, rtol=0.02, atol=5)
    assert_array_equal(second.focal, first.focal)


def test_meshes_are_the_same_in_every_format(folder):
    of_obj = sorted((folder / "obj").rglob("*.obj"))[:3]
    assert len(of_obj) == 3
    for path in of_obj:
        name = path.relative_to(folder / "obj")
        others = [
            (folder / end / name).with_suffix(f".{end}") for end in ("ply", "glb")
        ]
        first, *rest = judge(path, *others)
        assert first["faces"] > 100
        for found in rest:
            assert found["faces"] == first["faces"]
            assert_allclose(found["bounds"], first["bounds"], atol=1e-4)
