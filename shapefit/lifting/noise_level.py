"""lambda from the noise of the landmarks, with no truth needed."""

from __future__ import annotations

import numpy as np

from shapefit.arrays import Floats
from shapefit.convex.transforms import nuclear_norm

DRAWS, SEED = 512, 1504_01507
# Where the landmarks are all but exact the rule stops here; smaller lambdas change little and
# take longer.
LEAST = 1e-3
# Every shape is empty long before, and what is larger could overflow.
MOST = 1e30


def noise_dual_norm(atoms: Floats) -> float:
    """E max_i ||G B_i^T||_* over centred landmark noise G (2, p) of unit standard deviation.

    This is the mean lambda below which noise alone would switch an atom on. atoms (k, 3, p). The
    mean of seeded draws: the same for the same atoms.
    """
    k, _, p = atoms.shape
    G = np.random.default_rng(SEED).standard_normal((DRAWS, 2, p))
    G -= G.mean(axis=-1, keepdims=True)
    N = (G.reshape(2 * DRAWS, p) @ atoms.reshape(3 * k, p).T).reshape(DRAWS, 2, k, 3)
    return float(nuclear_norm(N.swapaxes(1, 2)).max(axis=1).mean())


def lambda_for_noise(atoms: Floats, noise: float, scale: Floats, visible_share: Floats) -> Floats:
    """lambda = noise / scale E max_i ||G B_i^T||_* sqrt(visible share), an image each.

    noise is the standard deviation of a landmark's coordinate in the unit of `scale` (n,), the
    scale by which the landmarks were normalised; visible_share (n,) in 0..1 shrinks the
    expectation for the landmarks that no noise reaches.
    """
    unit = noise_dual_norm(atoms)
    with np.errstate(over="ignore"):
        level = noise / scale * unit * np.sqrt(visible_share)
    return np.clip(level, LEAST, MOST)
