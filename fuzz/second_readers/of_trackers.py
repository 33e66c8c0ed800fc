"""Files of trackers of animals as pandas, sleap-io, pynwb and xarray read them."""

from __future__ import annotations

import csv
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import ndx_pose  # noqa: F401  registers its types
import numpy as np
import pandas
import pynwb
import sleap_io
import xarray

from shapefit.arrays import Floats

Reading = tuple[tuple[str, ...] | None, list[Floats]]
"""Names of landmarks, None where the file has none; instances (m, p, 2 to 4) of each frame.

A number beyond x, y and z of a landmark is its confidence; one that is missing is NaN.
"""

HEADER, AXES = ("scorer", "individuals", "bodyparts", "coords"), ("x", "y", "z", "likelihood")


def deeplabcut_csv(path: Path) -> Reading:
    """Read a table with three or four lines of names."""
    with path.open(encoding="utf-8-sig", newline="") as file:
        rows = [row for row in csv.reader(file) if row]
    head = [row for row in rows[:4] if row[0].strip() in HEADER]
    if len(rows[len(head)]) < len(head[-1]) and len(rows[-1]) != len(rows[len(head)]):
        raise ValueError("pandas loses cells where the first row is shorter than others")
    index = next(number for number, cell in enumerate(head[-1]) if cell.strip() in AXES[:3])
    given = {"header": list(range(len(head))), "index_col": list(range(index))}
    return _table(pandas.read_csv(path, **given))


def deeplabcut_hdf5(path: Path) -> Reading:
    """Read a table that pandas wrote."""
    return _table(pandas.read_hdf(path))


def _table(table: Any) -> Reading:
    """Arrange columns (scorer, [individual,] landmark, coordinate)."""
    columns = [tuple(str(name).strip() for name in column) for column in table.columns]
    kept = [
        number
        for number, column in enumerate(columns)
        if "Unnamed" not in column[-1] and "nan" not in column[-2:]
    ]
    columns = [columns[number] for number in kept]
    if table.columns.nlevels == 3:
        columns = [("", *column[1:]) for column in columns]
    values = table.to_numpy(dtype=float)[:, kept]
    placed = [column for column in columns if column[-1] in AXES]
    who = list(dict.fromkeys(column[-3] for column in placed))
    names = list(dict.fromkeys(column[-2] for column in placed))
    present = {column[-1] for column in columns}
    axes = [axis for axis in AXES if axis in present]
    frames = np.full((len(values), len(who), len(names), len(axes)), np.nan)
    for number, (individual, name, axis) in enumerate(column[-3:] for column in columns):
        if axis in axes:
            place = who.index(individual), names.index(name), axes.index(axis)
            frames[:, *place] = values[:, number]
    if "likelihood" in axes:  # below 0 is missing
        frames[frames[..., -1] < 0] = np.nan
    return tuple(names), list(frames)


def sleap_labels(path: Path) -> Reading:
    """Read a project, without the predictions that a user replaced."""
    return _labels(sleap_io.load_slp(str(path), open_videos=False))


def sleap_analysis(path: Path) -> Reading:
    """Read tracks."""
    return _labels(sleap_io.load_analysis_h5(str(path), video="absent.mp4"))


def jabs(path: Path) -> Reading:
    """Read a pose file; a confidence of 0 is a landmark that was not found."""
    names, frames = _labels(sleap_io.load_jabs(str(path)))
    for frame in frames:
        frame[~(frame[..., 2] > 0)] = np.nan
    return names, frames


def _labels(labels: Any) -> Reading:
    nodes = [node.name for skeleton in labels.skeletons for node in skeleton.nodes]
    names = tuple(dict.fromkeys(nodes))
    videos = {id(video): number for number, video in enumerate(labels.videos)}
    found: dict[tuple[int, int], list[Floats]] = defaultdict(list)
    for frame in labels.labeled_frames:
        for instance in [*frame.user_instances, *frame.unused_predictions]:
            places = [names.index(node.name) for node in instance.skeleton.nodes]
            points = instance.points
            numbers = np.full((len(names), 3), np.nan)
            numbers[places, :2] = np.where(points["visible"][:, None], points["xy"], np.nan)
            if "score" in points.dtype.names:
                numbers[places, 2] = points["score"]
            found[videos[id(frame.video)], int(frame.frame_idx)].append(numbers)
    return names, [np.stack(found[key]) for key in sorted(found)]


def nwb(path: Path) -> Reading:
    """Read the series of ndx-pose; those of animals of different names are joined by time."""
    with pynwb.NWBHDF5IO(str(path), "r", load_namespaces=False) as io:
        file = io.read()
        animals = [
            (name, animal)
            for name, module in file.processing.items()
            for animal in module.data_interfaces.values()
            if animal.neurodata_type == "PoseEstimation"
        ]
        alone = len({animal.name for _, animal in animals}) == len(animals)
        each = [(("" if alone else module), animal) for module, animal in animals]
        series = [one for _, animal in each for one in animal.pose_estimation_series.values()]
        names = tuple(dict.fromkeys(one.name for one in series))
        found: dict[Any, dict[str, Floats]] = defaultdict(dict)
        order = {module: number for number, (module, _) in enumerate(reversed(each))}
        for module, animal in each:
            for one in animal.pose_estimation_series.values():
                data = one.data[()] * one.conversion + one.offset
                confidence = (
                    np.full(len(data), np.nan) if one.confidence is None else one.confidence
                )
                for time, point, score in zip(_times(one), data, confidence, strict=True):
                    key = -order[module], float(time)
                    empty = np.full((len(names), data.shape[1] + 1), np.nan)
                    own = found[key].setdefault(f"{module}/{animal.name}", empty)
                    own[names.index(one.name)] = [*point, score]
    return names, [np.stack(list(found[key].values())) for key in sorted(found)]


def _times(series: Any) -> Iterable[float]:
    if series.timestamps is not None:
        return series.timestamps
    return series.starting_time + np.arange(len(series.data)) / series.rate


def movement(path: Path) -> Reading:
    """Read positions over time, space, keypoints and individuals."""
    with xarray.open_dataset(path, engine="h5netcdf", decode_times=False) as data:
        axes = ("time", "individuals", "keypoints")
        points = data["position"].transpose(*axes, "space").to_numpy()
        if "confidence" in data:
            scores = data["confidence"].transpose(*axes).to_numpy()
            points = np.concatenate([points, scores[..., None]], axis=-1)
        return tuple(map(str, data["keypoints"].values)), list(points.astype(float))
