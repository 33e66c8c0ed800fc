"""Poses of other tools as landmarks and shapes: every pose an item with a name.

Landmarks that a file does not name are those of a skeleton known by name (`keypoints`).
"""

from __future__ import annotations

import gc
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from shapefit.arrays import Flags
from shapefit.errors import abbreviate, counted, input_error, listed
from shapefit.io.arrange import arrange
from shapefit.io.formats import FileFormat
from shapefit.io.inputs import source_name
from shapefit.io.names import match_landmarks, nearest_names, numbers_of
from shapefit.io.options import InputOptions
from shapefit.io.readers.poses import FRACTION, Poses, parsing
from shapefit.io.skeletons import installed_skeletons, skeletons_of_size
from shapefit.records.frames import check_frames, order_by_frame
from shapefit.records.items import Record
from shapefit.records.landmarks import Landmarks
from shapefit.records.shapes import Shapes

Notes = tuple[str, ...]


def read_as_landmarks(
    file_format: FileFormat, paths: tuple[Path, ...], options: InputOptions
) -> tuple[Landmarks, Notes]:
    """Read files of one format as Landmarks, and notes; InputError for 3D points."""
    poses = _read_dimensions(file_format, paths, "landmarks", 2)
    return poses_to_landmarks(poses, options)


def read_as_shapes(
    file_format: FileFormat, paths: tuple[Path, ...], options: InputOptions
) -> tuple[Shapes, Notes]:
    """Read files of one format as Shapes, and notes; InputError for 2D points.

    A shape is NaN where a landmark is unknown.
    """
    poses = _read_dimensions(file_format, paths, "shapes", 3)
    poses, fields, notes = _select_fields(poses, options)
    extras = {} if poses.confidence is None else {"confidence": poses.confidence}
    return Shapes(poses.points, **fields, extras=extras), notes


def _read_dimensions(
    file_format: FileFormat, paths: tuple[Path, ...], kind: str, dimensions: int
) -> Poses:
    """Read the poses in files; InputError unless their points have `dimensions` axes.

    kind: landmarks or shapes, which the message asks for.
    """
    name, fix = source_name(paths[0]), f"give {dimensions}D {kind}"
    poses = read_poses(file_format, paths, dimensions)
    d = poses.points.shape[2]
    if d != dimensions:
        reason = f": {FLAT}" if poses.flat else ""
        raise input_error(name, f"is {file_format.title} of {d}D points{reason}", fix)
    return poses


FLAT = "z is 0 everywhere"


def _without_depth(poses: Poses) -> Poses:
    """Drop z from points in 3D where it is 0 everywhere, and add a note that says so.

    Sports2D writes such points. Other poses stay as they are.
    """
    if poses.points.shape[2] == 2:
        return poses
    z = poses.points[..., 2]
    known = z[np.isfinite(z)]
    if not known.size or known.any():
        return poses
    note = f"{FLAT}: x and y are read as landmarks"
    points, notes = poses.points[..., :2], (*poses.notes, note)
    return replace(poses, points=points, flat=True, notes=notes)


def read_poses(
    file_format: FileFormat, paths: tuple[Path, ...], dimensions: int | None = None
) -> Poses:
    """Read the poses in files of one format; InputError for damaged ones.

    They are in the wanted `dimensions` where a file may hold 2D or 3D. Landmarks whose
    z is 0 everywhere are in 2D.
    """
    assert file_format.read_poses is not None
    wanted = (dimensions,) if file_format.either else ()
    running = gc.isenabled()
    # half the time of a large JSON file is looking for cycles in its lists
    gc.disable()
    try:
        with parsing(source_name(paths[0]), file_format.title):
            poses: Poses = file_format.read_poses(paths, *wanted)
    finally:
        if running:
            gc.enable()
    return _without_depth(poses) if "landmarks" in file_format.records else poses


FRACTIONS = "x and y are fractions of the width and height of the image"
SIZE_FIX = "give the size of the images in pixels: `image_size=[1920,1080]`"


