"""`learn-dict`: training shapes, normalised and aligned, to a dictionary file."""

from __future__ import annotations

import json
from collections.abc import Generator, Iterator, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from shapefit import __version__
from shapefit.config import LearnDictConfig
from shapefit.dictionary.atom_scale import scale_of_atoms
from shapefit.dictionary.coding import duality_gaps, objectives
from shapefit.dictionary.learning import Learned, learn
from shapefit.dictionary.model import Dictionary
from shapefit.dictionary.pca_bases import principal_components
from shapefit.dictionary.size import find_edge_length
from shapefit.errors import counted, input_error
from shapefit.geometry.normalisation import normalise
from shapefit.io import ShapeSet, check_output, digests, open_shapes, write_dictionary
from shapefit.meshes.dense import mesh_of_atoms
from shapefit.pipelines.learn_dict.prior import learn_prior
from shapefit.pipelines.learn_dict.training_shapes import TrainingShapes, find_training_shapes
from shapefit.pipelines.outcome import Outcome
from shapefit.pipelines.reading import input_options

Floats = NDArray[np.float64]


Making = Generator[Outcome, None, Dictionary]
"""Yields an outcome a round, and returns the dictionary; the last outcome sums up."""


def run(config: LearnDictConfig) -> Iterator[Outcome]:
    """Make the dictionary and write it; one outcome per round, sequence or set of exemplars.

    The first outcome lists the shapes that could not be used. Raises InputError for files that
    cannot be read or written, and as `make_dictionary` does.
    """
    check_output(config.output)
    given, notes = read_given(config)
    making = make_dictionary(given, config, digests(config.shapes))
    outcome = next(making)
    outcome = replace(outcome, warnings=notes + outcome.warnings)
    while True:
        try:
            following = next(making)
        except StopIteration as stop:
            dictionary = stop.value
            break
        yield outcome
        outcome = following
    write_dictionary(config.output, dictionary)
    yield replace(outcome, written=(config.output,))


def read_given(config: LearnDictConfig) -> tuple[ShapeSet, tuple[str, ...]]:
    """Read the shapes to learn from, and warnings of what was left out of their files."""
    with open_shapes(config.shapes, input_options(config.input)) as source:
        return source.whole(), source.notes


def make_dictionary(given: ShapeSet, config: LearnDictConfig, inputs: Mapping[str, str]) -> Making:
    """Make the dictionary of shapes; `inputs` are the digests of their files.

    It has the landmarks and edges of the shapes; atoms that are shapes or mixtures of shapes have
    meshes mixed alike. Raises InputError for what `find_training_shapes` refuses, and for bases of
    sequences that all stand still.
    """
    training = find_training_shapes(given, config)
    yield Outcome(
        failures=training.failures,
        warnings=training.warnings,
        note=counted(len(training), "shape"),
    )
    methods = {
        "sparse-coding": _sparse_coding,
        "exemplars": _exemplars,
        "pca-bases": _pca_bases,
    }
    made = yield from methods[config.method](config, training)
    prior = None
    if config.prior.components:
        prior, note = learn_prior(config, training)
        yield Outcome(note=note)
    provenance = {
        "method": config.method,
        "version": __version__,
        "config": config.as_json(),
        "inputs": json.dumps(inputs),
        **{key: text for key, text in config.origin if text is not None},
    }
    return replace(made, prior=prior, provenance=provenance)


def _exemplars(config: LearnDictConfig, training: TrainingShapes) -> Making:
    """Make every shape an atom."""
    atoms = training.alignment.shapes
    dictionary = replace(
        _dictionary(training, atoms),
        mesh_vertices=training.mesh_vertices,
        mesh_faces=training.original.mesh_faces,
        atom_scale=training.scale,
        atom_items=training.original.items,
    )
    yield Outcome(done=len(atoms), unit="shape", note=counted(len(atoms), "atom"))
    return dictionary


