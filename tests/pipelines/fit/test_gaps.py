"""A figure that walks past a camera, and is lost for a while: from files of other tools
to metres.
"""

import json

import numpy as np
import pytest

from shapefit.io.options import OutputOptions
from shapefit.io.skeletons import installed_skeletons
from shapefit.io.writers.motion import find_motions
from tests.pipelines.fitted import fit_file

COCO = installed_skeletons()["coco_17"].landmark_names
FRONT = {
    "nose": (0, 1.6, 0.1),
    "eye": (0.04, 1.64, 0.07),
    "ear": (0.08, 1.62, 0.0),
    "shoulder": (0.2, 1.4, 0.0),
    "elbow": (0.27, 1.12, 0.03),
    "wrist": (0.28, 0.87, 0.08),
    "hip": (0.11, 0.9, 0.0),
    "knee": (0.12, 0.5, 0.02),
    "ankle": (0.13, 0.1, -0.03),
}
RATE, SPEED, AWAY, FOCAL = 30.0, 1.4, 6.0, 704.0


def figure(frames):
    """Landmarks in pixels (n, 2, 17) of a rigid body that walks, with noise."""
    body = []
    for name in COCO:
        side, _, part = name.rpartition("_")
        x, y, z = FRONT[part]
        body.append((-x if side == "right" else x, y, z))
    X = np.array(body).T + np.array([[-1.5], [-0.9], [AWAY]])
    X = np.tile(X, (len(frames), 1, 1))
    X[:, 0] += SPEED / RATE * np.array(frames)[:, None]
    noise = np.random.default_rng(2).standard_normal((len(frames), 2, 17))
    pixels = FOCAL * np.stack([X[:, 0], -X[:, 1]], axis=1) / X[:, 2:]
    return pixels + 0.4 * noise + np.array([[320.0], [240.0]])


def write_table(path, frames, points):
    path = path.with_suffix(".csv")
    head = ",".join(["frame", *(f"{name}_{axis}" for name in COCO for axis in "xy")])
    rows = [
        ",".join(f"{value:.2f}" for value in (frame, *one.T.ravel()))
        for frame, one in zip(frames, points, strict=True)
    ]
    path.write_text("\n".join([head, *rows, ""]).replace(".00,", ",", len(rows)))
    return path


def write_tidy(path, frames, points):
    path = path.with_suffix(".csv")
    rows = [
        f"i{frame},{name},{x:.2f},{y:.2f},walk,{frame}"
        for frame, one in zip(frames, points, strict=True)
        for name, (x, y) in zip(COCO, one.T, strict=True)
    ]
    path.write_text("\n".join(["item,landmark,x,y,sequence,frame", *rows, ""]))
    return path


def write_deeplabcut(path, frames, points):
    path = path.with_suffix(".csv")
    head = [
        ",".join(["scorer", *["n"] * 51]),
        ",".join(["bodyparts", *(name for name in COCO for _ in range(3))]),
        ",".join(["coords", *("x", "y", "likelihood") * 17]),
    ]
    cells = np.insert(points, 2, 0.9, axis=1)
    rows = [
        ",".join([str(frame), *(f"{value:.2f}" for value in one.T.ravel())])
        for frame, one in zip(frames, cells, strict=True)
    ]
    path.write_text("\n".join([*head, *rows, ""]))
    return path


def write_openpose(path, frames, points):
    path.mkdir()
    cells = np.insert(points, 2, 0.9, axis=1)
    for frame, one in zip(frames, cells, strict=True):
        people = [{"pose_keypoints_2d": np.round(one.T.ravel(), 2).tolist()}]
        text = json.dumps({"version": 1.3, "people": people})
        (path / f"walk_{frame:012d}_keypoints.json").write_text(text)
    return path


def write_trc(path, frames, points):
    path = path.with_suffix(".trc")
    names = "\t\t\t".join(COCO)
    axes = "\t".join(f"{axis}{n}" for n in range(1, 18) for axis in "XYZ")
    lines = [
        "PathFileType\t4\t(X/Y/Z)\twalk.trc",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits",
        f"30\t30\t{len(frames)}\t17\tpx",
        f"Frame#\tTime\t{names}\t\t",
        f"\t\t{axes}",
    ]
    flat = np.insert(points * [[1], [-1]], 2, 0.0, axis=1)
    for frame, one in zip(frames, flat, strict=True):
        cells = "\t".join(f"{value:.2f}" for value in one.T.ravel())
        lines.append(f"{frame + 1}\t{frame / RATE:.6f}\t{cells}")
    path.write_text("\n".join([*lines, ""]))
    return path


WRITERS = {
    "table": write_table,
    "tidy CSV": write_tidy,
    "DeepLabCut": write_deeplabcut,
    "OpenPose": write_openpose,
    "TRC": write_trc,
}


def metres(path, folder, refined=True):
    """Points (f, 3, p) of all frames of the one sequence that is lifted from a file."""
    keys = {"method": "sequences", "frame_rate": RATE, "image_size": [640, 480]}
    result, _ = fit_file(path, "people", folder / f"{path.stem}.h5", **keys)
    assert np.isfinite(result.sequence_noise).all() or not refined
    (motion,) = find_motions(result, OutputOptions(), "walk")
    return motion.points


@pytest.mark.parametrize("write", WRITERS.values(), ids=WRITERS)
def test_a_clip_with_a_long_gap_is_its_stretches_lifted_apart(tmp_path, write):
    stretches = [[*range(8)], [*range(20, 28)]]
    given = [frame for stretch in stretches for frame in stretch]
    points = figure(given)
    found = metres(write(tmp_path / "walk", given, points), tmp_path)
    assert len(found) == 28
    assert np.isnan(found[8:20]).all()
    for number, stretch in enumerate(stretches):
        rows = slice(8 * number, 8 * number + 8)
        path = write(tmp_path / f"part{number}", stretch, points[rows])
        alone = metres(path, tmp_path)
        assert np.abs(found[stretch] - alone).max() < 0.03
    joined = write(tmp_path / "joined", range(16), points)
    away = np.abs(metres(joined, tmp_path, refined=False) - found[given])
    assert away.max() > 0.03  # one who jumps over the gap keeps single images


@pytest.mark.parametrize("write", [write_tidy, write_openpose])
def test_a_frame_that_is_missing_moves_no_other(tmp_path, write):
    frames = [*range(16)]
    points = figure(frames)
    whole = metres(write(tmp_path / "walk", frames, points), tmp_path)
    left = [0, 1, 2, 4, 5, 6, 7, 11, 12, 13, 15]
    found = metres(write(tmp_path / "left", left, points[left]), tmp_path)
    assert np.abs(found[left] - whole[left]).max() < 0.03