def poses_to_landmarks(poses: Poses, options: InputOptions) -> tuple[Landmarks, Notes]:
    """Convert the 2D poses that the options select to Landmarks; return them and notes.

    Fractions of the image are multiplied by `image_size`. Raises InputError for
    fractions that are useless without it.
    """
    if poses.unit == FRACTION and options.image_size is not None:
        poses = replace(poses, points=poses.points * options.image_size, unit="px")
    elif poses.unit == FRACTION:
        if poses.size_needed:
            raise input_error(poses.name, FRACTIONS, SIZE_FIX + poses.or_else)
        note = (
            f"{FRACTIONS}, so figures are squeezed where it is not square; {SIZE_FIX}"
        )
        poses = replace(poses, notes=(*poses.notes, note))
    if poses.flat and options.y_axis is None:
        poses = _orient_y_axis(poses)
    poses, fields, notes = _select_fields(poses, options)
    images = Landmarks(
        poses.points,
        **fields,
        confidence=poses.confidence,
        y_axis=options.y_axis or poses.y_axis or "down",
    )
    return images, notes


def _orient_y_axis(poses: Poses) -> Poses:
    """Negate y that points up if it is pixels, all <= 0; else note that it points up.

    Pixels of which no y is above 0 are those of an image, from its top down: they then
    point down. Poses whose y points elsewhere stay as they are.

    Sports2D changes the sign of y alone: the bottom of the image is then not at 0,
    where a camera takes it to be if y points up.
    """
    if poses.y_axis != "up":
        return poses
    y = poses.points[..., 1]
    known = y[np.isfinite(y)]
    if poses.unit != "px" or not known.size or known.max() > 0:
        return replace(poses, notes=(*poses.notes, "y points up, as that of markers"))
    points = poses.points * [1.0, -1.0]
    note = "y is negative, so its sign is changed: y points down"
    return replace(poses, points=points, y_axis="down", notes=(*poses.notes, note))


def _select_fields(
    poses: Poses, options: InputOptions
) -> tuple[Poses, dict[str, Any], Notes]:
    """Select poses by the options; return them, the fields of a record, and notes.

    The fields are those that Landmarks and Shapes have in common, but for points.
    """
    names, assumed = _find_landmark_names(poses, options)
    poses, items, sequences = select_poses(poses, options)
    fields = {
        "landmark_names": names,
        "items": items,
        "sequences": sequences if any(sequences) else None,
        "frames": None if poses.named and poses.unordered else poses.frame,
        "times": poses.time,
        "edges": np.array(poses.edges, np.int64) if poses.edges else None,
        "unit": poses.unit,
        "frame_rate": poses.frame_rate,
    }
    notes = tuple(f"{poses.name}: {note}" for note in (*poses.notes, *assumed))
    return poses, fields, notes


NUMBERED = "numbered"  # landmarks are called 0, 1 and so on


def _find_landmark_names(
    poses: Poses, options: InputOptions
) -> tuple[Sequence[str], Notes]:
    """Return the names of landmarks, and a note where a skeleton was assumed.

    They are those of the file, else of the skeleton `keypoints`, else of the usual one,
    else their numbers. Raises InputError for skeletons that do not fit, and where
    several may be meant.
    """
    wanted, skeletons = options.keypoints, installed_skeletons()
    if poses.landmark_names is not None:
        return name_numbers(poses.landmark_names, wanted, poses.name)
    _check_skeleton(wanted)
    count = poses.points.shape[1]
    fitting = skeletons_of_size(count)
    chosen = wanted or poses.skeleton
    if chosen is None and fitting:
        problem = f"{count} landmarks without names, as {listed(fitting, 'and')} have"
        ways = [f"`--set keypoints={name}`" for name in (*fitting, NUMBERED)]
        raise input_error(poses.name, problem, f"say which: {listed(ways)}")
    if chosen in (None, NUMBERED):
        return tuple(map(str, range(count))), ()
    names = skeletons[chosen].landmark_names
    if len(names) != count:
        problem = f"{count} landmarks, and {chosen} has {len(names)}"
        raise input_error(poses.name, problem, f"use {listed((*fitting, NUMBERED))}")
    versions = [name for name in fitting if name.startswith(chosen) and name != chosen]
    others = "".join(f"; `keypoints={other}` if they are not" for other in versions)
    note = f"{count} landmarks without names taken as those of {chosen}{others}"
    return names, () if wanted or not versions else (note,)


