"""Every reader that knows the number or the time of a frame gives it: files with
dropped, unsorted and repeated frames.
"""

import json
from collections.abc import Callable, Sequence
from pathlib import Path

import h5py
import numpy as np
import pytest

from shapefit.errors import InputError
from shapefit.io import open_landmarks, read_shapes
from shapefit.io.options import InputOptions

from . import made

RATE = 30.0
COUNT = 17

Frames = Sequence[int]


def at(frame: int) -> np.ndarray:
    """The landmarks of a frame (17, 2): x of the first is 100 + frame."""
    points = np.arange(2.0 * COUNT).reshape(COUNT, 2) + 100
    points[:, 0] += frame
    return points


def flat(frame: int) -> list[float]:
    return np.column_stack([at(frame), np.full(COUNT, 0.5)]).ravel().tolist()


def text(path: Path, content: object) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    is_text = isinstance(content, str)
    path.write_text(content if is_text else json.dumps(content), encoding="utf-8")
    return path


def openpose(folder: Path, frames: Frames) -> Path:
    for number in frames:
        people = [{"pose_keypoints_2d": flat(number)}]
        text(folder / f"v_{number:06d}_keypoints.json", {"people": people})
    return folder


def mmpose_images(folder: Path, frames: Frames) -> Path:
    for number in frames:
        scores = [0.5] * COUNT
        person = {"keypoints": at(number).tolist(), "keypoint_scores": scores}
        text(folder / f"{number}.json", [person])
    return folder


def yolo(folder: Path, frames: Frames) -> Path:
    for number in frames:
        cells = " ".join(f"{x / 1000} {y / 1000} 2" for x, y in at(number))
        text(folder / f"image_{number}.txt", f"0 0.5 0.5 0.1 0.1 {cells}\n")
    return folder


def results_by_name(folder: Path, frames: Frames) -> Path:
    entries = [{"image_id": f"{n}.jpg", "keypoints": flat(n)} for n in frames]
    return text(folder / "r.json", entries)


def results_of_a_version(folder: Path, frames: Frames) -> Path:
    """The number of the frame is not the last one in the name."""
    entries = [{"image_id": f"v{n}_720p_2.jpg", "keypoints": flat(n)} for n in frames]
    return text(folder / "r.json", entries)


def results_by_number(folder: Path, frames: Frames) -> Path:
    entries = [{"image_id": n, "keypoints": flat(n)} for n in frames]
    return text(folder / "r.json", entries)


def annotations(folder: Path, frames: Frames) -> Path:
    images = [{"id": 7 * n, "file_name": f"day/{n:05d}.png"} for n in frames]
    entries = [{"image_id": 7 * n, "keypoints": flat(n)} for n in frames]
    return text(folder / "a.json", {"images": images, "annotations": entries})


def mmpose_video(folder: Path, frames: Frames) -> Path:
    scores = [0.5] * COUNT
    entries = [
        {
            "frame_id": number,
            "instances": [
                {"keypoints": at(number).tolist(), "keypoint_scores": scores}
            ],
        }
        for number in frames
    ]
    return text(folder / "m.json", entries)


def points_of(frame: int) -> list[dict[str, float]]:
    return [{"x": x, "y": y, "visibility": 0.5} for x, y in at(frame).tolist()]


def landmark_lists(folder: Path, frames: Frames) -> Path:
    entries = [{"frame": n, "landmarks": points_of(n)} for n in frames]
    return text(folder / "l.json", {"frames": entries})


def numbered_lists(folder: Path, frames: Frames) -> Path:
    cells = ", ".join(f'"{n}": {json.dumps(points_of(n))}' for n in frames)
    return text(folder / "n.json", f"{{{cells}}}")


def deeplabcut(folder: Path, frames: Frames) -> Path:
    names = [f"p{n}" for n in range(COUNT) for _ in range(3)]
    head = ["scorer," + ",".join(["net"] * len(names)), "bodyparts," + ",".join(names)]
    head.append("coords" + ",x,y,likelihood" * COUNT)
    rows = [",".join(map(str, (number, *flat(number)))) for number in frames]
    return text(folder / "d.csv", "\n".join([*head, *rows]) + "\n")


