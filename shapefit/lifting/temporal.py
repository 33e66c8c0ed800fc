"""Depths along a sequence: bones keep their lengths, points do not jump, most estimates hold.

An image leaves the sign and much of the size of the depths open; the frames of one body seen by a
camera of constant scale do not. Over a sequence a bone is seen from many sides, and its length in
3D is the largest that it has in the images. The depths z (t, p) of a sequence minimise

    sum rho(z - z0)  +  smoothness / 2  sum_t ||z_(t-1) - 2 z_t + z_(t+1)||^2
                     +  rigidity / 2  sum_(t, bones ij) (||s_i - s_j|| - l_ij)^2

where s = (x, y, z), x and y stay, z0 are the depths that the images gave one by one, and rho(r) =
tolerance^2 (sqrt(1 + (r / tolerance)^2) - 1) forgives gross errors of z0. Each round majorises rho
by a parabola and the length of a bone by its tangent, and solves the banded system that is left:
no round raises the objective. The minimum is a local one, near z0. The idea is our own; that a
sequence should move smoothly is in Zhou et al., MonoCap.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded

from shapefit.lifting.options import DepthOptions

Floats = NDArray[np.float64]
Indices = NDArray[np.integer]

DIFFERENCE = (1.0, -2.0, 1.0)
STILL = 1e-4  # rounds end when no depth moves by more, in units of the size of the landmarks


def refine_sequences(
    shapes: Floats, sequences: tuple[str, ...], bones: Indices, settings: DepthOptions
) -> Floats:
    """Refine the depths of shapes (n, 3, p) in camera frames, each sequence by itself.

    A sequence is a run of images with one name, in order of time and in one unit; bones (e, 2).
    Shapes with nan are left alone, and the frames before and after them are not neighbours, but
    they share their lengths. The mean depth of a frame stays.
    """
    if len(sequences) != len(shapes):
        raise ValueError(f"{len(sequences)} sequence names for {len(shapes)} shapes")
    refined = shapes.copy()
    known = np.asarray(np.isfinite(shapes).all(axis=(1, 2)))
    for clip in runs(np.array(sequences, dtype=object)):
        landmarks = shapes[clip, :2][known[clip]]
        if not len(landmarks):
            continue
        scale = _size(landmarks)
        if not scale > 0:  # empty shapes, all landmarks on one point: there are no depths
            continue
        lengths = longest_lengths(landmarks, bones) / scale
        for part in runs(known[clip]):
            part = slice(clip.start + part.start, clip.start + part.stop)
            if known[part.start]:
                points = shapes[part] / scale
                refined[part, 2] = scale * refine_depths(points, bones, lengths, settings)
    return refined


def longest_lengths(landmarks: Floats, bones: Indices) -> Floats:
    """max_t ||w_ti - w_tj||: the lengths (e,) of bones ij from landmarks (t, 2, p).

    A projection is never longer than the bone. The bound is reached where the bone was once
    parallel to the image, as after a turn of the camera or the body.
    """
    i, j = bones.T
    longest: Floats = np.linalg.norm(landmarks[:, :, i] - landmarks[:, :, j], axis=1).max(axis=0)
    return longest


def refine_depths(
    points: Floats, bones: Indices, lengths: Floats, settings: DepthOptions
) -> Floats:
    """Local minimum z (t, p) of the objective above from points (t, 3, p) = (x, y, z0).

    bones (e, 2) of lengths (e,), in the unit of the points, whose landmarks have a size of
    about 1. The mean depth of each frame is that of z0.
    """
    frames, _, p = points.shape
    i, j = bones.T
    z0 = points[:, 2]
    across = ((points[:, :2, i] - points[:, :2, j]) ** 2).sum(axis=1)
    incidence = np.zeros((len(bones), p))
    incidence[np.arange(len(bones)), i] = 1.0
    incidence[np.arange(len(bones)), j] -= 1.0
    fixed = _banded(frames, settings.smoothness, settings.rigidity * incidence.T @ incidence)

    z = z0
    for _ in range(settings.max_rounds):
        weights = 1.0 / np.sqrt(1.0 + ((z - z0) / settings.tolerance) ** 2)
        deep = z[:, i] - z[:, j]
        size = np.sqrt(across + deep**2)
        target = np.divide(lengths * deep, size, out=np.zeros_like(deep), where=size > 0)
        right = weights * z0 + settings.rigidity * target @ incidence
        system = fixed.copy()
        system[0] += weights.ravel()
        moved = solveh_banded(system, right.ravel(), lower=True).reshape(frames, p)
        step = np.abs(moved - z).max()
        z = moved
        if step <= STILL:
            break
    centred: Floats = z + (z0 - z).mean(axis=1, keepdims=True)
    return centred


def runs(values: NDArray[np.generic]) -> list[slice]:
    """Slices of equal neighbours in values (n,)."""
    changes = np.flatnonzero(values[1:] != values[:-1]) + 1
    ends = [0, *changes.tolist(), len(values)]
    return [slice(start, stop) for start, stop in pairwise(ends) if stop > start]


def _size(landmarks: Floats) -> float:
    """Root of the mean variance of a coordinate over the landmarks (t, 2, p) of each frame."""
    return float(np.sqrt(landmarks.var(axis=2).mean()))


def _banded(frames: int, smoothness: float, within: Floats) -> Floats:
    """Lower bands of smoothness D^T D (x) I + I (x) within (p, p), D the second difference."""
    p = len(within)
    bands = np.zeros((1 + 2 * p, frames, p))
    for band in range(p):
        bands[band, :, : p - band] = np.diagonal(within, -band)
    for first in range(frames - 2):
        for a, left in enumerate(DIFFERENCE):
            for b, right in enumerate(DIFFERENCE[: a + 1]):
                bands[(a - b) * p, first + b] += smoothness * left * right
    return bands.reshape(1 + 2 * p, frames * p)