def _check_skeleton(wanted: str | None) -> None:
    """Raise InputError unless `wanted` is an installed skeleton, NUMBERED or None."""
    skeletons = installed_skeletons()
    if wanted is not None and wanted not in (*skeletons, NUMBERED):
        near = nearest_names(wanted, tuple(skeletons))
        fix = f"did you mean {near[0]}?" if near else f"use {listed(skeletons)}"
        raise input_error("keypoints", f"there is no skeleton {wanted!r}", fix)


def name_numbers(
    names: Sequence[str], wanted: str | None, place: str
) -> tuple[Sequence[str], Notes]:
    """Replace landmark names that are numbers by those of a skeleton; return notes too.

    `wanted` is the skeleton; without one, and where not all are numbers, names stay.

    Numbers count from 0, or, where there is none of 0 and one of the last, from 1.
    Raises InputError at `place` for numbers that the skeleton has not.
    """
    _check_skeleton(wanted)
    numbers = numbers_of(names)
    if wanted is None or wanted == NUMBERED or numbers is None:
        return names, ()
    known = installed_skeletons()[wanted].landmark_names
    start = 1 if 0 not in numbers and max(numbers) == len(known) else 0
    if max(numbers) - start >= len(known):
        problem = f"landmarks are numbered {min(numbers)} to {max(numbers)}"
        fix = f"give another skeleton: {wanted} has {len(known)} landmarks"
        raise input_error(place, problem, fix)
    named = tuple(known[number - start] for number in numbers)
    if len({*named}) < len(named):
        raise input_error(place, "a number of a landmark twice", "number them once")
    counted_from = f"landmarks {min(numbers)} to {max(numbers)} counted from {start}"
    note = f"{counted_from}: {numbers[0]} is {named[0]} of {wanted}"
    return named, () if 0 in numbers else (note,)


def select_poses(
    poses: Poses, options: InputOptions
) -> tuple[Poses, list[str], list[str]]:
    """Return the poses that the options select, and names of items and sequences.

    Poses without a landmark are left out. They go sequence by sequence, each in order
    of its frames; items and sequences (n) are "" for none.

    Images that have names are no frames, and nobody is followed through them. Raises
    InputError for an individual that is not there or is twice in a frame, and where
    unordered images are a motion.
    """
    named = bool(poses.individuals)
    order = order_by_frame(poses.videos, poses.frame)
    if order is not None:
        poses = poses.take(order)
    tracked = options.track != "none" and not poses.named
    if (
        options.track == "motion"
        and tracked
        and poses.unordered
        and len({*poses.label}) > 1
    ):
        problem = (
            "holds images of different files, without numbers of frames: no motion"
        )
        fix = (
            "number the images one after the other if they are one video, or write .h5"
            " or .csv"
        )
        raise input_error(poses.name, problem, fix)
    if tracked:
        from shapefit.io.readers.tracking import track_people

        poses = replace(poses, individual=track_people(poses))
    people, wanted = poses.individuals, options.individual
    if wanted is not None and wanted not in people:
        fix = f"it names {abbreviate(people)}" if people else "leave `individual` out"
        raise input_error(poses.name, f"has no individual {wanted!r}", fix)
    poses, rows = _hide_unusable(poses, options.min_confidence)
    items, sequences = _name_items(poses, named)
    if wanted is not None:
        rows = rows & np.array([who == wanted for who in poses.individual or ()])
    retained = np.flatnonzero(rows).tolist()
    first = {
        name: n
        for n, name in enumerate(dict.fromkeys(sequences[row] for row in retained))
    }
    retained.sort(key=lambda row: first[sequences[row]])
    poses = poses.take(np.array(retained, np.intp))
    items = [items[row] for row in retained]
    sequences = [sequences[row] for row in retained]
    check_frames(sequences, poses.frame, items, poses.name)
    return poses, items, sequences


