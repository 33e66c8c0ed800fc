"""Files as detectors of people write them, made of given points: for tests and measurements.

Points are (frames, people, landmarks, 2), confidence (frames, people, landmarks).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from shapefit.arrays import Floats


def _flat(points: Floats, confidence: Floats) -> list[list[list[float]]]:
    """Return x, y, confidence of all landmarks: [frame][person][number]."""
    rows = np.concatenate([points, confidence[..., None]], axis=3).round(4)
    found: list[list[list[float]]] = rows.reshape(*rows.shape[:2], -1).tolist()
    return found


def _write(path: Path, contents: Any) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(contents), encoding="utf-8")


def write_openpose(path: Path, points: Floats, confidence: Floats) -> None:
    """Write a file per frame into a folder."""
    for frame, people in enumerate(_flat(points, confidence)):
        found = [{"person_id": [-1], "pose_keypoints_2d": person} for person in people]
        _write(path / f"v_{frame:012d}_keypoints.json", {"version": 1.3, "people": found})


def write_results(path: Path, points: Floats, confidence: Floats) -> None:
    """Write COCO results."""
    frames = enumerate(_flat(points, confidence))
    found = [
        {"image_id": frame, "category_id": 1, "keypoints": person, "score": 0.5}
        for frame, people in frames
        for person in people
    ]
    _write(path, found)


def write_annotations(path: Path, points: Floats, confidence: Floats) -> None:
    """Write COCO annotations; landmarks of confidence below 0.1 are not labelled."""
    names = [f"point{number}" for number in range(points.shape[2])]
    visible = np.where(confidence < 0.1, 0.0, 2.0)
    frames = enumerate(_flat(points, visible))
    _write(
        path,
        {
            "images": [{"id": n, "file_name": f"{n:08d}.jpg"} for n in range(len(points))],
            "categories": [{"id": 1, "name": "one", "keypoints": names, "skeleton": [[1, 2]]}],
            "annotations": [
                {"image_id": frame, "category_id": 1, "keypoints": person}
                for frame, people in frames
                for person in people
            ],
        },
    )


def write_mmpose(path: Path, points: Floats, confidence: Floats) -> None:
    """Write MMPose's predictions of a video, with names."""
    names = {str(number): f"point{number}" for number in range(points.shape[2])}
    info = [
        {
            "frame_id": frame,
            "instances": [
                {"keypoints": person.tolist(), "keypoint_scores": scores.tolist()}
                for person, scores in zip(people, certain, strict=True)
            ],
        }
        for frame, (people, certain) in enumerate(zip(points, confidence, strict=True))
    ]
    _write(path, {"meta_info": {"keypoint_id2name": names}, "instance_info": info})


def write_caliscope(path: Path, points: Floats, confidence: Floats) -> None:
    """Write a row per point of the first person."""
    lines = ["sync_index,port,frame_index,frame_time,point_id,img_loc_x,img_loc_y"]
    for frame, people in enumerate(points):
        lines += [
            f"{frame},0,{frame},{frame / 30},{number},{x},{y}"
            for number, (x, y) in enumerate(people[0].tolist())
        ]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def write_yolo(path: Path, points: Floats, confidence: Floats) -> None:
    """Write labels of an image per frame into a folder, and data.yaml."""
    path.mkdir(parents=True, exist_ok=True)
    shape = f"kpt_shape: [{points.shape[2]}, 3]\nnames: {{0: person}}\n"
    (path / "data.yaml").write_text(shape, encoding="utf-8")
    for frame, people in enumerate(_flat(points / 1000, confidence)):
        lines = ["0 0.5 0.5 0.2 0.4 " + " ".join(map(str, person)) for person in people]
        (path / f"image_{frame:05d}.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")


def write_wide(path: Path, points: Floats, confidence: Floats) -> None:
    """Write a row per frame of the first person, cells parted by semicolons, decimal commas."""
    numbers = range(points.shape[2])
    header = [f"point{n}_{axis}" for n in numbers for axis in ("x", "y", "likelihood")]
    rows = np.concatenate([points, confidence[..., None]], axis=-1)[:, 0].reshape(len(points), -1)
    lines = [";".join(["frame", *header])]
    lines += [";".join([str(n), *map(str, row)]) for n, row in enumerate(rows.tolist())]
    path.write_text("\n".join(lines).replace(".", ",") + "\n", encoding="utf-8")


def write_long(path: Path, points: Floats, confidence: Floats) -> None:
    """Write a row per landmark of the first person."""
    lines = ["Filename,Bodypart,X,Y,Score"]
    for frame, (people, certain) in enumerate(zip(points, confidence, strict=True)):
        lines += [
            f"{frame}.jpg,point{n},{x},{y},{certain[0, n]}"
            for n, (x, y) in enumerate(people[0].tolist())
        ]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def write_array(path: Path, points: Floats, confidence: Floats) -> None:
    """Write the first person as an array of NumPy, or an archive of one and its confidences."""
    if path.suffix == ".npz":
        np.savez(path, keypoints=points[:, 0], scores=confidence[:, 0])
    else:
        np.save(path, np.concatenate([points, confidence[..., None]], axis=-1)[:, 0])


def write_mediapipe(path: Path, points: Floats, confidence: Floats) -> None:
    """Write lists of x, y, z and visibility."""
    named = ("x", "y", "z", "visibility")
    found = [
        [
            [
                dict(zip(named, (x, y, 0.0, seen), strict=True))
                for (x, y), seen in zip(*one, strict=True)
            ]
            for one in zip(people.tolist(), certain.tolist(), strict=True)
        ]
        for people, certain in zip(points, confidence, strict=True)
    ]
    _write(path, [{"pose_landmarks": people} for people in found])


WRITERS: Mapping[str, Callable[[Path, Floats, Floats], None]] = {
    "openpose": write_openpose,
    "results.json": write_results,
    "annotations.json": write_annotations,
    "mmpose.json": write_mmpose,
    "xy.csv": write_caliscope,
    "yolo": write_yolo,
    "wide.csv": write_wide,
    "long.csv": write_long,
    "array.npy": write_array,
    "arrays.npz": write_array,
    "mediapipe.json": write_mediapipe,
}
"""By the name of the file or folder that is written."""
