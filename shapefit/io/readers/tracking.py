"""Detections without identity, joined over frames: who is nearest is the same person.

In each frame the assignment of detections to tracks that minimises

    sum of d / reach + (1 - overlap) / 2

over the pairs with d <= reach, after as many pairs as possible: d is the mean distance of their
landmarks, after the smooth motion of the track, relative to the size of the person; overlap is
that of their boxes (intersection over union). No learned appearance, nothing beyond one pass.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import count, islice

import numpy as np

from shapefit.arrays import Flags, Floats, Integers
from shapefit.io.readers.poses import Poses

REACH = 0.35
"""Of the size of a person (the diagonal of the box): how far landmarks go in a frame, at most, from
where the motion so far takes them. Somebody who runs crosses a fifth of it at 30 Hz."""

REACH_PER_GAP, FARTHEST = 0.1, 1.0
"""What each missed frame adds to the reach, and the largest reach."""

LONGEST_GAP = 15
"""Frames without a detection that a track survives."""

SMOOTH_MOTION = 3
"""Frames for which the motion of a track is continued."""

FORGETTING = 0.3
"""Share of a frame's motion in the smooth motion of a track."""

LARGEST = 1e100
"""Coordinates beyond this are as good as this, and their squares do not overflow."""

NO_TRACK = -1


@dataclass
class _Tracks:
    """The T tracks of a video that are still open, or the detections of a frame.

    points (T, p, 2 or 3), where each landmark was last, NaN before it was seen; motion (T, 2), in
    pixels a frame; boxes (T, 4) and size (T,); frame (T,), of the last detection; number (T,).
    """

    points: Floats
    motion: Floats
    boxes: Floats
    size: Floats
    frame: Integers
    number: Integers

    def take(self, rows: Flags) -> _Tracks:
        """Return some of the tracks."""
        return replace(self, **{name: values[rows] for name, values in vars(self).items()})


def track_people(poses: Poses) -> Sequence[str] | None:
    """Return the individuals (N,), every pose without identity called `person 1` and so on.

    Tracks are numbered in order of their first frames, through all videos. Poses without a
    landmark, and those of whom the file says who they are, stay as they are.
    """
    if poses.individual is None:
        return None
    weights = np.isfinite(poses.points).all(axis=2).astype(float)
    if poses.confidence is not None:
        weights *= np.clip(np.nan_to_num(poses.confidence, nan=1.0), 0, 1)
    points = np.clip(poses.points, -LARGEST, LARGEST)
    points[weights == 0] = np.nan
    anonymous = np.array([not who for who in poses.individual], bool)
    boxes, size = _boxes(points)
    n = len(poses)
    detections = _Tracks(
        points, np.zeros((n, 2)), boxes, size, np.asarray(poses.frame), np.full(n, NO_TRACK)
    )
    rows_of: defaultdict[tuple[str, int], list[int]] = defaultdict(list)
    videos, frames = poses.videos, poses.frame.tolist()
    for row in np.flatnonzero(anonymous & weights.any(axis=1)).tolist():
        rows_of[videos[row], frames[row]].append(row)
    open_tracks: dict[str, _Tracks] = {}
    following = 0
    for (video, frame), rows in rows_of.items():
        detected = detections.take(np.array(rows))
        tracks = open_tracks.get(video, detected.take(np.zeros(len(rows), bool)))
        tracks = tracks.take(np.asarray(frame - tracks.frame <= LONGEST_GAP + 1))
        if len(tracks.frame):
            _follow(tracks, detected, weights[rows], frame)
        new: Flags = np.asarray(detected.number == NO_TRACK)
        detected.number[new] = np.arange(following, following + new.sum())
        following += int(new.sum())
        both = vars(tracks), vars(detected.take(new))
        open_tracks[video] = _Tracks(*(np.concatenate([one[k] for one in both]) for k in both[0]))
        detections.number[rows] = detected.number
    taken = set(poses.individual)
    free = (name for n in count(1) if (name := f"person {n}") not in taken)
    names = [*islice(free, following), ""]  # the last is that of NO_TRACK
    numbers = detections.number.tolist()
    return [who or names[n] for who, n in zip(poses.individual, numbers, strict=True)]


def _boxes(points: Floats) -> tuple[Floats, Floats]:
    """Return the boxes (N, 4) around points (N, p, d), least and largest x and y; the diagonals."""
    flat = points[..., :2]
    known = np.isfinite(flat)
    low = np.where(known, flat, np.inf).min(axis=1, initial=np.inf)
    high = np.where(known, flat, -np.inf).max(axis=1, initial=-np.inf)
    size = np.sqrt(((high - low) ** 2).sum(axis=1))
    return np.concatenate([low, high], axis=1), np.maximum(size, 1e-9)