def _hide_unusable(poses: Poses, min_confidence: float) -> tuple[Poses, Flags]:
    """Hide landmarks that are infinite or of low confidence; return poses and a mask.

    The mask (N,) is of poses with any landmark left.
    """
    points, confidence = poses.points, poses.confidence
    placed: Flags = np.asarray(np.isfinite(points).all(axis=2))
    low: Flags = np.zeros_like(placed)
    if confidence is not None:
        low = placed & (confidence < min_confidence) & (min_confidence > 0)
        placed = placed & ~low
        weights = np.nan_to_num(confidence, nan=1.0, posinf=1.0, neginf=0.0)
        confidence = np.where(placed, np.maximum(weights, 0.0), 0.0)
    rows: Flags = np.asarray(placed.any(axis=1))
    infinite = int(np.isinf(points).any(axis=2).sum())
    empty = int((~rows).sum())
    notes = [*poses.notes]
    if infinite:
        hidden = counted(infinite, "landmark")
        notes.append(f"{hidden} hidden, whose coordinates are infinite")
    if low.any():
        hidden = counted(int(low.sum()), "landmark")
        notes.append(f"{hidden} hidden, whose confidence is below `min_confidence`")
    if empty:
        notes.append(f"{counted(empty, 'item')} without a landmark left out")
    points = np.where(placed[..., None], points, np.nan)
    hidden_poses = replace(
        poses, points=points, confidence=confidence, notes=tuple(notes)
    )
    return hidden_poses, rows


def _name_items(poses: Poses, named: bool) -> tuple[list[str], list[str]]:
    """Return names of the item and sequence (N,) of each pose, "" for no sequence.

    Poses without identity are numbered, and called `untracked` where the file names
    others (`named`).
    """
    if poses.named:
        return _name_images(poses)
    if poses.individual is None:
        rows = zip(poses.videos, poses.label, strict=True)
        return [f"{video}/{label}" for video, label in rows], list(poses.videos)
    items: list[str] = []
    sequences: list[str] = []
    numbers = Counter[str]()
    for video, who, label in zip(
        poses.videos, poses.individual, poses.label, strict=True
    ):
        sequences.append(f"{video}/{who}" if who else "")
        item = (
            f"{video}/{who}/{label}"
            if who
            else f"{video}/{'untracked/' * named}{label}"
        )
        items.append(item if who else f"{item}/{numbers[item]}")
        numbers[item] += 1
    return items, sequences


def _name_images(poses: Poses) -> tuple[list[str], list[str]]:
    """Return names of item and sequence (N,) of each pose, where images have names.

    An image of several poses gives each its individual, or a number.
    """
    count = len(poses)
    people = [""] * count if poses.individual is None else poses.individual
    sequences = [""] * count
    if not poses.unordered:
        rows = zip(poses.videos, people, strict=True)
        in_video = poses.individual is None
        sequences = [
            f"{video}/{who}" if who else video if in_video else ""
            for video, who in rows
        ]
    times = Counter(poses.label)
    numbers = Counter[str]()
    items: list[str] = []
    for label, who in zip(poses.label, people, strict=True):
        if times[label] == 1:
            items.append(label)
            continue
        items.append(f"{label}/{who or numbers[label]}")
        numbers[label] += not who
    return items, sequences


def keep_landmarks(record: Record, names: Sequence[str], place: str) -> Record:
    """Return a record with the landmarks `names` alone, in this order.

    Raises InputError at `place` for names that are not there, or twice.
    """
    if len(set(names)) < len(names):
        raise input_error(
            "landmarks", "a name is there twice", "name each landmark once"
        )
    match_landmarks(record.landmark_names, names, f"{place}: landmarks")
    if isinstance(record, Shapes):
        return keep_shape_landmarks(record, names)
    return arrange(record, names, place, omit=True)


S = TypeVar("S", bound=Shapes)


def keep_shape_landmarks(shapes: S, names: Sequence[str]) -> S:
    """Return shapes with the landmarks `names` alone, and edges among those.

    Of a tree, whose edges lead from parents to children, a landmark is joined to the
    nearest of its ancestors that stays. The index of mirrored landmarks does not stay.
    """
    if shapes.edges is not None:
        edges = shapes.edges.tolist()
        stay = [name in names for name in shapes.landmark_names]
        parents = {below: above for above, below in edges}
        for _ in (
            parents if len(parents) == len(edges) else ()
        ):  # damaged edges can be a ring
            edges = [
                [above if stay[above] else parents.get(above, above), n]
                for above, n in edges
            ]
        shapes = replace(shapes, edges=np.array(edges, np.int64).reshape(-1, 2))
    return arrange(replace(shapes, mirror_index=None), names, omit=True)
