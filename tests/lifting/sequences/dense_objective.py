"""The energy of a sequence written out densely, as judge of its smoothing."""

import numpy as np

from shapefit.arrays import Floats
from shapefit.lifting.sequences.smoothing import (
    Observations,
    SequenceModel,
    length_penalty,
    mean_lengths,
    remaining_precision,
)
from shapefit.timeline import Timeline

LONG_GAP_AT = 8
"""Place after which the timeline `with_gaps` of the tests has a gap of a second."""


class Objective:
    """Energy, gradient and Gauss-Newton matrix over frames y (t, 3p), and lengths l
    (e,).
    """

    def __init__(self, visible: Observations, model: SequenceModel, noise: float):
        self.visible = visible
        self.model = model
        self.weight = remaining_precision(visible, noise)
        self.w = np.nan_to_num(visible.landmarks).reshape(len(visible), -1)
        D = second_difference(model.timeline, len(visible))
        self.motion = np.kron(D.T @ D, np.diag(np.tile(model.stiffness, 3)))
        measured = mean_lengths(visible.start, model.bones)
        self.length_precision, self.usual_lengths = length_penalty(model, measured)

    @property
    def start(self) -> Floats:
        """The frames (t, 3p) from which smoothing starts."""
        return self.visible.start.reshape(len(self.visible), -1)

    def energy(self, y: Floats, lengths: Floats) -> float:
        motion_term = y.ravel() @ self.motion @ y.ravel()
        off = y[:, : self.w.shape[1]] - self.w
        landmark_term = (self.weight * off**2).sum()
        excess = lengths - self.usual_lengths
        length_term = excess @ self.length_precision @ excess
        stretch = (self.bone_lengths(y) - lengths) / self.model.bone_tolerance
        bone_term = (stretch**2).sum()
        log_shares = [
            np.logaddexp.reduce(self.log_terms(f, frame)) for f, frame in enumerate(y)
        ]
        squares = motion_term + landmark_term + length_term + bone_term
        return 0.5 * squares - np.sum(log_shares)

    def log_terms(self, f: int, frame: Floats) -> Floats:
        """Log of share times normal density of each mode, without the constant."""
        away = frame - self.visible.mean[f]
        squares = np.einsum("ka,kab,kb->k", away, self.visible.precision[f], away)
        return self.visible.log_share[f] - 0.5 * (squares + self.visible.log_det[f])

    def bone_vectors(self, y: Floats) -> Floats:
        """Return vectors (t, 3, e) along the bones, to their first landmark."""
        points = y.reshape(len(y), 3, -1)
        i, j = self.model.bones.T
        return points[:, :, i] - points[:, :, j]

    def bone_lengths(self, y: Floats) -> Floats:
        return np.linalg.norm(self.bone_vectors(y), axis=1)

    def bone_slopes(self, y: Floats) -> Floats:
        """Return the derivative (t, e, 3p) of the length of each bone of a frame."""
        vectors = self.bone_vectors(y)
        directions = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
        t, d = y.shape
        slopes = np.zeros((t, len(self.model.bones), 3, d // 3))
        for b, (i, j) in enumerate(self.model.bones):
            slopes[:, b, :, i] = directions[:, :, b]
            slopes[:, b, :, j] = -directions[:, :, b]
        return slopes.reshape(t, -1, d)

    def gradient(self, y: Floats, lengths: Floats, step: float = 1e-6) -> Floats:
        """Central differences of the energy over y (t, 3p), and over the lengths."""
        at = np.concatenate([y.ravel(), lengths])

        def energy(unknowns: Floats) -> float:
            return self.energy(unknowns[: y.size].reshape(y.shape), unknowns[y.size :])

        gradient = np.empty_like(at)
        for place in range(len(at)):
            move = np.zeros_like(at)
            move[place] = step
            gradient[place] = (energy(at + move) - energy(at - move)) / (2 * step)
        return gradient

    def hessian(self, y: Floats, lengths: Floats, step: float = 1e-3) -> Floats:
        """Second differences of the energy over the frames, the lengths held."""
        n = y.size
        moves = step * np.eye(n).reshape(n, *y.shape)
        H = np.empty((n, n))

        def energy(move: Floats) -> float:
            return self.energy(y + move, lengths)

        for i, a in enumerate(moves):
            for j, b in enumerate(moves[: i + 1]):
                alike = energy(a + b) + energy(-a - b)
                opposite = energy(a - b) + energy(b - a)
                H[i, j] = (alike - opposite) / (4 * step * step)
                H[j, i] = H[i, j]
        return H

    def matrix(self, y: Floats) -> Floats:
        """Second derivatives over the frames, responsibilities and directions of bones
        held.
        """
        d = y.shape[1]
        seen = self.w.shape[1]
        bone_weight = 1 / self.model.bone_tolerance**2
        slopes = self.bone_slopes(y)
        whole = self.motion.copy()
        for f, frame in enumerate(y):
            terms = self.log_terms(f, frame)
            share = np.exp(terms - np.logaddexp.reduce(terms))
            block = np.tensordot(share, self.visible.precision[f], axes=1)
            block[:seen, :seen] += np.diag(self.weight[f])
            block += slopes[f].T @ (bone_weight[:, None] * slopes[f])
            rows = slice(f * d, (f + 1) * d)
            whole[rows, rows] += block
        return whole

    def system(self, y: Floats, damping: float) -> Floats:
        """Return the damped Gauss-Newton matrix over frames and lengths together."""
        bone_weight = 1 / self.model.bone_tolerance**2
        frame_block = self.matrix(y) + damping * np.eye(y.size)
        mixed = -bone_weight[:, None] * self.bone_slopes(y)
        mixed = np.swapaxes(mixed, 1, 2).reshape(y.size, -1)
        length_block = np.diag(len(y) * bone_weight + 1e-9) + self.length_precision
        return np.block([[frame_block, mixed], [mixed.T, length_block]])


def second_difference(timeline: Timeline | None, t: int) -> Floats:
    """Return D (t - 2, t) of frames one apart, or of a timeline with a long gap, over
    which nothing is compared.
    """
    D = np.zeros((max(t - 2, 0), t))
    for row in range(t - 2):
        D[row, row : row + 3] = (1, -2, 1)
        if timeline is not None:
            D[row, row : row + 3] = weights_of_gaps(timeline.position[row : row + 3])
    return D


def weights_of_gaps(position: Floats) -> Floats:
    """Return the weights (3,) of the second difference of frames at positions."""
    is_one_stretch = position[2] < LONG_GAP_AT or position[0] > LONG_GAP_AT
    if not is_one_stretch:
        return np.zeros(3)
    h, k = np.diff(position)
    slopes = np.array([1 / h, -1 / h - 1 / k, 1 / k])
    return slopes / np.sqrt((h + k) / 2)
