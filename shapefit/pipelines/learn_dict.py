"""`learn-dict`: training shapes, normalised and aligned, to a dictionary file."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from shapefit import __version__
from shapefit.config import LearnDictConfig
from shapefit.dictionary.learning import Learned, learn
from shapefit.dictionary.model import Dictionary
from shapefit.dictionary.pca_bases import principal_components
from shapefit.errors import input_error
from shapefit.geometry.normalisation import normalise
from shapefit.geometry.procrustes import Alignment, coincide, generalised_procrustes
from shapefit.io import (
    ShapeSet,
    check_output,
    digest,
    match_landmarks,
    read_shapes,
    write_dictionary,
)
from shapefit.pipelines.outcome import Failure, Outcome

Floats = NDArray[np.float64]


def run(config: LearnDictConfig) -> Iterator[Outcome]:
    """Learn the dictionary and write it; one outcome a round (`pca-bases`: a sequence).

    Every n-th shape of each sequence is normalised, turned onto the mean of all (generalised
    Procrustes) and given to the method. Shapes that cannot be normalised are failures and left
    out; the first outcome lists them. The dictionary has the landmarks and edges of the shapes;
    meshes are left out, for an atom is no longer one of the shapes. Raises InputError for files
    that cannot be read or written, unknown landmarks in `align`, k above the number of shapes, and
    bases of sequences that all stand still.
    """
    check_output(config.output)
    shapes, failures = _training_shapes(config)
    alignment = _align(shapes, config)
    yield Outcome(
        failures=failures,
        warnings=tuple(_alignment_warnings(shapes, alignment)),
        note=f"{len(shapes)} shapes",
    )
    method = _pca_bases if config.method == "pca-bases" else _sparse_coding
    yield from method(config, shapes, alignment)


def _sparse_coding(
    config: LearnDictConfig, shapes: ShapeSet, alignment: Alignment
) -> Iterator[Outcome]:
    """Learn by sparse coding, with the objective of each round in its note."""
    rounds = learn(
        alignment.shapes,
        config.k,
        config.beta,
        iterations=config.iterations,
        tolerance=config.tolerance,
        atom_bound=config.atom_bound,
    )
    for learned in rounds:
        note = f"objective {learned.trace[-1]:.6g}"
        yield Outcome(done=1, total=config.iterations, note=note)
    dictionary = _dictionary(config, shapes, alignment, learned.atoms)
    write_dictionary(config.output, replace(dictionary, objective_trace=learned.trace))
    yield Outcome(
        total=config.iterations,
        warnings=tuple(_dead_atoms(learned)),
        note=(
            f"objective {learned.trace[-1]:.6g}, "
            f"relative error {learned.relative_error(alignment.shapes):.4f}, "
            f"{learned.active_atoms:.1f} active atoms a shape"
        ),
        written=(config.output,),
    )


def _pca_bases(
    config: LearnDictConfig, shapes: ShapeSet, alignment: Alignment
) -> Iterator[Outcome]:
    """Find the bases of each sequence, with their number in its note."""
    sequences = np.array(shapes.sequences or ("",) * len(shapes))
    names = dict.fromkeys(sequences.tolist())
    found = []
    for name in names:
        moving = alignment.shapes[sequences == name]
        found.append(principal_components(moving, config.energy, config.components))
        note = f"{len(found[-1])} bases" + (f" of {name}" if name else "")
        yield Outcome(done=1, total=len(names), note=note)
    bases = np.concatenate(found)
    if not len(bases):
        problem = "the shapes of each sequence are all alike"
        raise input_error("shapes", problem, "give sequences that move")
    write_dictionary(config.output, _dictionary(config, shapes, alignment, bases))
    yield Outcome(total=len(names), note=f"{len(bases)} bases", written=(config.output,))


def every_nth(sequences: tuple[str, ...], n: int) -> list[int]:
    """Return the indices of every n-th item of each sequence, its first one included."""
    seen: Counter[str] = Counter()
    kept = []
    for index, sequence in enumerate(sequences):
        if seen[sequence] % n == 0:
            kept.append(index)
        seen[sequence] += 1
    return kept


def _training_shapes(config: LearnDictConfig) -> tuple[ShapeSet, tuple[Failure, ...]]:
    """Read the shapes; return those to learn from and those that should have been among them."""
    shapes = read_shapes(config.shapes)
    sequences = shapes.sequences or ("",) * len(shapes)
    shapes = shapes.take(every_nth(sequences, config.every))
    finite = np.all(np.isfinite(shapes.shapes), axis=(-2, -1))
    usable = finite & ~coincide(shapes.shapes)
    failures = tuple(
        Failure(
            shapes.items[i],
            "all its landmarks lie on one point" if finite[i] else "a coordinate is not finite",
        )
        for i in np.flatnonzero(~usable)
    )
    shapes = shapes.take(usable)
    if not len(shapes):
        raise input_error("shapes", "there are 0 shapes to learn from", "give more shapes")
    if config.method == "sparse-coding" and config.k > len(shapes):
        found = f"{config.k} atoms are more than the {len(shapes)} shapes to learn from"
        raise input_error("k", found, "lower k or `every`, or give more shapes")
    return shapes, failures


def _align(shapes: ShapeSet, config: LearnDictConfig) -> Alignment:
    landmarks = None
    if config.align != "all":
        landmarks = match_landmarks(shapes.landmark_names, config.align, place="align").tolist()
    return generalised_procrustes(normalise(shapes.shapes).points, landmarks)


def _alignment_warnings(shapes: ShapeSet, alignment: Alignment) -> Iterator[str]:
    if not alignment.still:
        yield f"the mean of the aligned shapes still moved after {alignment.rounds} rounds"
    if shapes.mesh_vertices is not None:
        yield "the meshes of the training shapes are left out: learned atoms have landmarks only"


def _dead_atoms(learned: Learned) -> Iterator[str]:
    if learned.dead_atoms:
        yield f"{learned.dead_atoms} of {len(learned.atoms)} atoms are used by no training shape"


def _dictionary(
    config: LearnDictConfig, shapes: ShapeSet, alignment: Alignment, atoms: Floats
) -> Dictionary:
    return Dictionary(
        atoms=atoms,
        landmark_names=shapes.landmark_names,
        mean_shape=normalise(alignment.mean).points,
        edges=shapes.edges,
        provenance={
            "method": config.method,
            "version": __version__,
            "config": config.as_json(),
            "inputs": json.dumps({str(path): digest(path) for path in config.shapes}),
        },
    )
