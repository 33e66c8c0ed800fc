"""Files as trackers and detectors write them, made of given points.

Points are (frames, individuals, landmarks, 2 or 3), confidence (frames, individuals,
landmarks).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.io import open_landmarks
from shapefit.io.options import InputOptions
from shapefit.records import Landmarks

Names = Sequence[str]

FRAME = [
    ("frame_id", "<u8"),
    ("video", "<u4"),
    ("frame_idx", "<u8"),
    ("instance_id_start", "<u8"),
    ("instance_id_end", "<u8"),
]
INSTANCE = [
    ("instance_id", "<i8"),
    ("instance_type", "u1"),
    ("frame_id", "<u8"),
    ("skeleton", "<u4"),
    ("track", "<i4"),
    ("from_predicted", "<i8"),
    ("score", "<f4"),
    ("point_id_start", "<u8"),
    ("point_id_end", "<u8"),
    ("tracking_score", "<f4"),
]
POINT = [("x", "<f8"), ("y", "<f8"), ("visible", "?"), ("complete", "?")]


PREDICTED_POINT = [*POINT, ("score", "<f8")]


def read_images(*paths: Path, **options: Any) -> tuple[Landmarks, tuple[str, ...]]:
    """Return all images of these files, and the warnings."""
    with open_landmarks(list(paths), InputOptions(**options)) as source:
        return source.whole(), source.notes


def landmark_names(count: int, kind: str = "point") -> tuple[str, ...]:
    """Return names for landmarks, or for something else."""
    return tuple(f"{kind}{number}" for number in range(count))


def _columns(
    points: Floats, confidence: Floats
) -> tuple[list[tuple[str, ...]], Floats]:
    """Return the columns of DeepLabCut (individual, landmark, coordinate), and the
    rows.
    """
    _, many, p, d = points.shape
    axes = ("x", "y", "z")
    values = points
    if d == 2:
        axes = ("x", "y", "likelihood")
        values = np.concatenate([points, confidence[..., None]], axis=-1)
    columns = []
    for who in landmark_names(many, "animal"):
        individual = (who,) if many > 1 else ()
        for landmark in landmark_names(p):
            columns += [("net", *individual, landmark, axis) for axis in axes]
    return columns, values.reshape(len(points), -1)


def write_deeplabcut_csv(path: Path, points: Floats, confidence: Floats) -> None:
    columns, rows = _columns(points, confidence)
    levels = ["scorer", "individuals", "bodyparts", "coords"]
    if points.shape[1] == 1:
        levels.remove("individuals")
    lines = []
    for level, names in zip(levels, zip(*columns, strict=True), strict=True):
        lines.append(",".join([level, *names]))
    for number, row in enumerate(rows.tolist()):
        cells = ["" if np.isnan(value) else repr(value) for value in row]
        lines.append(",".join([str(number), *cells]))
    path.write_text("\n".join([*lines, ""]), encoding="utf-8")


def pickled(columns: Sequence[tuple[str, ...]]) -> bytes:
    """Return a list of tuples of names as pandas pickles it."""
    tuples = []
    for column in columns:
        names = "".join(f"V{name}\n" for name in column)
        tuples.append(f"({names}ta")
    return b"(l" + "".join(tuples).encode() + b"."


def write_deeplabcut_hdf5(path: Path, points: Floats, confidence: Floats) -> None:
    columns, rows = _columns(points, confidence)
    kind = [("index", "<i8"), ("values_block_0", "<f8", rows.shape[1:])]
    table = np.zeros(len(rows), kind)
    table["index"] = np.arange(len(rows))
    table["values_block_0"] = rows
    chunk = max(1, (1 << 16) // table.itemsize)
    with h5py.File(path, "w") as file:
        group = file.create_group("df_with_missing")
        group.attrs["pandas_type"] = np.bytes_(b"frame_table")
        dataset = group.create_dataset(
            "table", data=table, chunks=(chunk,), maxshape=(None,)
        )
        dataset.attrs["index_kind"] = np.bytes_(b"integer")
        dataset.attrs["values_block_0_kind"] = np.bytes_(pickled(columns))


def write_deeplabcut_fixed(path: Path, points: Floats, confidence: Floats) -> None:
    columns, rows = _columns(points, confidence)
    images = [f"labeled/video/img{number:05}.png" for number in range(len(rows))]
    with h5py.File(path, "w") as file:
        group = file.create_group("df_with_missing")
        group.attrs["pandas_type"] = np.bytes_(b"frame")
        group.attrs["nblocks"] = 1
        group.attrs["block0_items_variety"] = np.bytes_(b"multi")
        group.attrs["axis1_variety"] = np.bytes_(b"regular")
        for number, level in enumerate(zip(*columns, strict=True)):
            names = list(dict.fromkeys(level))
            labels = [names.index(name) for name in level]
            group[f"block0_items_level{number}"] = np.array(names, "S")
            group[f"block0_items_label{number}"] = np.array(labels, "i1")
        group["axis1"] = np.array(images, "S")
        group["block0_values"] = rows
        group["block0_values"].attrs["transposed"] = np.uint8(1)


def write_sleap_analysis(path: Path, points: Floats, confidence: Floats) -> None:
    n, many, p, _ = points.shape
    tracks = points.transpose(1, 3, 2, 0)
    scores = confidence.transpose(1, 2, 0)
    with h5py.File(path, "w") as file:
        file.create_dataset("tracks", data=tracks, compression="gzip")
        file.create_dataset("point_scores", data=scores, compression="gzip")
        file["node_names"] = np.array(landmark_names(p), "S")
        file["track_names"] = np.array(landmark_names(many, "animal"), "S")
        file["track_occupancy"] = np.ones((n, many), "u1")
        file["edge_inds"] = np.array([[0, 1]])


def write_slp(
    path: Path,
    points: Floats,
    confidence: Floats,
    *,
    users: Mapping[int, int] | None = None,
) -> None:
    """Write predicted instances as SLEAP does, the track `users` gives for a frame also
    by hand.
    """
    n, many, p, _ = points.shape
    by_hand = users or {}
    rows: list[tuple[Any, ...]] = []
    frames = np.zeros(n, FRAME)
    placed: list[Floats] = []
    for number in range(n):
        first = len(rows)
        for who in range(many):
            start = (number * many + who) * p
            rows.append((len(rows), 1, number, 0, who, -1, 1.0, start, start + p, 0.0))
        if number in by_hand:
            who = by_hand[number]
            start = p * len(placed)
            rows.append((len(rows), 0, number, 0, who, -1, 0, start, start + p, 0.0))
            placed.append(points[number, who] + 1)
        frames[number] = (number, 0, number, first, len(rows))
    predicted = _points(points.reshape(-1, 2), confidence.ravel())
    chunk = min(1024, len(predicted))
    with h5py.File(path, "w") as file:
        file["frames"] = frames
        file["instances"] = np.array(rows, INSTANCE)
        file.create_dataset("pred_points", data=predicted, chunks=(chunk,))
        file["points"] = _points(np.reshape(placed, (-1, 2)))
        metadata = file.create_group("metadata")
        metadata.attrs["format_id"] = 1.2
        metadata.attrs["json"] = json.dumps(_skeleton(p))
        tracks = [json.dumps([0, name]) for name in landmark_names(many, "animal")]
        file["tracks_json"] = np.array(tracks, "S")
        video = json.dumps({"backend": {"filename": "video.mp4"}})
        file["videos_json"] = np.array([video], "S")


def _skeleton(p: int) -> dict[str, Any]:
    """Return what a .slp file says of p nodes, of which the first two are joined."""
    link = {
        "source": 0,
        "target": 1,
        "type": {"py/reduce": [{}, {"py/tuple": [1]}]},
    }
    skeleton = {"nodes": [{"id": number} for number in range(p)], "links": [link]}
    nodes = [{"name": name} for name in landmark_names(p)]
    return {"skeletons": [skeleton], "nodes": nodes}


def _points(points: Floats, score: Floats | None = None) -> NDArray[Any]:
    """Return points that a user placed, or predicted ones with their scores."""
    table = np.zeros(len(points), POINT if score is None else PREDICTED_POINT)
    table["x"] = points[:, 0]
    table["y"] = points[:, 1]
    table["visible"] = True
    if score is not None:
        table["score"] = score
    return table


def write_nwb(
    path: Path, points: Floats, confidence: Floats, *, rate: float = 30.0
) -> None:
    _, many, p, _ = points.shape
    text = h5py.string_dtype()
    with h5py.File(path, "w") as file:
        file.attrs["nwb_version"] = "2.7.0"
        module = file.create_group("processing/behavior")
        skeleton = module.create_group("Skeletons/Skeleton")
        skeleton.create_dataset("nodes", data=list(landmark_names(p)), dtype=text)
        skeleton["edges"] = np.array([[0, 1]], "u1")
        for who, name in enumerate(landmark_names(many, "animal")):
            group = module.create_group(name)
            group.attrs["neurodata_type"] = "PoseEstimation"
            for landmark, node in enumerate(landmark_names(p)):
                series = group.create_group(node)
                series.attrs["neurodata_type"] = "PoseEstimationSeries"
                series["data"] = points[:, who, landmark]
                series["data"].attrs["unit"] = "pixels"
                series["confidence"] = confidence[:, who, landmark]
                series["starting_time"] = 0.0
                series["starting_time"].attrs["rate"] = rate


def write_movement(
    path: Path, points: Floats, confidence: Floats, *, plural: bool = True
) -> None:
    n, many, p, d = points.shape
    ending = "s" if plural else ""
    scales = {
        "time": np.arange(n) / 30,
        "space": list("xyz"[:d]),
        f"keypoint{ending}": list(landmark_names(p)),
        f"individual{ending}": list(landmark_names(many, "animal")),
    }
    time, space, keypoint, individual = scales
    with h5py.File(path, "w") as file:
        file.attrs["ds_type"] = "poses"
        file.attrs["fps"] = np.array([30.0])
        for name, values in scales.items():
            file[name] = values
            file[name].make_scale(name)
        file["position"] = points.transpose(0, 3, 2, 1)
        file["confidence"] = confidence.transpose(0, 2, 1)
        _attach_scales(file, "position", [time, space, keypoint, individual])
        _attach_scales(file, "confidence", [time, keypoint, individual])


def _attach_scales(file: h5py.File, name: str, axes: Sequence[str]) -> None:
    for number, axis in enumerate(axes):
        file[name].dims[number].attach_scale(file[axis])


def write_jabs_of_several(
    path: Path, points: Floats, confidence: Floats, *, version: int = 3
) -> None:
    """Write a pose file of several mice: in odd frames they stand the other way round.

    From version 4 on, 0 is the identity of none.
    """
    n, many = points.shape[:2]
    order = np.tile(np.arange(many), (n, 1))
    order[1::2] = order[1::2, ::-1]
    rows = np.arange(n)[:, None]
    seen = np.isfinite(points).all(axis=-1)
    scores = np.where(seen, confidence, 0)
    y_first = np.nan_to_num(points[rows, order][..., ::-1])
    with h5py.File(path, "w") as file:
        group = file.create_group("poseest")
        group.attrs["version"] = np.array([version, 0], "u2")
        group["points"] = y_first.astype("u2")
        group["confidence"] = scores[rows, order].astype("f4")
        group["instance_count"] = np.full(n, many, "u1")
        group["instance_track_id"] = order.astype("u4")
        if version > 3:
            group["instance_embed_id"] = (order + 1).astype("u4")


def write_jabs(path: Path, points: Floats, confidence: Floats) -> None:
    """Write a pose file of version 2, of the first mouse."""
    mouse = points[:, 0]
    seen = np.isfinite(mouse).all(axis=-1)
    scores = np.where(seen, confidence[:, 0], 0)
    y_first = np.nan_to_num(mouse[..., ::-1])
    with h5py.File(path, "w") as file:
        group = file.create_group("poseest")
        group["points"] = y_first.astype("u2")
        group["confidence"] = scores.astype("f4")


TRACKERS: dict[str, Callable[..., None]] = {
    "table.csv": write_deeplabcut_csv,
    "table.h5": write_deeplabcut_hdf5,
    "fixed.h5": write_deeplabcut_fixed,
    "tracks.analysis.h5": write_sleap_analysis,
    "labels.slp": write_slp,
    "poses.nwb": write_nwb,
    "poses.nc": write_movement,
    "mouse_pose_est_v2.h5": write_jabs,
    "mice_pose_est_v4.h5": partial(write_jabs_of_several, version=4),
}


# Detectors of people.


def _flat(points: Floats, confidence: Floats) -> list[list[list[float]]]:
    """Return x, y, confidence of all landmarks: [frame][person][number]."""
    triples = np.concatenate([points, confidence[..., None]], axis=3).round(4)
    rows = triples.reshape(*triples.shape[:2], -1)
    flat: list[list[list[float]]] = rows.tolist()
    return flat


def _write(path: Path, contents: Any) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(contents), encoding="utf-8")


def write_openpose(path: Path, points: Floats, confidence: Floats) -> None:
    for frame, people in enumerate(_flat(points, confidence)):
        entries = [{"person_id": [-1], "pose_keypoints_2d": cells} for cells in people]
        contents = {"version": 1.3, "people": entries}
        _write(path / f"v_{frame:012d}_keypoints.json", contents)


def write_results(path: Path, points: Floats, confidence: Floats) -> None:
    results = []
    for frame, people in enumerate(_flat(points, confidence)):
        for cells in people:
            result = {"image_id": frame, "category_id": 1, "score": 0.5}
            results.append({**result, "keypoints": cells})
    _write(path, results)


def write_annotations(path: Path, points: Floats, confidence: Floats) -> None:
    """Write COCO annotations; landmarks of confidence below 0.1 are not labelled."""
    names = list(landmark_names(points.shape[2]))
    category = {"id": 1, "name": "one", "keypoints": names, "skeleton": [[1, 2]]}
    visibility = np.where(confidence < 0.1, 0.0, 2.0)
    images = [{"id": n, "file_name": f"{n:08d}.jpg"} for n in range(len(points))]
    annotations = []
    for frame, people in enumerate(_flat(points, visibility)):
        for cells in people:
            entry = {"image_id": frame, "category_id": 1, "keypoints": cells}
            annotations.append(entry)
    contents = {
        "images": images,
        "categories": [category],
        "annotations": annotations,
    }
    _write(path, contents)


def write_mmpose(path: Path, points: Floats, confidence: Floats) -> None:
    names = dict(enumerate(landmark_names(points.shape[2])))
    frames = []
    for number, (people, scores) in enumerate(zip(points, confidence, strict=True)):
        instances = []
        for keypoints, of_keypoints in zip(people, scores, strict=True):
            instance = {
                "keypoints": keypoints.tolist(),
                "keypoint_scores": of_keypoints.tolist(),
            }
            instances.append(instance)
        frames.append({"frame_id": number, "instances": instances})
    info = {"keypoint_id2name": {str(number): name for number, name in names.items()}}
    _write(path, {"meta_info": info, "instance_info": frames})


def write_caliscope(path: Path, points: Floats, confidence: Floats) -> None:
    lines = ["sync_index,port,frame_index,frame_time,point_id,img_loc_x,img_loc_y"]
    for frame, people in enumerate(points):
        for number, (x, y) in enumerate(people[0].tolist()):
            lines.append(f"{frame},0,{frame},{frame / 30},{number},{x},{y}")
    path.write_text("\n".join([*lines, ""]), encoding="utf-8")


def write_yolo(path: Path, points: Floats, confidence: Floats) -> None:
    path.mkdir(parents=True, exist_ok=True)
    shape = f"kpt_shape: [{points.shape[2]}, 3]\nnames: {{0: person}}\n"
    (path / "data.yaml").write_text(shape, encoding="utf-8")
    for frame, people in enumerate(_flat(points / 1000, confidence)):
        lines = ["0 0.5 0.5 0.2 0.4 " + " ".join(map(str, person)) for person in people]
        (path / f"image_{frame:05d}.txt").write_text(
            "\n".join(lines) + "\n", encoding="utf-8"
        )


def write_wide(path: Path, points: Floats, confidence: Floats) -> None:
    """Write a row per frame of the first person, cells parted by semicolons, decimal
    commas.
    """
    numbers = range(points.shape[2])
    header = [f"point{n}_{axis}" for n in numbers for axis in ("x", "y", "likelihood")]
    rows = np.concatenate([points, confidence[..., None]], axis=-1)[:, 0].reshape(
        len(points), -1
    )
    lines = [";".join(["frame", *header])]
    lines += [";".join([str(n), *map(str, row)]) for n, row in enumerate(rows.tolist())]
    path.write_text("\n".join(lines).replace(".", ",") + "\n", encoding="utf-8")


def write_long(path: Path, points: Floats, confidence: Floats) -> None:
    lines = ["Filename,Bodypart,X,Y,Score"]
    for frame, (people, certain) in enumerate(zip(points, confidence, strict=True)):
        lines += [
            f"{frame}.jpg,point{n},{x},{y},{certain[0, n]}"
            for n, (x, y) in enumerate(people[0].tolist())
        ]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def write_array(path: Path, points: Floats, confidence: Floats) -> None:
    if path.suffix == ".npz":
        np.savez(path, keypoints=points[:, 0], scores=confidence[:, 0])
    else:
        np.save(path, np.concatenate([points, confidence[..., None]], axis=-1)[:, 0])


def write_mediapipe(path: Path, points: Floats, confidence: Floats) -> None:
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


DETECTORS: dict[str, Callable[..., None]] = {
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
