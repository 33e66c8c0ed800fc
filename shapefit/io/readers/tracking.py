"""Detections without identity, joined over frames: who is nearest is the same person.

In each frame the assignment of detections to tracks that minimises

    sum of d / reach + (1 - overlap) / 2

over the pairs with d <= reach, after as many pairs as possible: d is the mean distance
of their landmarks, after the smooth motion of the track, relative to the size of the
person; overlap is that of their boxes (intersection over union). No learned appearance,
nothing beyond one pass.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from itertools import count, islice
from typing import NamedTuple

import numpy as np

from shapefit.arrays import Flags, Floats, Integers
from shapefit.io.readers.poses import Poses

FRAME_REACH = 0.35
"""How far landmarks go in a frame beyond the motion so far, in diagonals of the box:
who runs crosses a fifth of it at 30 Hz.
"""

REACH_PER_MISSED_FRAME = 0.1
"""What each missed frame adds to the reach."""

MAX_REACH = 1.0
"""However many frames are missed."""

MAX_UNSEEN_FRAMES = 14
"""For which a track goes on."""

MAX_MOVING_FRAMES = 3
"""For which an unseen track is expected to move on."""

MOTION_SHARE = 0.3
"""Of a frame's motion in the smooth motion of a track."""


class _Detections(NamedTuple):
    """N detections, one a pose; a tracked one takes missing landmarks from its track.

    points (N, p, 2 or 3), weights (N, p), frame (N,), motion (N, 2) in pixels a frame,
    boxes (N, 4) of least and largest x and y, and size (N,), their diagonals.
    """

    points: Floats
    weights: Floats
    frame: Integers
    motion: Floats
    boxes: Floats
    size: Floats


def track_people(poses: Poses) -> Sequence[str] | None:
    """Return the individual of each pose (N,); track those without one as `person 1`...

    "" for those without a landmark; None where the format knows no individuals.

    Tracks are numbered in order of their first frames, through all videos.
    """
    if poses.individual is None:
        return None
    detections = _as_detections(poses)
    anonymous = np.array([not who for who in poses.individual], bool)
    seen = detections.weights.any(axis=1)
    number = _number_tracks(poses, detections, np.flatnonzero(anonymous & seen))
    taken = set(poses.individual)
    free = (name for n in count(1) if (name := f"person {n}") not in taken)
    tracks = int(number.max(initial=-1)) + 1
    names = [*islice(free, tracks), ""]  # the last is that of -1
    return [
        who or names[n]
        for who, n in zip(poses.individual, number.tolist(), strict=True)
    ]


def _as_detections(poses: Poses) -> _Detections:
    """Convert poses to detections with zero motion."""
    weights = np.isfinite(poses.points).all(axis=2).astype(float)
    if poses.confidence is not None:
        weights *= np.clip(np.nan_to_num(poses.confidence, nan=1.0), 0, 1)
    points = np.clip(poses.points, -1e100, 1e100)  # their squares do not overflow
    points[weights == 0] = np.nan
    finite = np.isfinite(points[..., :2])
    low = np.where(finite, points[..., :2], np.inf).min(axis=1, initial=np.inf)
    high = np.where(finite, points[..., :2], -np.inf).max(axis=1, initial=-np.inf)
    return _Detections(
        points=points,
        weights=weights,
        frame=np.asarray(poses.frame),
        motion=np.zeros((len(poses), 2)),
        boxes=np.concatenate([low, high], axis=1),
        size=np.maximum(np.sqrt(((high - low) ** 2).sum(axis=1)), 1e-9),
    )


def _number_tracks(poses: Poses, detections: _Detections, rows: Integers) -> Integers:
    """Join detections at `rows` to tracks; return track numbers (N,), -1 for others."""
    rows_of: defaultdict[tuple[str, int], list[int]] = defaultdict(list)
    videos = poses.videos
    frames = poses.frame.tolist()
    for row in rows.tolist():
        rows_of[videos[row], frames[row]].append(row)
    number = np.full(len(poses), -1)
    open_tracks: dict[str, Integers] = {}  # the last detection of each
    following = 0
    for (video, frame), detected in rows_of.items():
        found = np.array(detected)
        tracks = open_tracks.get(video, found[:0])
        tracks = tracks[frame - detections.frame[tracks] <= MAX_UNSEEN_FRAMES + 1]
        if len(tracks):
            who, which = _match_tracks(detections, tracks, found)
            number[found[which]] = number[tracks[who]]
            tracks[who] = found[which]
        new = found[number[found] < 0]
        number[new] = np.arange(following, following + len(new))
        following += len(new)
        open_tracks[video] = np.concatenate([tracks, new])
    return number