def _follow(tracks: _Tracks, detected: _Tracks, weights: Floats, frame: int) -> None:
    """Number those of the D detections of a frame that go on a track; these tracks go on to them.

    Landmarks that a detection lacks move as its track does.
    """
    passed = np.maximum(frame - tracks.frame, 1)
    steps = tracks.motion * np.minimum(passed, SMOOTH_MOTION)[:, None]
    expected = tracks.points.copy()
    expected[..., :2] += steps[:, None]
    pairs = assign(*_costs(tracks, expected, steps, passed, detected, weights))
    who, own = np.array(pairs, np.intp).reshape(-1, 2).T
    points = detected.points[own]
    moved = (points - tracks.points[who])[..., :2]
    known = ~np.isnan(moved[..., :1])
    common = known.sum(axis=1)
    mean = np.where(known, moved, 0.0).sum(axis=1) / np.maximum(common, 1)
    smooth = tracks.motion[who]
    motion = smooth + FORGETTING * (mean / passed[who, None] - smooth)
    tracks.motion[who] = np.where(common > 0, motion, smooth)
    tracks.points[who] = np.where(np.isnan(points), expected[who], points)
    tracks.boxes[who] = detected.boxes[own]
    tracks.size[who] = np.maximum(detected.size[own], 0.95 * tracks.size[who])
    tracks.frame[who] = frame
    detected.number[own] = tracks.number[who]


def _costs(
    tracks: _Tracks,
    expected: Floats,
    steps: Floats,
    passed: Integers,
    detected: _Tracks,
    weights: Floats,
) -> tuple[Floats, Flags]:
    """Return the cost (T, D) of each track and detection, and which pairs may be one person.

    Tracks are expected at (T, p, d), `steps` (T, 2) from where they were, so many frames ago.
    """
    boxes = tracks.boxes + np.concatenate([steps, steps], axis=1)
    reach = np.minimum(REACH + REACH_PER_GAP * (passed - 1), FARTHEST)
    scale = np.maximum(tracks.size[:, None], detected.size)
    difference = detected.points - expected[:, None]
    away = np.sqrt(np.einsum("tdpc,tdpc->tdp", difference, difference))
    common = np.where(np.isnan(away), 0.0, weights)
    # One landmark that went astray counts no more than the size of the person.
    away = np.fmin(away, scale[..., None])
    total = common.sum(axis=2)
    distance = np.einsum("tdp,tdp->td", away, common) / np.maximum(total, 1e-12)
    if not total.all():  # without a common landmark, the middles of the boxes
        own, other = boxes[:, None], detected.boxes
        middle = (other[:, :2] + other[:, 2:] - own[..., :2] - own[..., 2:]) / 2
        distance = np.where(total > 0, distance, np.sqrt((middle**2).sum(axis=2)))
    ratio = distance / (scale * reach[:, None])
    return ratio + (1 - _overlap(boxes[:, None], detected.boxes)) / 2, ratio <= 1


def _overlap(a: Floats, b: Floats) -> Floats:
    """Return intersection over union of boxes (..., 4); 0 for those without an area."""
    sides = np.minimum(a[..., 2:], b[..., 2:]) - np.maximum(a[..., :2], b[..., :2])
    shared = np.maximum(sides, 0).prod(axis=-1)
    areas = (a[..., 2:] - a[..., :2]).prod(axis=-1) + (b[..., 2:] - b[..., :2]).prod(axis=-1)
    return np.asarray(shared / np.maximum(areas - shared, 1e-12))


def assign(cost: Floats, allowed: Flags) -> list[tuple[int, int]]:
    """Return the pairs of least cost among those allowed, after as many as possible.

    Where the best of each row are different columns they are the optimum; else scipy finds it.
    """
    padded = np.where(allowed, cost, np.inf)
    rows = np.flatnonzero(allowed.any(axis=1))
    best = padded[rows].argmin(axis=1) if len(rows) else rows
    if len({*best.tolist()}) == len(rows):
        return list(zip(rows.tolist(), best.tolist(), strict=True))
    from scipy.optimize import linear_sum_assignment

    unlikely = 1.0 + 2.0 * float(np.abs(cost[allowed]).sum())
    chosen = linear_sum_assignment(np.where(allowed, cost, unlikely))
    pairs = zip(*(each.tolist() for each in chosen), strict=True)
    return [(row, column) for row, column in pairs if allowed[row, column]]
