"""The objective of a sequence written out densely: the judge of the compiled kernel."""

import numpy as np

from shapefit.lifting.sequences.smoothing import fixed_lengths, further_weight, mean_lengths


def second_difference(t):
    D = np.zeros((max(t - 2, 0), t))
    for row in range(t - 2):
        D[row, row : row + 3] = (1, -2, 1)
    return D


class Objective:
    """Energy, gradient and Gauss-Newton matrix over frames y (t, 3p), and lengths l (e,)."""

    def __init__(self, visible, model, noise):
        self.visible, self.model = visible, model
        self.weight = further_weight(visible, noise)
        self.w = np.nan_to_num(visible.landmarks).reshape(len(visible), -1)
        D = second_difference(len(visible))
        self.hold, self.known = fixed_lengths(model, mean_lengths(visible.start, model.bones))
        self.motion = np.kron(D.T @ D, np.diag(np.tile(model.stiffness, 3)))

    def energy(self, y, lengths):
        total = 0.5 * y.reshape(-1) @ self.motion @ y.reshape(-1)
        total += 0.5 * (self.weight * (y[:, : self.w.shape[1]] - self.w) ** 2).sum()
        for f, frame in enumerate(y):
            total -= np.logaddexp.reduce(self.log_terms(f, frame))
        total += 0.5 * (lengths - self.known) @ self.hold @ (lengths - self.known)
        return total + 0.5 * (((self.bones(y)[1] - lengths) / self.model.give) ** 2).sum()

    def log_terms(self, f, frame):
        """Log of share times normal density of each mode, without the constant."""
        terms = []
        for share, mean, P, log_det in zip(
            self.visible.log_share[f], self.visible.mean[f], self.visible.precision[f],
            self.visible.log_det[f], strict=True,
        ):  # fmt: skip
            away = frame - mean
            terms.append(share - 0.5 * (away @ P @ away + log_det))
        return np.array(terms)

    def bones(self, y):
        points = y.reshape(len(y), 3, -1)
        i, j = self.model.bones.T
        along = points[:, :, i] - points[:, :, j]
        return along, np.linalg.norm(along, axis=1)

    def gradient(self, y, lengths, step=1e-6):
        """Central differences of the energy over y (t, 3p), and over the lengths."""
        at = np.concatenate([y.reshape(-1), lengths])
        found = np.empty_like(at)
        for place in range(len(at)):
            ends = []
            for sign in (1, -1):
                moved = at.copy()
                moved[place] += sign * step
                ends.append(self.energy(moved[: y.size].reshape(y.shape), moved[y.size :]))
            found[place] = (ends[0] - ends[1]) / (2 * step)
        return found

    def hessian(self, y, lengths, step=1e-3):
        """Second differences of the energy over the frames, the lengths held."""
        n = y.size
        moves = step * np.eye(n).reshape(n, *y.shape)
        H = np.empty((n, n))
        for i in range(n):
            for j in range(i + 1):
                signs = ((1, 1), (1, -1), (-1, 1), (-1, -1))
                H[i, j] = H[j, i] = sum(
                    a * b * self.energy(y + a * moves[i] + b * moves[j], lengths) for a, b in signs
                ) / (4 * step * step)
        return H

    def matrix(self, y):
        """Second derivatives over the frames, responsibilities and directions of bones held."""
        t, d = y.shape
        whole = self.motion.copy()
        i, j = self.model.bones.T
        along, size = self.bones(y)
        for f in range(t):
            terms = self.log_terms(f, y[f])
            shares = np.exp(terms - np.logaddexp.reduce(terms))
            block = np.einsum("k,kab->ab", shares, self.visible.precision[f])
            block[: self.w.shape[1], : self.w.shape[1]] += np.diag(self.weight[f])
            for b in range(len(i)):
                row = np.zeros((3, d // 3))
                row[:, i[b]] = along[f, :, b] / size[f, b]
                row[:, j[b]] = -row[:, i[b]]
                block += np.outer(row, row) / self.model.give[b] ** 2
            whole[f * d : (f + 1) * d, f * d : (f + 1) * d] += block
        return whole
