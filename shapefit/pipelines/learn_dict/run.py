"""`learn-dict`: training shapes, normalised and aligned, to a dictionary file."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from shapefit import __version__
from shapefit.config import LearnDictConfig
from shapefit.dictionary.atom_scale import scale_of_atoms
from shapefit.dictionary.learning import Learned, learn
from shapefit.dictionary.mixture import Mixture
from shapefit.dictionary.model import Dictionary
from shapefit.dictionary.pca_bases import principal_components
from shapefit.errors import counted, input_error
from shapefit.geometry.normalisation import normalise
from shapefit.io import check_output, digests, write_dictionary
from shapefit.meshes.dense import mesh_of_atoms
from shapefit.pipelines.learn_dict.prior import learn_prior
from shapefit.pipelines.learn_dict.training_shapes import TrainingShapes, find_training_shapes
from shapefit.pipelines.outcome import Outcome

Floats = NDArray[np.float64]


def run(config: LearnDictConfig) -> Iterator[Outcome]:
    """Make the dictionary and write it; one outcome a round (`pca-bases`: a sequence).

    The first outcome lists the shapes that could not be used. The dictionary has the landmarks
    and edges of the shapes; atoms that are shapes or mixtures of shapes have meshes mixed alike.
    Raises InputError for files that cannot be read or written, for what `find_training_shapes`
    refuses, and for bases of sequences that all stand still.
    """
    check_output(config.output)
    training = find_training_shapes(config)
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
    prior = None
    if config.prior.components:
        prior, note = learn_prior(config, training)
        yield Outcome(note=note)
    yield from methods[config.method](config, training, prior)


def _exemplars(
    config: LearnDictConfig, training: TrainingShapes, prior: Mixture | None
) -> Iterator[Outcome]:
    """Make every shape an atom."""
    atoms = training.alignment.shapes
    dictionary = replace(
        _dictionary(config, training, atoms, prior),
        mesh_vertices=training.mesh_vertices,
        mesh_faces=training.original.mesh_faces,
        atom_scale=training.scale,
        atom_items=training.original.items,
    )
    write_dictionary(config.output, dictionary)
    yield Outcome(note=counted(len(atoms), "atom"), written=(config.output,))


def _sparse_coding(
    config: LearnDictConfig, training: TrainingShapes, prior: Mixture | None
) -> Iterator[Outcome]:
    """Learn by sparse coding, with the objective of each round in its note."""
    shapes = training.alignment.shapes
    rounds = learn(
        shapes,
        config.k,
        config.beta,
        iterations=config.iterations,
        tolerance=config.tolerance,
        atom_bound=config.atom_bound,
    )
    for learned in rounds:
        note = f"objective {learned.trace[-1]:.6g}"
        yield Outcome(done=1, total=config.iterations, note=note)
    mesh_vertices = _mix_meshes(training, learned.atoms)
    dictionary = replace(
        _dictionary(config, training, learned.atoms, prior),
        mesh_vertices=mesh_vertices,
        mesh_faces=None if mesh_vertices is None else training.original.mesh_faces,
        atom_scale=scale_of_atoms(learned.atoms, learned.coefficients, training.scale),
        objective_trace=learned.trace,
    )
    write_dictionary(config.output, dictionary)
    warnings = [*_dead_atoms(learned)]
    if training.mesh_vertices is not None and mesh_vertices is None:
        warnings.append("the meshes are left out: an atom is no mixture of the training shapes")
    yield Outcome(
        total=config.iterations,
        warnings=tuple(warnings),
        note=(
            f"objective {learned.trace[-1]:.6g}, "
            f"relative error {learned.relative_error(shapes):.4f}, "
            f"{learned.active_atoms:.1f} active atoms per shape"
        ),
        written=(config.output,),
    )


def _pca_bases(
    config: LearnDictConfig, training: TrainingShapes, prior: Mixture | None
) -> Iterator[Outcome]:
    """Find the bases of each sequence, with their number in its note."""
    sequences = np.array(training.original.sequences or ("",) * len(training))
    names = dict.fromkeys(sequences.tolist())
    found = []
    for name in names:
        moving = training.alignment.shapes[sequences == name]
        found.append(principal_components(moving, config.energy, config.components))
        note = f"{len(found[-1])} bases" + (f" of {name}" if name else "")
        yield Outcome(done=1, total=len(names), note=note)
    bases = np.concatenate(found)
    if not len(bases):
        problem = "the shapes of each sequence are all alike"
        raise input_error("shapes", problem, "give sequences that move")
    write_dictionary(config.output, _dictionary(config, training, bases, prior))
    warnings: tuple[str, ...] = ()
    if training.mesh_vertices is not None:
        warnings = ("the meshes are left out: bases are differences of shapes, not shapes",)
    yield Outcome(
        total=len(names), warnings=warnings, note=f"{len(bases)} bases", written=(config.output,)
    )


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


def _dictionary(
    config: LearnDictConfig, training: TrainingShapes, atoms: Floats, prior: Mixture | None
) -> Dictionary:
    """Return what the dictionaries of all methods have."""
    return Dictionary(
        atoms=atoms,
        landmark_names=training.original.landmark_names,
        mean_shape=normalise(training.alignment.mean).points,
        edges=training.original.edges,
        unit=training.original.unit,
        prior=prior,
        acceleration=training.acceleration,
        edge_give=training.give,
        frame_rate=None if training.acceleration is None else training.original.frame_rate,
        provenance={
            "method": config.method,
            "version": __version__,
            "config": config.as_json(),
            "inputs": json.dumps(digests(config.shapes)),
        },
    )