def _sparse_coding(config: LearnDictConfig, training: TrainingShapes) -> Making:
    """Learn by sparse coding, with the objective of each round in its note."""
    shapes = training.alignment.shapes
    rounds = learn(
        shapes,
        config.k,
        config.beta,
        iterations=config.iterations,
    )
    for learned in rounds:
        note = f"objective {learned.trace[-1]:.6g}"
        yield Outcome(done=1, total=config.iterations, unit="round", note=note)
    mesh_vertices = _mix_meshes(training, learned.atoms)
    dictionary = replace(
        _dictionary(training, learned.atoms),
        mesh_vertices=mesh_vertices,
        mesh_faces=None if mesh_vertices is None else training.original.mesh_faces,
        atom_scale=scale_of_atoms(learned.atoms, learned.coefficients, training.scale),
        objective_trace=learned.trace,
    )
    warnings = [*_dead_atoms(learned)]
    if training.mesh_vertices is not None and mesh_vertices is None:
        warnings.append("the meshes are left out: an atom is no combination of the training shapes")
    yield Outcome(
        total=config.iterations,
        warnings=tuple(warnings),
        note=(
            f"objective {learned.trace[-1]:.6g}, "
            f"relative error {learned.relative_error(shapes):.4f}, "
            f"{_largest_gap(learned, shapes, config.beta)}"
            f"{learned.active_atoms:.1f} active atoms per shape"
        ),
    )
    return dictionary


def _largest_gap(learned: Learned, shapes: Floats, beta: float) -> str:
    """Say how far the coding of any shape can be from its optimum; unknown where beta is 0."""
    if beta == 0:
        return ""
    gaps = duality_gaps(shapes, learned.atoms, beta, learned.coefficients)
    objective = objectives(shapes, learned.atoms, beta, learned.coefficients)
    relative = np.divide(gaps, objective, out=np.zeros_like(gaps), where=objective > 0)
    return f"relative gap of the coding at most {max(relative.max(), 0.0):.1g}, "


def _pca_bases(config: LearnDictConfig, training: TrainingShapes) -> Making:
    """Find the bases of each sequence, with their number in its note."""
    sequences = np.array(training.original.sequences or ("",) * len(training))
    names = dict.fromkeys(sequences.tolist())
    found = []
    for name in names:
        moving = training.alignment.shapes[sequences == name]
        found.append(principal_components(moving, config.bases))
        note = f"{len(found[-1])} bases" + (f" of {name}" if name else "")
        yield Outcome(done=1, total=len(names), unit="sequence", note=note)
    bases = np.concatenate(found)
    if not len(bases):
        problem = "the shapes of each sequence are all alike"
        raise input_error("shapes", problem, "give sequences that move")
    warnings: tuple[str, ...] = ()
    if training.mesh_vertices is not None:
        warnings = ("the meshes are left out: bases are differences of shapes, not shapes",)
    yield Outcome(total=len(names), warnings=warnings, note=f"{len(bases)} bases")
    return _dictionary(training, bases)


def _mix_meshes(training: TrainingShapes, atoms: Floats) -> Floats | None:
    """Mix the meshes as the shapes were mixed; None without meshes, or where that cannot be."""
    if training.mesh_vertices is None:
        return None
    try:
        return mesh_of_atoms(atoms, training.alignment.shapes, training.mesh_vertices)
    except ValueError:
        return None


def _dead_atoms(learned: Learned) -> Iterator[str]:
    if learned.dead_atoms:
        yield f"{learned.dead_atoms} of {len(learned.atoms)} atoms are used by no training shape"


def _dictionary(training: TrainingShapes, atoms: Floats) -> Dictionary:
    """Return what the dictionaries of all methods have."""
    edges = training.original.edges
    return Dictionary(
        atoms=atoms,
        landmark_names=training.original.landmark_names,
        mean_shape=normalise(training.alignment.mean).points,
        edges=edges,
        mirror_index=training.partners,
        unit=training.original.unit,
        acceleration=training.acceleration,
        edge_give=training.give,
        edge_length=None if edges is None else find_edge_length(training.original.shapes, edges),
        frame_rate=None if training.acceleration is None else training.original.frame_rate,
    )
