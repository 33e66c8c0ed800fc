"""A dictionary of 3D shapes: atoms by one of three methods, and a prior over shapes."""

from __future__ import annotations

import json
from collections.abc import Generator, Mapping
from dataclasses import replace

import numpy as np

from shapefit import __version__
from shapefit.arrays import Floats
from shapefit.config import LearnDictConfig
from shapefit.config.commands.learn_dict import PriorConfig
from shapefit.dictionary.bodies import find_skeleton, vary
from shapefit.dictionary.learning import learn, principal_components, scale_of_atoms
from shapefit.dictionary.mixture import Mixture, learn_mixture
from shapefit.dictionary.model import Dictionary
from shapefit.errors import counted, input_error
from shapefit.geometry.normalisation import normalise
from shapefit.geometry.procrustes import choose, rotation_onto
from shapefit.io import ShapeSet
from shapefit.meshes.dense import mesh_of_atoms
from shapefit.pipelines.learn_dict.training_shapes import (
    TrainingShapes,
    aligned_landmarks,
    find_training_shapes,
    number_of_atoms,
)
from shapefit.pipelines.result import Result

Learning = Generator[Result, None, Dictionary]
"""Yields an outcome a round, and returns the dictionary; the last outcome sums up."""

MOST_ROUNDS = 20
"""Rounds of expectation maximisation, which ends sooner where it gains nothing."""

SHAPES_PER_COMPONENT, MOST_COMPONENTS = 150, 32
"""Of a mixture whose components are not given. A component of 45 coordinates needs a hundred shapes
and more beside what all shapes say."""

FEWEST_COPIES, MOST_COPIES, ENOUGH = 2, 100, 1500
"""Copies of each shape that is varied, and how many shapes are enough for a mixture."""


def learn_from_shapes(
    given: ShapeSet, config: LearnDictConfig, inputs: Mapping[str, str]
) -> Learning:
    """Learn a dictionary from 3D shapes; `inputs` are the digests of their files.

    The first outcome lists the shapes that cannot be used. Raises InputError as
    `find_training_shapes` and `learn_prior` do, and for bases of sequences that all stand still.
    """
    training = find_training_shapes(given, config)
    note = counted(len(training), "shape")
    yield Result(failures=training.failures, note=note)
    match config.method:
        case "exemplars":
            made = exemplars(training)
        case "pca-bases":
            made = pca_bases(training, config.bases)
        case _:
            made = yield from sparse_coding(training, config)
    if config.method != "sparse-coding":
        yield Result(rows=(("Result", f"{counted(made.k, 'atom')} from {note}"),))
    prior = learn_prior(training, config) if config.prior.components else None
    provenance = {
        "method": config.method,
        "version": __version__,
        "config": config.as_json(),
        "inputs": json.dumps(inputs),
    }
    return replace(made, prior=prior, provenance=provenance)


def with_p_value_table(made: Dictionary) -> Dictionary:
    """Return the dictionary with the table of its prior, if it has one, by which fits judge."""
    if made.prior is None:
        return made
    from shapefit.lifting.posterior.p_value import draw_table

    return replace(made, p_value_table=draw_table(made.prior))


def exemplars(training: TrainingShapes) -> Dictionary:
    """Make every training shape an atom, with its mesh."""
    return replace(
        training.dictionary,
        atoms=training.alignment.shapes,
        mesh_vertices=training.mesh_vertices,
        mesh_faces=training.original.mesh_faces,
        atom_scale=training.scale,
        atom_items=training.original.items,
    )


def pca_bases(training: TrainingShapes, wanted: float) -> Dictionary:
    """Join the principal components of each sequence, as many as `wanted`, or of that share.

    Meshes are left out: bases are differences of shapes, not shapes.
    """
    sequences = np.array(training.original.sequences or ("",) * len(training))
    names = dict.fromkeys(sequences.tolist())
    aligned = training.alignment.shapes
    bases = np.concatenate([principal_components(aligned[sequences == s], wanted) for s in names])
    if not len(bases):
        problem = "the shapes of each sequence are all alike"
        raise input_error("shapes", problem, "give sequences that move")
    return replace(training.dictionary, atoms=bases)