def deeplabcut_hdf5(folder: Path, frames: Frames) -> Path:
    folder.mkdir()
    points = np.array([[at(number)] for number in frames])
    made.write_deeplabcut_hdf5(folder / "d.h5", points, np.ones(points.shape[:3]))
    with h5py.File(folder / "d.h5", "a") as file:
        table = file["df_with_missing/table"]
        rows = table[()]
        rows["index"] = frames
        table[...] = rows
    return folder / "d.h5"


def slp(folder: Path, frames: Frames) -> Path:
    folder.mkdir()
    points = np.array([[at(number)] for number in frames])
    made.write_slp(folder / "s.slp", points, np.ones(points.shape[:3]))
    with h5py.File(folder / "s.slp", "a") as file:
        rows = file["frames"][()]
        rows["frame_idx"] = frames
        file["frames"][...] = rows
    return folder / "s.slp"


def nwb(folder: Path, frames: Frames) -> Path:
    folder.mkdir()
    points = np.array([[at(number)] for number in frames])
    made.write_nwb(folder / "n.nwb", points, np.ones(points.shape[:3]))
    with h5py.File(folder / "n.nwb", "a") as file:
        for series in file["processing/behavior/animal0"].values():
            del series["starting_time"]
            series["timestamps"] = 2 + np.array(frames) / RATE
    return folder / "n.nwb"


def movement(folder: Path, frames: Frames) -> Path:
    folder.mkdir()
    points = np.array([[at(number)] for number in frames])
    made.write_movement(folder / "m.nc", points, np.ones(points.shape[:3]))
    with h5py.File(folder / "m.nc", "a") as file:
        file["time"][...] = 2 + np.array(frames) / RATE
    return folder / "m.nc"


def caliscope(folder: Path, frames: Frames) -> Path:
    lines = ["sync_index,port,frame_index,frame_time,point_id,img_loc_x,img_loc_y"]
    for number in frames:
        lines += [
            f"0,0,{number},{number / RATE},{point},{x},{y}"
            for point, (x, y) in enumerate(at(number))
        ]
    return text(folder / "c.csv", "\n".join(lines) + "\n")


def table(folder: Path, frames: Frames) -> Path:
    lines = ["frame" + "".join(f",p{n}_x,p{n}_y" for n in range(COUNT))]
    lines += [",".join(map(str, (n, *at(n).ravel()))) for n in frames]
    return text(folder / "t.csv", "\n".join(lines) + "\n")


IMAGES: dict[str, Callable[[Path, Frames], Path]] = {
    one.__name__: one
    for one in (
        openpose,
        mmpose_images,
        yolo,
        results_by_name,
        results_of_a_version,
        results_by_number,
        annotations,
        mmpose_video,
        landmark_lists,
        numbered_lists,
        deeplabcut,
        deeplabcut_hdf5,
        slp,
        nwb,
        movement,
        caliscope,
        table,
    )
}
FOLDERS = {"openpose", "mmpose_images", "yolo"}
PEOPLE = {
    "results_by_name",
    "results_of_a_version",
    "results_by_number",
    "annotations",
}
"""Where a frame may have several people, one after the other."""


def read(path: Path):
    """Return frames, and x of the first landmark above that of frame 0."""
    options = InputOptions(keypoints="numbered" if path.suffix != ".csv" else None)
    with open_landmarks([path], options) as source:
        images = source.whole()
    x = images.landmarks[:, 0, 0]
    x = x * 1000 if images.unit.startswith("fraction") else x
    return images, np.rint(x - 100).astype(int).tolist()


@pytest.mark.parametrize("make", IMAGES.values(), ids=IMAGES)
@pytest.mark.parametrize(
    "frames",
    [
        pytest.param((0, 1, 2, 9, 10, 11), id="dropped"),
        pytest.param((1, 3, 2, 12, 0, 5), id="unsorted"),
        pytest.param((0, 1, 10, 11, 2, 3), id="sorted as text"),
    ],
)
def test_frames_are_those_of_the_file(tmp_path, make, frames):
    if make in (nwb, movement):  # times that fall are refused, or put in order
        frames = sorted(frames)
    images, seen = read(make(tmp_path / "v", frames))
    assert seen == sorted(frames)
    got = images.columns["frame"]
    assert (got - got[0]).tolist() == [
        number - min(frames) for number in sorted(frames)
    ]
    if make in (nwb, movement):
        times = 2 + np.array(frames) / RATE
        np.testing.assert_allclose(images.columns["time"], times)


