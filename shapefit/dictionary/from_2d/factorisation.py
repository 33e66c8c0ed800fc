"""First views: affine factorisation, upgraded by the orthonormality of rotations.

The landmarks of all images, W (2n, p), have a few leading factors L (2n, r). However the shape
deforms, three columns Q (r, 3) make L Q the first two rows of the rotations (Akhter, Sheikh, Khan
and Kanade, PAMI 2011). Q has few unknowns and many local optima: it grows from the rigid solution,
r = 3, a factor at a time, by Levenberg and Marquardt's method.
"""

from __future__ import annotations

import numpy as np

from shapefit.dictionary.from_2d.model import Floats, Images, Mask, Views
from shapefit.geometry.rotations import complete_rotation

COMPLETION_ROUNDS = 30
UPGRADE_ROUNDS = 30

FAR, NEAR = 4.0, 0.02
"""A landmark is gross, at first, so many medians from where the factors have it; or so many times
a share of the size of a shape, if that is more."""

MOST = 0.25
"""Share of the landmarks of an image beyond which they show a rare pose, and none is gross."""

SAME_SIZE = 1.0
"""Weight of the size of an image beside the angle and the ratio of its axes."""


def complete(images: Images, rank: int, *, doubting: bool = False) -> tuple[Floats, Mask]:
    """Return the landmarks (n, 2, p), centred, and which are gross (n, p), where in doubt.

    Hidden and gross ones are as factors of the rank have them; these are found by turns.
    """
    w, there = images.landmarks, images.weights > 0
    seen, placed = there, np.zeros_like(w)
    for k in range(COMPLETION_ROUNDS if doubting or not there.all() else 0):
        W, middle = filled(w, seen, placed)
        flat = W.reshape(-1, W.shape[2])
        leading = np.linalg.eigh(flat.T @ flat)[1][:, -min(3 + k // 3, rank) :]
        placed = (flat @ leading @ leading.T).reshape(W.shape)
        if doubting:
            apart = np.linalg.norm(w - middle - placed, axis=1)
            near = apart < FAR * max(float(np.median(apart[there])), NEAR)
            rare = (there & ~near).sum(axis=1) > MOST * there.sum(axis=1)
            seen = there & (near | rare[:, None])
    return filled(w, seen, placed)[0], there & ~seen


def filled(w: Floats, seen: Mask, placed: Floats) -> tuple[Floats, Floats]:
    """Return w (n, 2, p) as `placed` where not seen, centred; and its middle (n, 2, 1) before."""
    count = np.maximum(seen.sum(axis=1), 1)[:, None, None]
    middle = np.where(seen[:, None], w - placed, 0.0).sum(axis=2, keepdims=True) / count
    W = np.where(seen[:, None], w - middle, placed)
    return W - W.mean(axis=2, keepdims=True), middle


def find_views(W: Floats, ranks: tuple[int, ...]) -> list[Views]:
    """Return the views of landmarks W (n, 2, p), complete and centred, for each rank r."""
    n, _, p = W.shape
    U = np.linalg.svd(W.reshape(2 * n, p), full_matrices=False)[0]
    found = []
    L = (U * np.sqrt(2 * n / 3)).reshape(n, 2, -1)
    Q = rigid_upgrade(L[:, :, :3])
    for r in range(3, max(ranks) + 1):
        Q = upgrade(L[:, :, :r], np.concatenate([Q, np.zeros((r - len(Q), 3))]))
        if r in ranks:
            rows = L[:, :, :r] @ Q
            log_scale = np.log(np.maximum((rows**2).sum(axis=(1, 2)) / 2, 1e-4)) / 2
            found.append(Views(complete_rotation(rows), log_scale))
    return found


def rigid_upgrade(L: Floats) -> Floats:
    """Return Q (3, 3) with Q Q^T nearest to making L Q (n, 2, 3) orthonormal, linear in Q Q^T."""
    i, j = np.triu_indices(3)
    products = L[:, [0, 1, 0]][..., i] * L[:, [0, 1, 1]][..., j]
    products += np.where(i != j, L[:, [0, 1, 0]][..., j] * L[:, [0, 1, 1]][..., i], 0.0)
    target = np.tile([1.0, 1.0, 0.0], len(L))
    G = np.empty((3, 3))
    G[i, j] = G[j, i] = np.linalg.lstsq(products.reshape(-1, 6), target, rcond=None)[0]
    size, axes = np.linalg.eigh(G)
    found: Floats = axes * np.sqrt(np.maximum(size, 1e-2 * max(size[-1], 1e-2)))
    return found


def upgrade(L: Floats, Q: Floats) -> Floats:
    """min over Q (r, 3) of sum_n (a b)^2 + (a a - b b)^2 / 4 + (a a + b b - 2)^2 / 4, rows a, b."""
    r, damping = len(Q), 1e-3

    def residuals(Q: Floats) -> tuple[Floats, Floats]:
        M = L @ Q
        a, b = M[:, 0], M[:, 1]
        aa, bb, ab = (a * a).sum(axis=1), (b * b).sum(axis=1), (a * b).sum(axis=1)
        return M, np.stack([ab, (aa - bb) / 2, SAME_SIZE * (aa + bb - 2) / 2])

    M, c = residuals(Q)
    floor = 1e-9 * len(L) * np.eye(3 * r)
    for _ in range(UPGRADE_ROUNDS):
        da = L[:, 0, :, None] * M[:, 0, None]  # half the derivative of a a
        db = L[:, 1, :, None] * M[:, 1, None]
        dab = L[:, 0, :, None] * M[:, 1, None] + L[:, 1, :, None] * M[:, 0, None]
        J = np.stack([dab, da - db, SAME_SIZE * (da + db)]).reshape(-1, 3 * r)
        H, g = J.T @ J, J.T @ c.ravel()
        step = np.linalg.solve(H + damping * np.diag(np.diag(H)) + floor, g).reshape(r, 3)
        tried, left = residuals(Q - step)
        if (left**2).sum() < (c**2).sum():
            done = (left**2).sum() > (1 - 1e-4) * (c**2).sum()
            Q, M, c, damping = Q - step, tried, left, damping * 0.3
            if done:
                break
        else:
            damping *= 5
    return Q
