"""Detections, tables and motion, read in a few lines each; tables by pandas, C3D by py-c3d."""

from __future__ import annotations

import json
import math
from collections import defaultdict
from pathlib import Path
from typing import Any

import c3d
import numpy as np
import pandas

from shapefit.arrays import Floats

from .of_trackers import Reading


def _rows(instances: dict[Any, list[Any]], step: int = 3) -> list[Floats]:
    """Return the instances of each frame, in the order of the frames."""
    wide = max((len(one) for every in instances.values() for one in every), default=0)
    empty = [math.nan] * wide
    return [
        np.array([one or empty for one in every], float).reshape(len(every), -1, step)
        for every in instances.values()
    ]


def openpose(path: Path) -> Reading:
    """Read a file per frame; a landmark without confidence is missing."""
    files = sorted(path.glob("*.json"))
    people = {file: json.loads(file.read_text("utf-8")).get("people") or [] for file in files}
    found = {
        file: [one.get("pose_keypoints_2d") or [] for one in every]
        for file, every in people.items()
    }
    return None, [_placed(_finite(frame)) for frame in _rows(found)]


def _placed(frame: Floats) -> Floats:
    return np.where(frame[..., 2:] > 0, frame, np.nan)


def coco_results(path: Path) -> Reading:
    """Read a list of detections; 0, 0, 0 is missing."""
    found: dict[Any, list[Any]] = defaultdict(list)
    for one in json.loads(path.read_text("utf-8")):
        found[one["image_id"]].append(one["keypoints"])
    frames = [_finite(frame) for frame in _rows(found)]
    if (
        all(isinstance(image, str) for image in found)
        and max(np.nanmax(f[..., 2]) for f in frames) > 2
    ):
        frames = [frame / [1, 1, 6] for frame in frames]
    return None, [np.where(frame.any(axis=2, keepdims=True), frame, np.nan) for frame in frames]


def _finite(frame: Floats) -> Floats:
    """Return points without those of which a number is none."""
    return np.where(np.isfinite(frame).all(axis=-1, keepdims=True), frame, np.nan)


def coco_annotations(path: Path) -> Reading:
    """Read annotations of categories; v = 0 is missing."""
    whole = json.loads(path.read_text("utf-8"))
    own = {one["id"]: one["keypoints"] for one in whole["categories"] if one.get("keypoints")}
    names = tuple(dict.fromkeys(name for each in own.values() for name in each))
    found: dict[Any, list[Any]] = {image["id"]: [] for image in whole["images"]}
    for one in whole["annotations"]:
        if one.get("keypoints"):
            numbers = np.full((len(names), 3), np.nan)
            places = [names.index(name) for name in own[one["category_id"]]]
            numbers[places] = np.array(one["keypoints"], float).reshape(-1, 3)
            found.setdefault(one["image_id"], []).append(numbers)
    frames = [_placed(_finite(np.stack(every))) for every in found.values() if every]
    return names, [frame[..., :2] for frame in frames]