def sparse_coding(training: TrainingShapes, config: LearnDictConfig) -> Learning:
    """Learn atoms by sparse coding; meshes are mixed as the shapes are, where these give atoms."""
    shapes, rounds = training.alignment.shapes, config.iterations
    k = number_of_atoms(len(shapes), config)
    for learned in learn(shapes, k, config.beta, iterations=rounds):
        note = f"objective {learned.trace[-1]:.6g}"
        yield Result(done=1, total=rounds, unit="round", note=note)
    atoms, C = learned.atoms, learned.coefficients
    error = np.linalg.norm(shapes - np.tensordot(C, atoms, axes=1)) / np.linalg.norm(shapes)
    meshes, warnings = None, list[str]()
    if training.mesh_vertices is not None:
        try:
            meshes = mesh_of_atoms(atoms, shapes, training.mesh_vertices)
        except ValueError as problem:
            warnings = [f"the meshes are left out: {problem}"]
    result = (
        f"learned {counted(k, 'atom')} from {counted(len(shapes), 'shape')} "
        f"(reconstruction error {error:.1%})"
    )
    yield Result(total=rounds, warnings=tuple(warnings), rows=(("Result", result),))
    return replace(
        training.dictionary,
        atoms=atoms,
        mesh_vertices=meshes,
        mesh_faces=None if meshes is None else training.original.mesh_faces,
        atom_scale=scale_of_atoms(atoms, C, training.scale),
        objective_trace=learned.trace,
    )


def learn_prior(training: TrainingShapes, config: LearnDictConfig) -> Mixture:
    """Learn the mixture over the aligned shapes, varied as the section `prior` says.

    Raises InputError for more components than shapes, and bones that are no tree where they are to
    vary.
    """
    prior, number = config.prior, len(training)
    components = number_of_components(number, prior)
    if components > number:
        problem = f"{components} components are more than the {number} shapes to learn from"
        raise input_error("prior.components", problem, "lower it, or give more shapes")
    shapes = training.alignment.shapes
    if prior.bone_scale or prior.exchange:
        shapes = vary_shapes(training, config)
    return learn_mixture(
        shapes,
        components,
        shrinkage=prior.shrinkage,
        floor=prior.floor,
        max_rounds=MOST_ROUNDS,
    ).mixture


def number_of_components(number: int, prior: PriorConfig) -> int:
    """Return the components of a mixture over so many shapes, by the section `prior`."""
    if prior.components != "auto":
        return prior.components
    return min(max(number // SHAPES_PER_COMPONENT, 1), MOST_COMPONENTS)


def vary_shapes(training: TrainingShapes, config: LearnDictConfig) -> Floats:
    """Return varied shapes (copies n, 3, p), normalised and turned onto the mean of all."""
    aligned, edges = training.alignment.shapes, training.original.edges
    points = aligned.shape[2]
    try:
        skeleton = find_skeleton(np.empty((0, 2), int) if edges is None else edges, points)
    except ValueError as error:
        fix = "give shapes whose `edges` are bones, or leave out `bone_scale` and `exchange`"
        raise input_error("prior", str(error), fix) from None
    varied = vary(
        aligned,
        skeleton,
        copies=min(max(FEWEST_COPIES, ENOUGH // len(aligned)), MOST_COPIES),
        bone_scale=config.prior.bone_scale,
        exchange=config.prior.exchange,
        partners=training.dictionary.mirror_index,
    )
    varied = normalise(varied).points
    if config.align == "none":
        return varied
    # Landmarks that are indexed lie in another order in memory, in which sums round differently.
    chosen = aligned_landmarks(training.original.landmark_names, config) or list(range(points))
    turn = rotation_onto(choose(varied, chosen), choose(training.alignment.mean, chosen))
    turned: Floats = turn @ varied
    return turned