@pytest.mark.parametrize("make", IMAGES.values(), ids=IMAGES)
def test_a_frame_that_repeats_is_refused_or_has_two_people(tmp_path, make):
    if make.__name__ in FOLDERS:
        pytest.skip("names of files do not repeat")
    path = make(tmp_path / "v", (0, 1, 1, 2))
    if make.__name__ in PEOPLE:
        images, seen = read(path)
        assert (seen, len({*images.items})) == ([0, 1, 1, 2], 4)
        assert images.columns["frame"].tolist() == [0, 1, 1, 2]
    elif make is numbered_lists:  # the last of two equal keys of JSON counts
        assert read(path)[1] == [0, 1, 2]
    else:
        with pytest.raises(InputError):
            read(path)


def test_a_few_of_many_numbered_images_are_in_their_order_and_no_frames(tmp_path):
    frames = (785, 139, 397133, 40083)
    images, seen = read(results_by_number(tmp_path / "v", frames))
    assert seen == sorted(frames)
    assert images.columns["frame"].tolist() == [0, 1, 2, 3]


# Motion in 3D


def trc(folder: Path, frames: Frames, times: Sequence[float] | None = None) -> Path:
    times = [number / RATE for number in frames] if times is None else times
    lines = [
        "PathFileType\t4\t(X/Y/Z)\tw.trc",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits",
        f"{RATE:g}\t{RATE:g}\t{len(frames)}\t2\tm",
        "Frame#\tTime\tknee\t\t\tankle\t\t",
        "\t\tX1\tY1\tZ1\tX2\tY2\tZ2",
    ]
    lines += [
        f"{number}\t{time:.4f}\t{number}\t1\t2\t3\t4\t5"
        for number, time in zip(frames, times, strict=True)
    ]
    return text(folder / "w.trc", "\n".join(lines) + "\n")


def vicon(folder: Path, frames: Frames) -> Path:
    lines = ["Trajectories", f"{RATE:g}", ",,knee,,,ankle,,"]
    lines += ["Frame,Sub Frame,X,Y,Z,X,Y,Z", ",,m,m,m,m,m,m"]
    lines += [f"{number},0,{number},1,2,3,4,5" for number in frames]
    return text(folder / "v.csv", "\n".join(lines) + "\n")


def amc(folder: Path, frames: Frames) -> Path:
    bone = "begin\nid 1\nname leg\ndirection 0 1 0\nlength 1\naxis 0 0 0 XYZ\nend\n"
    text(
        folder / "s.asf",
        ":units\nlength 1.0\nangle deg\n:root\norder TX TY TZ RX RY RZ\naxis XYZ\n"
        "position 0 0 0\norientation 0 0 0\n:bonedata\n"
        f"{bone}:hierarchy\nbegin\nroot leg\nend\n",
    )
    rows = "".join(f"{number}\nroot {number} 0 0 0 0 0\n" for number in frames)
    return text(folder / "s_1.amc", f":FULLY-SPECIFIED\n:DEGREES\n{rows}")


@pytest.mark.parametrize("make", [trc, vicon, amc])
@pytest.mark.parametrize("frames", [(1, 2, 3, 10, 11, 12), (3, 1, 2, 12, 7), (5, 6)])
def test_frames_of_motion_are_those_of_the_file(tmp_path, make, frames):
    shapes = read_shapes([make(tmp_path / "v", frames)], gaps=True)
    assert shapes.shapes[:, 0, 0].tolist() == sorted(frames)
    got = shapes.columns["frame"]
    assert (got - got[0]).tolist() == [
        number - min(frames) for number in sorted(frames)
    ]
    with pytest.raises(InputError, match=r"frame 2 twice"):
        read_shapes([make(tmp_path / "twice", (1, 2, 2, 3))], gaps=True)


def test_times_of_trc_count_where_its_frames_were_numbered_anew(tmp_path):
    times = np.array([0, 1, 2, 9, 10]) / RATE
    shapes = read_shapes([trc(tmp_path / "v", range(1, 6), times)], gaps=True)
    assert shapes.columns["frame"].tolist() == [0, 1, 2, 9, 10]
    np.testing.assert_allclose(shapes.columns["time"], times, atol=1e-4)
