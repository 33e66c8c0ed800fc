"""How sure of itself a prior may be, by shapes that were left out of it.

A prior of 180 poses knows less of others than one of 20,000, and no pose that it was learned from
says so. Folds of shapes are left out in turn, whole sequences or clusters of poses. Of the shares s
of the covariance of all shapes, floors g and widths f those are taken that make

    1/n sum_n log sum_k pi_k exp E log N(x_n + e; mu_k, f C_k(s, g) + v I),    e ~ N(0, (g_0 + v) I)

the largest, for each shape x_n, the mixture learned without its fold, and the misfit v of
landmarks. Values below those of today's defaults (s_0, g_0) are not tried: bodies differ more than
the sequences of a few.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np

from shapefit.arrays import Floats, Integers
from shapefit.dictionary.mixture import (
    Mixture,
    expected_log_density,
    kmeans,
    maximise,
    pull_of,
    pulled_to,
)

SHRINKAGES = (0.3, 0.5, 0.7)
FLOORS = (0.01, 0.02, 0.04, 0.08)
WIDTHS = (1.0, 1.5, 2.0, 3.0, 4.0)
"""What is tried where it is not given; the first of each are those of a prior of many shapes."""

FOLDS = 8
"""At most. By 8 clusters of 8 to 180 poses of subject 86 widths come out between those that suit
its other sequences and those that suit other bodies; by 16 they are too small."""

SCORED = 2000
"""Shapes left out that are judged, evenly spread."""

RESIDUAL_VARIANCE = 0.01
"""v, the variance of a coordinate of a normalised landmark that `fit` assumes by default."""


class Sureness(NamedTuple):
    """Shrinkage s, floor g and width f of a prior."""

    shrinkage: float
    floor: float
    width: float


AS_LEARNED = Sureness(SHRINKAGES[0], FLOORS[0], WIDTHS[0])


class Chosen(NamedTuple):
    """What was chosen, by how many folds, and the nats a shape that it gains over the first."""

    sureness: Sureness
    folds: int
    gain: float


def find_folds(shapes: Floats, sequences: tuple[str, ...] | None) -> Integers:
    """Fold (n,) of each shape (n, 3, p): whole sequences, neighbours together, else clusters."""
    names = list(dict.fromkeys(sequences or ()))
    if len(names) > 1:
        of = {name: i * FOLDS // max(len(names), FOLDS) for i, name in enumerate(names)}
        return np.array([of[name] for name in sequences or ()])
    n = len(shapes)
    return kmeans(shapes.reshape(n, -1), min(FOLDS, n), np.ones(n))


def choose_sureness(
    shapes: Floats,
    weights: Floats,
    folds: Integers,
    mixture: Mixture,
    tried: Sequence[tuple[float, ...]],
) -> Chosen:
    """Choose among (shrinkages, floors, widths), the first of which the mixture was learned with.

    shapes (n, 3, p) with weights and folds (n,). A fold is left out of the mixture by one step of
    maximisation without its shapes, so that learning takes hardly longer.
    """
    shrinkages, floors, widths = tried
    X = np.ascontiguousarray(shapes.reshape(len(shapes), -1))
    density = expected_log_density(X, mixture, floors[0])
    share = np.exp(density - density.max(axis=1, keepdims=True))
    share *= (weights / share.sum(axis=1))[:, None]
    scored = np.zeros(len(X), bool)
    scored[np.unique(np.linspace(0, len(X) - 1, SCORED).astype(int))] = True
    variances = [(f, f * (g - floors[0]) + RESIDUAL_VARIANCE) for g, f in product(floors, widths)]
    total, number = np.zeros((len(shrinkages), len(variances))), 0
    for fold in np.unique(folds):
        left, out = folds != fold, (folds == fold) & scored
        if not (weights[left].any() and weights[out].any()):
            continue
        number += 1
        G = pulled_to(X[left], weights[left], floors[0])
        for row, shrinkage in enumerate(shrinkages):
            kappa = pull_of(shrinkage, weights[left].sum(), len(mixture))
            without = maximise(X[left], share[left], G, kappa, floors[0])
            found = log_densities(X[out], without, variances, floors[0] + RESIDUAL_VARIANCE)
            total[row] += weights[out] @ found
    if number < 2:
        return Chosen(Sureness(shrinkages[0], floors[0], widths[0]), 0, 0.0)
    best = int(total.argmax())
    gain = float(total.flat[best] - total.flat[0]) / float(weights[scored].sum())
    return Chosen(Sureness(*list(product(*tried))[best]), number, gain)


def log_densities(
    X: Floats, mixture: Mixture, variances: list[tuple[float, float]], noise: float
) -> Floats:
    """log sum_k pi_k exp E log N(x + e; mu_k, f C_k + v I) for pairs (f, v): (n, pairs).

    X (n, d); e has the variance `noise`. Where shapes lie, their middle, is not judged.
    """
    p = mixture.means.shape[2]
    centred = np.linalg.svd(np.eye(p) - 1 / p)[0][:, :-1]
    basis = np.kron(np.eye(3), centred)
    f, v = np.array(variances).T
    found = np.full((len(X), len(variances)), -np.inf)
    for weight, mean, C in zip(mixture.weights, mixture.means, mixture.covariances, strict=True):
        along, axes = np.linalg.eigh(basis.T @ C @ basis)
        variance = np.outer(along, f) + v
        apart = ((X - mean.ravel()) @ basis @ axes) ** 2
        log_size = np.log(2 * np.pi * variance).sum(axis=0)
        own = -0.5 * (log_size + (apart + noise) @ (1 / variance))
        with np.errstate(divide="ignore"):  # of a component that had the fold's shapes only
            found = np.logaddexp(found, np.log(weight) + own)
    return found