def ultralytics(path: Path) -> Reading:
    """Read a line per instance, x, y and v of each landmark after the box."""
    frames = []
    for file in sorted(path.glob("*.txt")):
        lines = [line.partition("#")[0].split() for line in file.read_text("utf-8").splitlines()]
        rows = np.array([line[5:] for line in lines if line], float)
        if len(rows):
            frames.append(_placed(rows[:, : rows.shape[1] // 3 * 3].reshape(len(rows), -1, 3)))
    return None, [frame[..., :2] for frame in frames]


def mmpose(path: Path) -> Reading:
    """Read the predictions of a video."""
    frames = []
    for frame in json.loads(path.read_text("utf-8"))["instance_info"]:
        every = [
            np.column_stack([one["keypoints"], one["keypoint_scores"]])
            for one in frame["instances"]
        ]
        frames += [_placed(_finite(np.stack(every).astype(float)))] if every else []
    return None, frames


def caliscope(path: Path) -> Reading:
    """Read a row per point of a frame of a camera."""
    table = pandas.read_csv(path)
    camera = "port" if "port" in table else "cam_id"
    keys = [camera, "frame_index", "point_id", "img_loc_x", "img_loc_y"]
    table = table[keys].astype(float).replace([np.inf, -np.inf], np.nan).dropna(subset=keys)
    table = table[(table["frame_index"] % 1 == 0) & (table["frame_index"].abs() < 2**40)]
    points = sorted(set(table["point_id"]))
    found: dict[Any, Floats] = {}
    for port, frame, point, x, y in table.to_numpy():
        empty = np.full((1, len(points), 2), np.nan)
        found.setdefault((port, frame), empty)[0, points.index(point)] = x, y
    return None, [found[key] for key in sorted(found)]


def anipose(path: Path) -> Reading:
    """Read three columns of each landmark that has an error, cameras or a score."""
    table = pandas.read_csv(path, index_col=False, skipinitialspace=True)
    given = ["_error", "_ncams", "_score"]
    names = [name[:-2] for name in table if name.endswith("_x")]
    names = [name for name in names if any(name + ending in table for ending in given)]
    columns = [f"{name}_{axis}" for name in names for axis in "xyz"]
    if not columns:
        raise ValueError("no table of anipose, which has commas")
    values = table[columns].to_numpy(float)
    points = values.reshape(len(values), 1, -1, 3)
    if names and all(f"{name}_score" in table for name in names):
        scores = table[[f"{name}_score" for name in names]].to_numpy(float)
        points = np.concatenate([points, scores[:, None, :, None]], axis=-1)
    return tuple(names), list(points)


def trc(path: Path) -> Reading:
    """Read a line per frame below the markers, in metres; 0, 0, 0 is missing."""
    lines = [line.rstrip("\r") for line in path.read_text("utf-8-sig").split("\n")]
    if not lines[1].startswith(("DataRate\t", "DataRate,")) or lines[4].lstrip("\t, ")[:2] != "X1":
        raise ValueError("the header is damaged")
    separator = "\t" if "\t" in lines[3] else ","
    head = dict(zip(*(line.split(separator) for line in lines[1:3]), strict=False))
    scale = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}.get(head["Units"].strip(), 1.0)
    labels = [cell.strip() for cell in lines[4].split(separator)[2:]]
    count = len([label for label in labels if label]) // 3
    frames = []
    for line in lines[5:]:
        cells = line.split(separator)
        if line.strip("\t, "):
            values = [float(cell) if cell.strip() else math.nan for cell in cells[2:]]
            values += [math.nan] * (3 * count - len(values))
            points = np.array(values[: 3 * count]).reshape(1, -1, 3)
            frames.append(scale * np.where(points.any(axis=2, keepdims=True), points, np.nan))
    return None, frames


def bvh(path: Path) -> Reading:
    """Walk down the tree of joints in every frame, with matrices of four."""
    words = path.read_text("utf-8-sig").split()
    stack: list[int] = []
    joints: list[tuple[int, list[float], list[str]]] = []
    ends: set[int] = set()
    place = 0
    while words[place] != "MOTION":
        word = words[place]
        if word in ("ROOT", "JOINT", "End"):
            joints.append((stack[-1] if stack else -1, [0.0] * 3, []))
            ends |= {len(joints) - 1} if word == "End" else set()
            stack.append(len(joints) - 1)
        elif word == "OFFSET":
            joints[stack[-1]][1][:] = map(float, words[place + 1 : place + 4])
        elif word == "CHANNELS":
            joints[stack[-1]][2][:] = words[place + 2 : place + 2 + int(words[place + 1])]
        elif word == "}":
            stack.pop()
        place += 1
    start = words.index("Time:", place) + 2
    width = sum(len(channels) for _, _, channels in joints)
    values = np.array(words[start:], float).reshape(-1, width)
    order = [n for n in range(len(joints)) if n not in ends] + sorted(ends)
    return None, [_posed(joints, row)[None, order] for row in values]


def _posed(joints: list[tuple[int, list[float], list[str]]], row: Floats) -> Floats:
    numbers = iter(row.tolist())
    poses: list[Floats] = []
    for parent, offset, channels in joints:
        here, turned = list(offset), np.eye(4)
        for channel in channels:
            axis, number = "XYZ".index(channel[0].upper()), next(numbers)
            if channel[1:].lower() == "position":
                here[axis] = number
                continue
            one, (a, b) = np.eye(4), ((axis + 1) % 3, (axis + 2) % 3)
            cosine, sine = math.cos(math.radians(number)), math.sin(math.radians(number))
            one[a, a] = one[b, b] = cosine
            one[b, a], one[a, b] = sine, -sine
            turned = turned @ one
        moved = np.eye(4)
        moved[:3, 3] = here
        poses.append((poses[parent] if parent >= 0 else np.eye(4)) @ moved @ turned)
    return np.array([pose[:3, 3] for pose in poses])


def c3d_points(path: Path) -> Reading:
    """Read markers in metres; the fourth word of one is negative where it is missing."""
    with path.open("rb") as file:
        reader = c3d.Reader(file)
        unit = reader.get("POINT:UNITS").string_value.strip().lower()
        scale = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}.get(unit, 1.0)
        points = np.stack([points for _, points, _ in reader.read_frames(copy=True)])
        file.seek(512 * (reader.header.data_block - 1))
        words = np.frombuffer(file.read(), "<f4")
    width = 4 * points.shape[1] + reader.header.analog_count
    words = words[: len(points) * width].reshape(len(points), width)[:, 3 : 4 * points.shape[1] : 4]
    if (words % 1 != 0).any() or (np.abs(words) > 32767).any():
        raise ValueError("the fourth word of a point has more than 16 bits")
    places = scale * points[:, :, :3].astype(float)
    return None, list(np.where(words[..., None] >= 0, places, np.nan)[:, None])


def array(path: Path) -> Reading:
    """Read images, landmarks, and x, y and a confidence; 0, 0, 0 is missing."""
    values = np.load(path).astype(float)[:, None]
    return None, list(np.where(values.any(axis=-1, keepdims=True), values, np.nan))


def long_table(path: Path) -> Reading:
    """Read a row per landmark; 0, 0, 0 is missing."""
    table = pandas.read_csv(path)
    if list(table) != ["Filename", "Bodypart", "X", "Y", "Score"]:
        raise ValueError("other columns have a meaning that this reader does not know")
    names = tuple(dict.fromkeys(table["Bodypart"].astype(str)))
    found: dict[str, Floats] = {}
    for image, name, *numbers in table.itertuples(index=False):
        empty = np.full((1, len(names), 3), np.nan)
        found.setdefault(str(image), empty)[0, names.index(str(name))] = numbers
    return names, [
        np.where(frame.any(axis=2, keepdims=True), frame, np.nan) for frame in found.values()
    ]