def _match_tracks(
    detections: _Detections, tracks: Integers, rows: Integers
) -> Integers:
    """Match tracks (T,) to detections `rows` (D,) of a frame: index pairs (2, m).

    tracks are the rows of their last detections. Updates the matched detections: their
    motion; landmarks that one lacks are taken from its track, and move as that does.
    """
    passed = np.maximum(detections.frame[rows[0]] - detections.frame[tracks], 1)
    steps = detections.motion[tracks] * np.minimum(passed, MAX_MOVING_FRAMES)[:, None]
    expected = detections.points[tracks]
    expected[..., :2] += steps[:, None]
    boxes = (detections.boxes[tracks] + np.tile(steps, 2))[:, None]
    others = detections.boxes[rows]

    reach = np.minimum(FRAME_REACH + REACH_PER_MISSED_FRAME * (passed - 1), MAX_REACH)
    scale = np.maximum(detections.size[tracks, None], detections.size[rows])
    distance, total = _distances(detections, expected, rows, scale)
    if not total.all():  # without a common landmark, the middles of the boxes
        middle = (others[:, :2] + others[:, 2:] - boxes[..., :2] - boxes[..., 2:]) / 2
        distance = np.where(total > 0, distance, np.sqrt((middle**2).sum(axis=2)))
    ratio = distance / (scale * reach[:, None])
    pairs = assign(ratio + (1 - _overlaps(boxes, others)) / 2, ratio <= 1)

    who, which = np.array(pairs, np.intp).reshape(-1, 2).T
    _update_motion(detections, tracks[who], rows[which], passed[who], expected[who])
    return np.array([who, which])


def _distances(
    detections: _Detections, expected: Floats, rows: Integers, scale: Floats
) -> tuple[Floats, Floats]:
    """Return the mean distance (T, D) of tracks from detections, and its weight (T, D).

    Both are of the landmarks that they have in common: `expected` (T, p, d) of tracks,
    and those of the detections `rows` (D,). One counts up to `scale` (T, D).
    """
    difference = detections.points[rows] - expected[:, None]
    away = np.sqrt(np.einsum("tdpc,tdpc->tdp", difference, difference))
    common = np.where(np.isnan(away), 0.0, detections.weights[rows])
    # One landmark that went astray counts no more than the size of the person.
    away = np.fmin(away, scale[..., None])
    total = common.sum(axis=2)
    distance = np.einsum("tdp,tdp->td", away, common) / np.maximum(total, 1e-12)
    return distance, total


def _overlaps(boxes: Floats, others: Floats) -> Floats:
    """Return intersection over union (T, D) of boxes (T, 1, 4) and `others` (D, 4)."""
    least = np.maximum(boxes[..., :2], others[:, :2])
    most = np.minimum(boxes[..., 2:], others[:, 2:])
    shared = np.maximum(most - least, 0).prod(axis=-1)
    areas = sum((box[..., 2:] - box[..., :2]).prod(axis=-1) for box in (boxes, others))
    overlap: Floats = shared / np.maximum(areas - shared, 1e-12)
    return overlap


def _update_motion(
    detections: _Detections,
    before: Integers,
    after: Integers,
    passed: Integers,
    expected: Floats,
) -> None:
    """Update detections `after` (m,) in place by those `before` (m,) in their tracks.

    It sets their motion, smoothed over `passed` (m,) frames; their missing landmarks,
    as `expected` (m, p, d); and their size, which does not collapse.
    """
    points = detections.points[after]
    moved = (points - detections.points[before])[..., :2]
    both = ~np.isnan(moved[..., :1])
    number = both.sum(axis=1)
    mean = np.where(both, moved, 0.0).sum(axis=1) / np.maximum(number, 1)
    smooth = detections.motion[before]
    motion = smooth + MOTION_SHARE * (mean / passed[:, None] - smooth)
    detections.motion[after] = np.where(number > 0, motion, smooth)
    detections.points[after] = np.where(np.isnan(points), expected, points)
    detections.size[after] = np.maximum(
        detections.size[after], 0.95 * detections.size[before]
    )


def assign(cost: Floats, allowed: Flags) -> list[tuple[int, int]]:
    """Match rows to columns: as many `allowed` pairs as possible, at least total cost.

    Returns pairs (row, column).
    """
    padded = np.where(allowed, cost, np.inf)
    rows = np.flatnonzero(allowed.any(axis=1))
    best = padded[rows].argmin(axis=1) if len(rows) else rows
    if len({*best.tolist()}) == len(rows):  # the optimum, without the import
        return list(zip(rows.tolist(), best.tolist(), strict=True))
    from scipy.optimize import linear_sum_assignment

    unlikely = 1.0 + 2.0 * float(np.abs(cost[allowed]).sum())
    chosen = linear_sum_assignment(np.where(allowed, cost, unlikely))
    pairs = zip(*(numbers.tolist() for numbers in chosen), strict=True)
    return [(row, column) for row, column in pairs if allowed[row, column]]
