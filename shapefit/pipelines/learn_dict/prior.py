"""The prior over shapes of a dictionary, as the section `prior` says."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.config.commands.learn_dict import PriorConfig
from shapefit.dictionary.mixture import Mixture
from shapefit.dictionary.mixture_learning import learn_mixture
from shapefit.dictionary.variations import find_skeleton, vary
from shapefit.errors import counted, input_error
from shapefit.geometry.normalisation import normalise
from shapefit.geometry.procrustes import choose, rotation_onto
from shapefit.pipelines.learn_dict.training_shapes import (
    TrainingOptions,
    TrainingShapes,
    chosen_landmarks,
)

FEWEST_COPIES, MOST_COPIES, ENOUGH = 2, 100, 1500
"""Copies of each shape that is varied, and how many shapes are enough for a mixture."""

MOST_ROUNDS = 20
"""Rounds of expectation maximisation, which ends sooner where it gains nothing."""


def learn_prior(
    training: TrainingShapes, options: PriorConfig, aligned: TrainingOptions
) -> tuple[Mixture, str]:
    """Return the mixture over the aligned shapes, varied, and a note.

    Raises InputError for more components than shapes, weights that are none, and bones that are no
    tree where they are to vary.
    """
    if options.components > len(training):
        there = counted(len(training), "shape")
        found = f"{options.components} components are more than the {there} to learn from"
        raise input_error("prior.components", found, "lower it, or give more shapes")
    copies = find_copies(len(training), options)
    weights = np.tile(find_weights(training, options.weights), copies)
    shapes = vary_shapes(training, options, aligned)
    learned = learn_mixture(
        shapes,
        options.components,
        shrinkage=options.shrinkage,
        floor=options.floor,
        weights=weights,
        max_rounds=MOST_ROUNDS,
    )
    note = f"prior of {counted(len(learned.mixture), 'component')}"
    return learned.mixture, note


def find_copies(number: int, options: PriorConfig) -> int:
    """Return the copies of each of so many shapes: as set, or enough of varied ones."""
    if options.copies is not None:
        return options.copies
    if not (options.stretch or options.exchange):
        return 1
    return min(max(FEWEST_COPIES, ENOUGH // number), MOST_COPIES)


def find_weights(training: TrainingShapes, name: str | None) -> Floats:
    """Return the weight of each shape (n,): 1, or as the dataset of that name says."""
    if name is None:
        return np.ones(len(training))
    place = f"prior.weights: {name}"
    values = training.original.per_item(name)
    if values is None:
        raise input_error(place, "the shapes have no such dataset", "name one with their weights")
    weights = np.asarray(values)
    fine = weights.shape == (len(training),) and weights.dtype.kind in "fiu"
    if not fine or not (np.isfinite(weights) & (weights >= 0)).all() or not weights.any():
        raise input_error(place, "holds no weights", "give each shape a number >= 0, not all 0")
    return weights.astype(np.float64)


def vary_shapes(training: TrainingShapes, options: PriorConfig, aligned: TrainingOptions) -> Floats:
    """Return the shapes to learn from (copies n, 3, p), normalised and turned onto their mean."""
    shapes = training.alignment.shapes
    copies = find_copies(len(shapes), options)
    if copies == 1 and not (options.stretch or options.exchange):
        return shapes
    edges, points = training.original.edges, shapes.shape[2]
    try:
        if edges is None:
            raise ValueError("the shapes have no edges")
        skeleton = find_skeleton(edges, points)
    except ValueError as error:
        fix = "give shapes whose `edges` are bones, or leave out `stretch`, `exchange` and `copies`"
        raise input_error("prior", str(error), fix) from None
    varied = vary(
        shapes,
        skeleton,
        copies=copies,
        stretch=options.stretch,
        exchange=options.exchange,
        partners=training.dictionary.mirror_index,
    )
    varied = normalise(varied).points
    if aligned.align == "none":
        return varied
    # Landmarks that are indexed lie in another order in memory, in which sums round differently.
    chosen = chosen_landmarks(training.original.landmark_names, aligned) or list(range(points))
    mean = choose(training.alignment.mean, chosen)
    turned: Floats = rotation_onto(choose(varied, chosen), mean) @ varied
    return turned


def find_groups(sequences: tuple[str, ...] | None, n: int, folds: int) -> NDArray[np.intp]:
    """Return the group (n,) that each item is left out with: whole sequences, or blocks."""
    if sequences is None or len(set(sequences)) < 2:
        return np.arange(n) * folds // n
    number = {name: i % folds for i, name in enumerate(dict.fromkeys(sequences))}
    return np.array([number[name] for name in sequences], dtype=np.intp)
