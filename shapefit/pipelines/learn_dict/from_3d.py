"""A dictionary of 3D shapes: aligned, with atoms by one of three methods, a prior."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Generator, Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from typing import NamedTuple

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
from shapefit.dictionary.mixture import Mixture, mixture_rounds
from shapefit.dictionary.model import Dictionary
from shapefit.errors import counted, input_error
from shapefit.geometry.normalisation import MIN_EXTENT, normalise
from shapefit.geometry.procrustes import (
    Alignment,
    are_coincident,
    choose_landmarks,
    generalised_procrustes,
    lateral_axis,
    mirror,
    rotation_onto,
)
from shapefit.io import match_landmarks
from shapefit.meshes.dense import transform_mesh
from shapefit.pipelines.learn_dict.doubts import check_not_flat, warn_of_shapes
from shapefit.pipelines.result import Failure, Result
from shapefit.records import Shapes
from shapefit.records.columns import in_columns

Learning = Generator[Result, None, Dictionary]
"""Yields a result a round, and returns the dictionary; the last result sums up."""

MAX_MIXTURE_ROUNDS = 20
"""Rounds of expectation maximisation, which ends sooner where it gains nothing."""

SHAPES_PER_COMPONENT = 150
"""Of a mixture whose components are not given: a component of 45 coordinates needs a
hundred shapes and more beside what all shapes say.
"""

MAX_COMPONENTS = 32
"""Of a mixture whose components are not given."""

MIN_COPIES = 2
"""Of each shape that is varied."""

MAX_COPIES = 100
"""Of each shape that is varied."""

TARGET_SHAPES = 1500
"""Shapes that a mixture is learned from where copies are made, copies among them."""


class TrainingShapes(NamedTuple):
    """n training shapes, normalised and aligned.

    original: as in the files, after `every` and `mirror`; alignment: of the normalised
    shapes (n, 3, p); scale (n,) that normalised them; origin (n, 3) of their frame,
    and mesh_vertices (n, 3, q) or None, moved as their landmarks; dictionary: all but
    its atoms and prior; failures: shapes that cannot be used.
    """

    original: Shapes
    alignment: Alignment
    scale: Floats
    origin: Floats
    mesh_vertices: Floats | None
    dictionary: Dictionary
    failures: tuple[Failure, ...]


def learn_from_shapes(
    shapes: Shapes, config: LearnDictConfig, inputs: Mapping[str, str]
) -> Learning:
    """Learn a dictionary from 3D shapes; `inputs` are the digests of their files.

    The first result lists the shapes that cannot be used. Raises InputError where the
    shapes do not serve what the config asks for.
    """
    check_not_flat(shapes, place_of(config) or "shapes")
    training = prepare_training_shapes(shapes, config)
    number = counted(len(training.original), "shape")
    doubts = warn_of_shapes(split_usable(shapes)[0])
    yield Result(failures=training.failures, warnings=doubts, note=number)
    if config.method == "sparse-coding":
        made = yield from learn_by_sparse_coding(training, config)
    else:
        is_pca = config.method == "pca-bases"
        made = pca_dictionary(training) if is_pca else exemplar_dictionary(training)
        yield Result(rows=(("Result", f"{counted(made.k, 'atom')} from {number}"),))
    prior = None
    if config.prior.components:
        prior = yield from learn_prior(training, config)
    provenance = {
        "method": config.method,
        "version": __version__,
        "config": config.as_json(),
        "inputs": json.dumps(inputs),
    }
    return replace(made, prior=prior, provenance=provenance)


def prepare_training_shapes(
    all_shapes: Shapes, config: LearnDictConfig
) -> TrainingShapes:
    """Take every n-th shape of each sequence, mirror them too, normalise, and align.

    The motion and the rigidity of edges are those of `all_shapes`. Raises
    InputError for wrong pairs in `mirror`, no shapes, and fewer shapes than atoms.
    """
    usable, failures = split_usable(all_shapes)
    sequences = usable.sequences or ("",) * len(usable)
    shapes = usable.take(every_nth(sequences, config.every))
    partners = find_partners(shapes, config) if config.mirror else None
    if partners is not None and len(shapes):
        shapes = add_mirror_images(shapes, partners)
    check_enough_shapes(shapes, failures, config)
    normalised = normalise(shapes.as_columns())
    if config.align == "none":
        alignment = identity_alignment(normalised.points)
    else:
        alignment = generalised_procrustes(normalised.points)
    mesh = None
    if shapes.mesh_vertices is not None:
        vertices = in_columns(shapes.mesh_vertices)
        mesh = transform_mesh(vertices, normalised, alignment.rotations)
    zero = np.zeros((len(shapes), 3, 1))
    origin = transform_mesh(zero, normalised, alignment.rotations)[..., 0]
    dictionary = Dictionary(
        atoms=np.empty((0, *alignment.mean.shape)),
        landmark_names=tuple(shapes.landmark_names),
        mean_shape=normalise(alignment.mean).points,
        edges=shapes.edges,
        mirror_index=partners,
        unit=shapes.unit,
    )
    return TrainingShapes(
        original=shapes,
        alignment=alignment,
        scale=normalised.scale,
        origin=origin,
        mesh_vertices=mesh,
        dictionary=with_motion_and_lengths(dictionary, usable, shapes),
        failures=failures,
    )


def add_mirror_images(shapes: Shapes, partners: Integers) -> Shapes:
    """Return the shapes and, after them, their mirror images, without meshes."""
    points = shapes.as_columns()
    mirrored = mirror(points, partners, lateral_axis(points, partners))
    both = np.concatenate([points, mirrored]).swapaxes(1, 2)
    twice = shapes.take(np.tile(np.arange(len(shapes)), 2))
    return replace(twice, shapes=both, mesh_vertices=None, mesh_faces=None)


def check_enough_shapes(
    shapes: Shapes, failures: tuple[Failure, ...], config: LearnDictConfig
) -> None:
    """Raise InputError where there are no shapes, or fewer than atoms."""
    n = len(shapes)
    if not n:
        fault = "there are 0 shapes to learn from"
        if failures:
            fault += f"; {failures[0].item}, for one: {failures[0].reason}"
        raise input_error("shapes", fault, "give more shapes")
    if number_of_atoms(n, config) > n:
        fault = (
            f"{config.k} atoms are more than the {counted(n, 'shape')} to learn from"
        )
        raise input_error("k", fault, "lower k or `every`, or give more shapes")


def identity_alignment(points: Floats) -> Alignment:
    """Return the alignment that leaves shapes (n, 3, p) as they are."""
    unturned = np.tile(np.eye(3), (len(points), 1, 1))
    return Alignment(points, points.mean(axis=0), unturned, rounds=0, converged=True)


def split_usable(shapes: Shapes) -> tuple[Shapes, tuple[Failure, ...]]:
    """Return the shapes that are finite and have an extent, and others as failures."""
    points = shapes.as_columns()
    extent = np.ptp(points, axis=-1).max(axis=-1, initial=0.0)
    has_extent = np.isfinite(extent) & (extent >= MIN_EXTENT)
    usable = ~are_coincident(points) & has_extent
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
    """Return the index (p,) of each landmark's partner on the other side of the body.

    It is that of `mirror`, else of the file. Raises InputError where neither pairs the
    landmarks.
    """
    names = shapes.landmark_names
    points = np.arange(len(names))
    if isinstance(config.mirror, dict):
        partners = points.copy()
        for pair in config.mirror.items():
            first, second = match_landmarks(names, pair, place="mirror")
            partners[[first, second]] = second, first
    else:
        partners = points if shapes.mirror_index is None else shapes.mirror_index
    are_landmarks = np.isin(partners, points).all()
    are_paired = are_landmarks and (partners[partners] == points).all()
    if not are_paired or (partners == points).all():
        fault = (
            "`mirror`, or the dataset `mirror_index` of the shapes, does not pair"
            " landmarks"
        )
        fix = "name each landmark of a pair once, `mirror: {rhip: lhip}`"
        raise input_error(place_of(config), fault, fix)
    return partners


def number_of_atoms(number: int, config: LearnDictConfig) -> int:
    """Return how many atoms to learn from `number` shapes, 1 without sparse coding.

    By default it is at most the number of shapes.
    """
    if config.method != "sparse-coding":
        return 1
    return config.k if "k" in config.model_fields_set else min(config.k, number)


def with_motion_and_lengths(
    dictionary: Dictionary, all_shapes: Shapes, shapes: Shapes
) -> Dictionary:
    """Return the dictionary with accelerations, and with lengths of bones.

    Motion and differences between bodies are those of `all_shapes`, lengths those of
    the `shapes` that are learned from.
    """
    points = all_shapes.as_columns()
    if all_shapes.sequences:
        acceleration = find_acceleration(
            points, all_shapes.sequences, all_shapes.frames, all_shapes.frame_rate
        )
        if acceleration is not None:
            dictionary = replace(
                dictionary, acceleration=acceleration, frame_rate=all_shapes.frame_rate
            )
    edges = all_shapes.edges
    if edges is None:
        return dictionary
    in_one = ("",) * len(shapes)
    lengths, _, _ = find_lengths(shapes.as_columns(), edges, in_one)
    sequences = all_shapes.sequences or ("",) * len(all_shapes)
    dictionary = replace(
        dictionary,
        edge_length=lengths.mean(axis=0),
        bone_tolerance=find_bone_tolerance(points, edges, sequences),
    )
    if not len(edges):
        return dictionary
    lengths, of_sequences, _ = find_lengths(points, edges, sequences)
    covariance = find_edge_covariance(
        of_sequences, None if all_shapes.sequences else lengths
    )
    return replace(dictionary, edge_covariance=covariance)


def place_of(config: LearnDictConfig) -> str:
    """Return the files of shapes or landmarks, as messages name them."""
    return ", ".join(map(str, config.shapes))


def exemplar_dictionary(training: TrainingShapes) -> Dictionary:
    """Return a dictionary whose atoms are the training shapes, with their meshes."""
    return replace(
        training.dictionary,
        atoms=training.alignment.shapes,
        mesh_vertices=training.mesh_vertices,
        mesh_faces=training.original.mesh_faces,
        atom_scale=training.scale,
        atom_origin=None if training.mesh_vertices is None else training.origin,
        atom_items=tuple(training.original.items),
    )


def pca_dictionary(training: TrainingShapes) -> Dictionary:
    """Return a dictionary whose atoms are principal components of each sequence.

    Meshes are left out: bases are differences of shapes, not shapes. Raises InputError
    where the shapes of each sequence are all alike.
    """
    aligned = training.alignment.shapes
    sequences = np.array(training.original.sequences or ("",) * len(aligned))
    names = dict.fromkeys(sequences.tolist())
    of_sequences = [principal_components(aligned[sequences == name]) for name in names]
    bases = np.concatenate(of_sequences)
    if not len(bases):
        fault = "the shapes of each sequence are all alike"
        raise input_error("shapes", fault, "give sequences that move")
    return replace(training.dictionary, atoms=bases)


def learn_by_sparse_coding(
    training: TrainingShapes, config: LearnDictConfig
) -> Learning:
    """Learn a dictionary of aligned shapes by sparse coding, without meshes."""
    shapes = training.alignment.shapes
    rounds = config.iterations
    total = rounds + (MAX_MIXTURE_ROUNDS if config.prior.components else 0)
    k = number_of_atoms(len(shapes), config)
    for learned in learn_atoms(shapes, k, config.beta, iterations=rounds):
        note = f"objective {learned.trace[-1]:.6g}"
        yield Result(done=1, total=total, unit="round", note=note)
    atoms = learned.atoms
    C = learned.coefficients
    left = np.linalg.norm(shapes - np.tensordot(C, atoms, axes=1))
    error = left / np.linalg.norm(shapes)
    learned_from = f"learned {counted(k, 'atom')} from {counted(len(shapes), 'shape')}"
    result = f"{learned_from} (reconstruction error {error:.1%})"
    yield Result(total=total, rows=(("Result", result),))
    return replace(
        training.dictionary,
        atoms=atoms,
        atom_scale=scale_of_atoms(atoms, C, training.scale),
        objective_trace=learned.trace,
    )


def learn_prior(
    training: TrainingShapes, config: LearnDictConfig
) -> Generator[Result, None, Mixture]:
    """Learn the prior, a mixture over the aligned shapes or over varied copies of them.

    They are varied where the section `prior` asks for it. Yields a result a round.
    Raises InputError for more components than shapes, and where bones are to vary that
    are no tree.
    """
    prior = config.prior
    shapes = training.alignment.shapes
    components = number_of_components(len(shapes), prior)
    if components > len(shapes):
        fault = (
            f"{components} components are more than the {len(shapes)} shapes to learn"
            " from"
        )
        raise input_error("prior.components", fault, "lower it, or give more shapes")
    if prior.bone_scale or prior.exchange:
        shapes = vary_shapes(training, config)
    rounds = mixture_rounds(
        shapes,
        components,
        shrinkage=prior.shrinkage,
        variance_floor=prior.floor,
        max_rounds=MAX_MIXTURE_ROUNDS,
    )
    for number, learned in enumerate(rounds, start=1):
        note = f"prior of {counted(components, 'component')}, round {number}"
        yield Result(done=1, unit="round", note=note)
        mixture = learned.mixture
    return mixture


def number_of_components(number: int, prior: PriorConfig) -> int:
    """Return how many components a mixture over `number` shapes has, by `prior`."""
    if prior.components != "auto":
        return prior.components
    return min(max(number // SHAPES_PER_COMPONENT, 1), MAX_COMPONENTS)


def vary_shapes(training: TrainingShapes, config: LearnDictConfig) -> Floats:
    """Return varied copies (copies n, 3, p) of the n aligned shapes, aligned again.

    They are normalised, and turned onto the mean unless `align` is `none`. Raises
    InputError where `edges` are no tree of bones.
    """
    aligned = training.alignment.shapes
    points = aligned.shape[2]
    edges = training.original.edges
    if edges is None:
        edges = np.empty((0, 2), int)
    try:
        tree = find_bone_tree(edges, points)
    except ValueError as fault:
        fix = (
            "give shapes whose `edges` are bones, or leave out `bone_scale` and"
            " `exchange`"
        )
        raise input_error("prior", str(fault), fix) from None
    varied = vary(
        aligned,
        tree,
        copies=min(max(MIN_COPIES, TARGET_SHAPES // len(aligned)), MAX_COPIES),
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
