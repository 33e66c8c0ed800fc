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


RATE = 30.0
"""Frames in a second."""


SPEED = 1.4
"""Metres in a second."""


DISTANCE = 6.0
"""Metres before the camera."""


FOCAL = 704.0


def place_of_joint(name):
    """Return where a joint of the body is (3,), in metres."""
    side, _, part = name.rpartition("_")
    x, y, z = FRONT[part]
    return (-x if side == "right" else x, y, z)


def figure(frames):
    """Landmarks in pixels (n, 2, 17) of a rigid body that walks, with noise."""
    body = np.array([place_of_joint(name) for name in COCO]).T
    start = body + np.array([[-1.5], [-0.9], [DISTANCE]])
    X = np.tile(start, (len(frames), 1, 1))
    X[:, 0] += SPEED / RATE * np.array(frames)[:, None]
    noise = np.random.default_rng(2).standard_normal((len(frames), 2, 17))
    pixels = FOCAL * np.stack([X[:, 0], -X[:, 1]], axis=1) / X[:, 2:]
    return pixels + 0.4 * noise + np.array([[320.0], [240.0]])


def write_lines(path, lines):
    path.write_text("\n".join([*lines, ""]))
    return path


def write_table(path, frames, points):
    lines = [",".join(["frame", *(f"{name}_{axis}" for name in COCO for axis in "xy")])]
    for frame, image in zip(frames, points, strict=True):
        cells = [f"{value:.2f}" for value in image.T.ravel()]
        lines.append(",".join([str(frame), *cells]))
    return write_lines(path.with_suffix(".csv"), lines)


def write_tidy(path, frames, points):
    lines = ["item,landmark,x,y,sequence,frame"]
    for frame, image in zip(frames, points, strict=True):
        for name, (x, y) in zip(COCO, image.T, strict=True):
            lines.append(f"i{frame},{name},{x:.2f},{y:.2f},walk,{frame}")
    return write_lines(path.with_suffix(".csv"), lines)


def write_deeplabcut(path, frames, points):
    lines = [
        ",".join(["scorer", *["n"] * 51]),
        ",".join(["bodyparts", *(name for name in COCO for _ in range(3))]),
        ",".join(["coords", *("x", "y", "likelihood") * 17]),
    ]
    with_likelihood = np.insert(points, 2, 0.9, axis=1)
    for frame, image in zip(frames, with_likelihood, strict=True):
        cells = [f"{value:.2f}" for value in image.T.ravel()]
        lines.append(",".join([str(frame), *cells]))
    return write_lines(path.with_suffix(".csv"), lines)


def write_openpose(path, frames, points):
    path.mkdir()
    with_confidence = np.insert(points, 2, 0.9, axis=1)
    for frame, image in zip(frames, with_confidence, strict=True):
        cells = np.round(image.T.ravel(), 2).tolist()
        contents = {"version": 1.3, "people": [{"pose_keypoints_2d": cells}]}
        file = path / f"walk_{frame:012d}_keypoints.json"
        file.write_text(json.dumps(contents))
    return path


def write_trc(path, frames, points):
    names = "\t\t\t".join(COCO)
    axes = "\t".join(f"{axis}{n}" for n in range(1, 18) for axis in "XYZ")
    lines = [
        "PathFileType\t4\t(X/Y/Z)\twalk.trc",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits",
        f"30\t30\t{len(frames)}\t17\tpx",
        f"Frame#\tTime\t{names}\t\t",
        f"\t\t{axes}",
    ]
    y_up = points * [[1], [-1]]
    in_a_plane = np.insert(y_up, 2, 0.0, axis=1)
    for frame, image in zip(frames, in_a_plane, strict=True):
        cells = "\t".join(f"{value:.2f}" for value in image.T.ravel())
        lines.append(f"{frame + 1}\t{frame / RATE:.6f}\t{cells}")
    return write_lines(path.with_suffix(".trc"), lines)


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
    if refined:
        assert np.isfinite(result.sequence_noise).all()
    (motion,) = find_motions(result, OutputOptions(), "walk")
    return motion.points


def largest_difference(points, others):
    return np.abs(points - others).max()


STRETCHES = [[*range(8)], [*range(20, 28)]]
"""Frames on both sides of a long gap."""


ALL_FRAMES = STRETCHES[0] + STRETCHES[1]


@pytest.mark.parametrize("write", WRITERS.values(), ids=WRITERS)
def test_a_clip_with_a_long_gap_is_its_stretches_lifted_apart(tmp_path, write):
    points = figure(ALL_FRAMES)
    clip = metres(write(tmp_path / "walk", ALL_FRAMES, points), tmp_path)
    assert len(clip) == 28
    assert np.isnan(clip[8:20]).all()
    for number, stretch in enumerate(STRETCHES):
        rows = slice(8 * number, 8 * number + 8)
        part = write(tmp_path / f"part{number}", stretch, points[rows])
        alone = metres(part, tmp_path)
        assert largest_difference(clip[stretch], alone) < 0.03


@pytest.mark.parametrize("write", WRITERS.values(), ids=WRITERS)
def test_one_who_jumps_over_the_gap_keeps_single_images(tmp_path, write):
    points = figure(ALL_FRAMES)
    clip = metres(write(tmp_path / "walk", ALL_FRAMES, points), tmp_path)
    joined_file = write(tmp_path / "joined", range(16), points)
    joined = metres(joined_file, tmp_path, refined=False)
    assert largest_difference(joined, clip[ALL_FRAMES]) > 0.03


@pytest.mark.parametrize("write", [write_tidy, write_openpose])
def test_a_frame_that_is_missing_moves_no_other(tmp_path, write):
    frames = [*range(16)]
    retained = [0, 1, 2, 4, 5, 6, 7, 11, 12, 13, 15]
    points = figure(frames)
    whole = metres(write(tmp_path / "walk", frames, points), tmp_path)
    fewer = metres(write(tmp_path / "left", retained, points[retained]), tmp_path)
    assert largest_difference(fewer[retained], whole[retained]) < 0.03
