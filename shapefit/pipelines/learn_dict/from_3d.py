"""A dictionary of 3D shapes: aligned training shapes, atoms by one of three methods, a
prior.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Generator, Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from typing import Any, NamedTuple

import numpy as np

from shapefit import __version__
from shapefit.arrays import Floats, Integers
from shapefit.config import LearnDictConfig
from shapefit.config.commands.others import PriorConfig
from shapefit.dictionary.bodies import (
    find_acceleration,
    find_bone_tolerance,
    find_bone_tree,
    find_edge_covariance,
    find_lengths,
    vary,
)
from shapefit.dictionary.learning import (
    learn_atoms,
    principal_components,
    scale_of_atoms,
)
from shapefit.dictionary.mixture import Mixture, learn_mixture
from shapefit.dictionary.model import Dictionary
from shapefit.errors import counted, input_error
from shapefit.geometry.normalisation import MIN_EXTENT, normalise
from shapefit.geometry.procrustes import (
    Alignment,
    choose_landmarks,
    coincide,
    generalised_procrustes,
    lateral_axis,
    mirror,
    rotation_onto,
)
from shapefit.io import match_landmarks
from shapefit.meshes.dense import carry_mesh
from shapefit.pipelines.learn_dict.doubts import check_not_flat, warn_of_shapes
from shapefit.pipelines.result import Failure, Result
from shapefit.records import Shapes
from shapefit.records.columns import in_columns

Learning = Generator[Result, None, Dictionary]
"""Yields a result a round, and returns the dictionary; the last result sums up."""

MOST_ROUNDS = 20
"""Rounds of expectation maximisation, which ends sooner where it gains nothing."""

SHAPES_PER_COMPONENT, MOST_COMPONENTS = 150, 32
"""Of a mixture whose components are not given. A component of 45 coordinates needs a
hundred shapes and more beside what all shapes say.
"""

FEWEST_COPIES, MOST_COPIES, ENOUGH = 2, 100, 1500
"""Copies of each shape that is varied, and how many shapes are enough for a mixture."""


class TrainingShapes(NamedTuple):
    """n training shapes, normalised and aligned.

    original: as in the files, after `every` and `mirror`; alignment: of the normalised
    shapes (n, 3, p); scale (n,) that normalised them; mesh_vertices (n, 3, q), moved as
    their landmarks, or None; dictionary: all but its atoms and prior; failures: shapes
    that cannot be used.
    """

    original: Shapes
    alignment: Alignment
    scale: Floats
    mesh_vertices: Floats | None
    dictionary: Dictionary
    failures: tuple[Failure, ...]


def learn_from_shapes(
    given: Shapes, config: LearnDictConfig, inputs: Mapping[str, str]
) -> Learning:
    """Learn a dictionary from 3D shapes; `inputs` are the digests of their files.

    The first result lists the shapes that cannot be used. Raises InputError where the
    shapes do not serve what the config asks for.
    """
    check_not_flat(given, place_of(config) or "shapes")
    training = find_training_shapes(given, config)
    number = counted(len(training.original), "shape")
    doubts = warn_of_shapes(separate(given)[0])
    yield Result(failures=training.failures, warnings=doubts, note=number)
    if config.method == "sparse-coding":
        made = yield from sparse_coding(training, config)
    else:
        is_pca = config.method == "pca-bases"
        made = pca_bases(training) if is_pca else exemplars(training)
        yield Result(rows=(("Result", f"{counted(made.k, 'atom')} from {number}"),))
    prior = learn_prior(training, config) if config.prior.components else None
    provenance = {
        "method": config.method,
        "version": __version__,
        "config": config.as_json(),
        "inputs": json.dumps(inputs),
    }
    return replace(made, prior=prior, provenance=provenance)


def find_training_shapes(given: Shapes, config: LearnDictConfig) -> TrainingShapes:
    """Take every n-th shape of each sequence, double them by mirroring, normalise, and
    align.

    The motion and the rigidity of edges are those of all the shapes given. Raises
    InputError for wrong pairs in `mirror`, no shapes, and fewer shapes than atoms.
    """
    usable, failures = separate(given)
    shapes = usable.take(
        every_nth(usable.sequences or ("",) * len(usable), config.every)
    )
    partners = find_partners(shapes, config) if config.mirror else None
    if partners is not None and len(shapes):
        points = shapes.as_columns()
        mirrored = mirror(points, partners, lateral_axis(points, partners))
        both = np.concatenate([points, mirrored])
        twice = shapes.take(np.tile(np.arange(len(shapes)), 2))
        shapes = replace(
            twice, shapes=both.swapaxes(1, 2), mesh_vertices=None, mesh_faces=None
        )
    n = len(shapes)
    if not n:
        example = (
            f"; {failures[0].item}, for one: {failures[0].reason}" if failures else ""
        )
        fault = f"there are 0 shapes to learn from{example}"
        raise input_error("shapes", fault, "give more shapes")
    if number_of_atoms(n, config) > n:
        fault = (
            f"{config.k} atoms are more than the {counted(n, 'shape')} to learn from"
        )
        raise input_error("k", fault, "lower k or `every`, or give more shapes")
    normalised = normalise(shapes.as_columns())
    points = normalised.points
    if config.align == "none":
        unturned = np.tile(np.eye(3), (n, 1, 1))
        alignment = Alignment(
            points, points.mean(axis=0), unturned, rounds=0, converged=True
        )
    else:
        alignment = generalised_procrustes(points)
    dictionary = Dictionary(
        atoms=np.empty((0, *alignment.mean.shape)),
        landmark_names=tuple(shapes.landmark_names),
        mean_shape=normalise(alignment.mean).points,
        edges=shapes.edges,
        mirror_index=partners,
        unit=shapes.unit,
        **find_motion(usable, shapes),
    )
    carried = None
    if shapes.mesh_vertices is not None:
        vertices = in_columns(shapes.mesh_vertices)
        carried = carry_mesh(vertices, normalised, alignment.rotations)
    return TrainingShapes(
        shapes, alignment, normalised.scale, carried, dictionary, failures
    )


def separate(shapes: Shapes) -> tuple[Shapes, tuple[Failure, ...]]:
    """Return the shapes that can be normalised, and the others as failures."""
    points = shapes.as_columns()
    extent = np.ptp(points, axis=-1).max(axis=-1, initial=0.0)
    usable = ~coincide(points) & np.isfinite(extent) & (extent >= MIN_EXTENT)
    reason = "all its landmarks are at one point, or not finite"
    items = (shapes.items[row] for row in np.flatnonzero(~usable).tolist())
    return shapes.take(usable), tuple(Failure(item, reason) for item in items)


def every_nth(sequences: Sequence[str], n: int | Mapping[str, int]) -> list[int]:
    """Return the indices of every n-th item of each sequence, starting with its first.

    In a mapping the first glob that fits the name of a sequence gives its n; 1 where
    none does.
    """
    globs = {"*": n} if isinstance(n, int) else n
    steps = {
        name: next((step for glob, step in globs.items() if fnmatchcase(name, glob)), 1)
        for name in set(sequences)
    }
    counts: Counter[str] = Counter()
    retained = []
    for index, sequence in enumerate(sequences):
        if counts[sequence] % steps[sequence] == 0:
            retained.append(index)
        counts[sequence] += 1
    return retained


def find_partners(shapes: Shapes, config: LearnDictConfig) -> Integers:
    """Return the partner (p,) of each landmark on the other side, by `mirror` or the
    file.

    Raises InputError where neither pairs the landmarks.
    """
    names, points = shapes.landmark_names, np.arange(len(shapes.landmark_names))
    if isinstance(config.mirror, dict):
        partners = points.copy()
        for pair in config.mirror.items():
            first, second = match_landmarks(names, pair, place="mirror")
            partners[[first, second]] = second, first
    else:
        partners = points if shapes.mirror_index is None else shapes.mirror_index
    moved = np.isin(partners, points).all() and (partners != points).any()
    if not moved or (partners[partners] != points).any():
        fault = (
            "`mirror`, or the dataset `mirror_index` of the shapes, does not pair"
            " landmarks"
        )
        fix = "name each landmark of a pair once, `mirror: {rhip: lhip}`"
        raise input_error(place_of(config), fault, fix)
    return partners


def number_of_atoms(number: int, config: LearnDictConfig) -> int:
    """Return the atoms to learn from so many shapes: fewer than the default where these
    are few.
    """
    if config.method != "sparse-coding":
        return 1
    return config.k if "k" in config.model_fields_set else min(config.k, number)


def find_motion(given: Shapes, shapes: Shapes) -> dict[str, Any]:
    """Return what a dictionary knows of motion and bones, by the names of its fields.

    Motion and differences between bodies are those of all shapes given, lengths those
    of `shapes`.
    """
    motion: dict[str, Any] = {}
    edges, sequences = given.edges, given.sequences
    if sequences:
        motion["acceleration"] = find_acceleration(
            given.as_columns(), sequences, given.frames, given.frame_rate
        )
        motion["frame_rate"] = (
            None if motion["acceleration"] is None else given.frame_rate
        )
    if edges is None:
        return motion
    motion["edge_length"] = find_lengths(
        shapes.as_columns(), edges, ("",) * len(shapes)
    )[0].mean(axis=0)
    of = sequences or ("",) * len(given)
    motion["bone_tolerance"] = find_bone_tolerance(given.as_columns(), edges, of)
    if len(edges):
        lengths, bodies, _ = find_lengths(given.as_columns(), edges, of)
        motion["edge_covariance"] = find_edge_covariance(
            bodies, None if sequences else lengths
        )
    return motion


def place_of(config: LearnDictConfig) -> str:
    """Return the files of shapes or landmarks, as messages name them."""
    return ", ".join(map(str, config.shapes))


def exemplars(training: TrainingShapes) -> Dictionary:
    """Make every training shape an atom, with its mesh."""
    return replace(
        training.dictionary,
        atoms=training.alignment.shapes,
        mesh_vertices=training.mesh_vertices,
        mesh_faces=training.original.mesh_faces,
        atom_scale=training.scale,
        atom_items=tuple(training.original.items),
    )


def pca_bases(training: TrainingShapes) -> Dictionary:
    """Join the principal components of each sequence that explain its variance.

    Meshes are left out: bases are differences of shapes, not shapes.
    """
    aligned = training.alignment.shapes
    sequences = np.array(training.original.sequences or ("",) * len(aligned))
    names = dict.fromkeys(sequences.tolist())
    bases = np.concatenate(
        [principal_components(aligned[sequences == s]) for s in names]
    )
    if not len(bases):
        fault = "the shapes of each sequence are all alike"
        raise input_error("shapes", fault, "give sequences that move")
    return replace(training.dictionary, atoms=bases)


def sparse_coding(training: TrainingShapes, config: LearnDictConfig) -> Learning:
    """Learn atoms by sparse coding, without meshes."""
    shapes, rounds = training.alignment.shapes, config.iterations
    k = number_of_atoms(len(shapes), config)
    for learned in learn_atoms(shapes, k, config.beta, iterations=rounds):
        note = f"objective {learned.trace[-1]:.6g}"
        yield Result(done=1, total=rounds, unit="round", note=note)
    atoms, C = learned.atoms, learned.coefficients
    error = np.linalg.norm(shapes - np.tensordot(C, atoms, axes=1)) / np.linalg.norm(
        shapes
    )
    learned_from = f"learned {counted(k, 'atom')} from {counted(len(shapes), 'shape')}"
    result = f"{learned_from} (reconstruction error {error:.1%})"
    yield Result(total=rounds, rows=(("Result", result),))
    return replace(
        training.dictionary,
        atoms=atoms,
        atom_scale=scale_of_atoms(atoms, C, training.scale),
        objective_trace=learned.trace,
    )


def learn_prior(training: TrainingShapes, config: LearnDictConfig) -> Mixture:
    """Learn the mixture over the aligned shapes, varied as the section `prior` says.

    Raises InputError for more components than shapes, and bones that are no tree where
    they are to vary.
    """
    prior, shapes = config.prior, training.alignment.shapes
    components = number_of_components(len(shapes), prior)
    if components > len(shapes):
        fault = (
            f"{components} components are more than the {len(shapes)} shapes to learn"
            " from"
        )
        raise input_error("prior.components", fault, "lower it, or give more shapes")
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
    """Return the components of a mixture over so many shapes, by the section
    `prior`.
    """
    if prior.components != "auto":
        return prior.components
    return min(max(number // SHAPES_PER_COMPONENT, 1), MOST_COMPONENTS)


def vary_shapes(training: TrainingShapes, config: LearnDictConfig) -> Floats:
    """Return varied shapes (copies n, 3, p), normalised and turned onto the mean of
    all.
    """
    aligned, edges = training.alignment.shapes, training.original.edges
    points = aligned.shape[2]
    try:
        skeleton = find_bone_tree(
            np.empty((0, 2), int) if edges is None else edges, points
        )
    except ValueError as fault:
        fix = (
            "give shapes whose `edges` are bones, or leave out `bone_scale` and"
            " `exchange`"
        )
        raise input_error("prior", str(fault), fix) from None
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
    # Landmarks that are indexed lie in another order in memory, in which sums round
    # differently.
    everything = range(points)
    turn = rotation_onto(
        choose_landmarks(varied, everything),
        choose_landmarks(training.alignment.mean, everything),
    )
    turned: Floats = turn @ varied
    return turned
