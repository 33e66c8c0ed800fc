"""`learn-dict`: training shapes, normalised and aligned, to a dictionary file."""

from __future__ import annotations

import json
from collections.abc import Generator, Iterator, Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from shapefit import __version__
from shapefit.arrays import Floats
from shapefit.config import FitConfig, LearnDictConfig
from shapefit.config.commands.learn_dict import PriorConfig
from shapefit.dictionary.batches import improve
from shapefit.dictionary.coding import sparse_code
from shapefit.dictionary.learning import evenly, learn
from shapefit.dictionary.model import SUITS, Dictionary
from shapefit.dictionary.pca_bases import principal_components
from shapefit.dictionary.summary import Summary, summarise
from shapefit.errors import counted, input_error
from shapefit.io import (
    LandmarkSource,
    ShapeSet,
    ShapeSource,
    check_output,
    digests,
    open_landmarks,
    open_shapes,
    read_dictionary,
    write_dictionary,
)
from shapefit.io.formats import find_writer
from shapefit.io.layout import DICTIONARY
from shapefit.io.listing import find_kind
from shapefit.io.memory import check_fits
from shapefit.io.options import input_options
from shapefit.io.sources import is_stream
from shapefit.meshes.dense import mesh_of_atoms
from shapefit.pipelines.learn_dict.batches import TrainingBatches, find_training_batches
from shapefit.pipelines.learn_dict.from_2d import (
    decide_what_is_near,
    learn_from_landmarks,
    relift,
)
from shapefit.pipelines.learn_dict.prior import learn_prior
from shapefit.pipelines.learn_dict.start import adapt_to_landmarks
from shapefit.pipelines.learn_dict.training_shapes import (
    TrainingOptions,
    TrainingShapes,
    find_k,
    find_training_shapes,
)
from shapefit.pipelines.outcome import Outcome

Making = Generator[Outcome, None, Dictionary]
"""Yields an outcome a round, and returns the dictionary; the last outcome sums up."""


def run(config: LearnDictConfig) -> Iterator[Outcome]:
    """Make the dictionary and write it; one outcome per round, sequence or set of exemplars.

    The first outcome lists the shapes that could not be used. Raises InputError for files that
    cannot be read or written, and as `make_dictionary` does.
    """
    check_output(config.output)
    find_writer(config.output, DICTIONARY.kind)
    options = plan_training(config)
    if hold_landmarks(config):
        check_keys(config, landmarks=True)
        with open_landmarks(config.shapes, input_options(config.input)) as images:
            notes = images.notes
            adapted = config.start is not None
            make = adapt_start if adapted else make_from_landmarks
            making = make(images, config, options)
            outcome = next(making)
    elif config.start is not None:
        found = "2D landmarks adapt a dictionary, and the files hold 3D shapes"
        raise input_error("start", found, "leave it out, or give landmarks")
    else:
        check_keys(config, landmarks=False)
        with open_shapes(config.shapes, input_options(config.input)) as source:
            notes = source.notes + check_rate(source.head.frame_rate, config)
            training = read_training(source, options, coded=config.method == "sparse-coding")
        making = make_dictionary(training, config, options, digests(config.shapes))
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
    if dictionary.prior is not None and not config.suits:
        command = f"shapefit fit LANDMARKS -d {config.output.name} -o result.h5"
        yield Outcome(line=f"Go on with: {command} --set method=posterior")
    yield replace(outcome, written=(config.output,))


def check_rate(stated: float | None, config: LearnDictConfig) -> tuple[str, ...]:
    """Warn of shapes that do not state their frame rate; InputError for one that is not wanted."""
    wanted = config.frame_rate
    if wanted is None or stated == wanted:
        return ()
    fix = f"write them at {wanted:g} frames per second: `shapefit convert --set every=N`"
    if stated is not None:
        found = f"has {stated:g} frames per second, and `frame_rate` is {wanted:g}"
        raise input_error(config.shapes[0], found, fix)
    return (f"{config.shapes[0]}: states no frame rate, and {wanted:g} is wanted; {fix}",)


def check_keys(config: LearnDictConfig, *, landmarks: bool) -> None:
    """Raise InputError for keys that have no effect on files of 2D landmarks, or of 3D shapes."""
    idle = {}
    if landmarks and config.frame_rate is not None:
        idle["frame_rate"] = "only for 3D shapes: the files hold 2D landmarks"
    if not landmarks and config.flip:
        idle["flip"] = "only for 2D landmarks: the files hold 3D shapes"
    if not landmarks and not config.prior.components and config.prior != PriorConfig():
        key = f"prior.{min(config.prior.model_fields_set)}"
        idle[key] = "only with `prior: {components: ...}`"
    for key, condition in idle.items():
        raise input_error(key, f"`{key}` has no effect here, {condition}", "leave it out")


def hold_landmarks(config: LearnDictConfig) -> bool:
    """Whether the files hold 2D landmarks, so that shapes are learned from them as well."""
    options = input_options(config.input)
    given = (path for path in config.shapes if not is_stream(path))
    return {find_kind(path, options) for path in given} == {"landmarks"}


def make_from_landmarks(
    source: LandmarkSource, config: LearnDictConfig, options: TrainingOptions
) -> Making:
    """Learn shapes from 2D landmarks, and then a dictionary from these."""
    inputs = digests(config.shapes)
    learned = yield from learn_from_landmarks(source, options.place, config.flip)

    def make(shapes: ShapeSet, components: int, iterations: int, varied: bool) -> Making:
        still = {} if varied else {"stretch": 0.0, "exchange": 0.0, "copies": None}
        prior = config.prior.model_copy(update={"components": components, **still})
        asked = config.model_copy(update={"prior": prior, "iterations": iterations})
        return make_dictionary(find_training_shapes(shapes, options), asked, options, inputs)

    varied = config.prior.stretch > 0 or config.prior.exchange > 0
    made = yield from relift(learned, make, config.prior.components, config.iterations, varied)
    return (yield from decide_what_is_near(learned, made))


def adapt_start(
    source: LandmarkSource, config: LearnDictConfig, options: TrainingOptions
) -> Making:
    """Adapt the dictionary that the config starts from to 2D landmarks."""
    assert config.start is not None
    fit = FitConfig.model_construct(
        landmarks=config.shapes, dictionary=config.start, output=config.output, method="posterior"
    )
    start = read_dictionary(config.start)
    made = yield from adapt_to_landmarks(source, start, fit)
    provenance = {
        **start.provenance,
        "version": __version__,
        "config": config.as_json(),
        "inputs": json.dumps(digests((*config.shapes, config.start))),
    }
    return replace(made, provenance=provenance)


def plan_training(config: LearnDictConfig) -> TrainingOptions:
    """Return how the shapes are read and prepared."""
    return TrainingOptions(
        place=", ".join(map(str, config.shapes)),
        every=config.every,
        align=config.align,
        symmetry=config.symmetry,
        mirror=config.mirror,
        atoms=config.k if config.method == "sparse-coding" else 1,
        fewer="k" not in config.model_fields_set,
        batch=config.batch,
        folder=config.output,
    )


def read_training(
    source: ShapeSource, options: TrainingOptions, *, coded: bool
) -> TrainingShapes | TrainingBatches:
    """Read the shapes to learn from: all at once, or in batches where these are asked for.

    Raises InputError where they do not fit in memory together while they are `coded`.
    """
    if 0 < options.batch < source.count:
        return find_training_batches(source, options)
    if coded:
        fix = "set `batch`, the number of shapes in memory at a time (docs/scale.md)"
        size = size_at_once(source, options)
        check_fits(options.place, size, "learning from all shapes at once", fix)
    return find_training_shapes(source.whole(), options)


def size_at_once(source: ShapeSource, options: TrainingOptions) -> int:
    """Bytes that sparse coding of all shapes at once takes, as measured: benchmarks/batches.py."""
    p, every = len(source.head.landmark_names), options.every
    step = every if isinstance(every, int) else max(every.values())
    copies = 2 if options.symmetry == "double" else 1
    return 8 * source.count * (6 * p + copies * (9 * p + 4 * options.atoms) // step)


def make_dictionary(
    training: TrainingShapes | TrainingBatches,
    config: LearnDictConfig,
    options: TrainingOptions,
    inputs: Mapping[str, str],
) -> Making:
    """Make the dictionary of training shapes; `inputs` are the digests of their files.

    It has the landmarks and edges of the shapes; atoms that are shapes or mixtures of shapes have
    meshes mixed alike. Raises InputError for bases of sequences that all stand still.
    """
    yield Outcome(
        failures=training.failures,
        warnings=training.warnings,
        note=counted(len(training), "shape"),
    )
    prior, batched = None, isinstance(training, TrainingBatches)
    k = find_k(min(config.batch, len(training)) if batched else len(training), options)
    coding = Coding(k, config.beta, config.iterations)
    if isinstance(training, TrainingBatches):
        made = yield from _sparse_coding_in_batches(training, coding, config.batch)
    else:
        match config.method:
            case "exemplars":
                made = yield from _exemplars(training)
            case "pca-bases":
                made = yield from _pca_bases(training, config.bases)
            case _:
                made = yield from _sparse_coding(training, coding)
        if config.prior.components:
            prior, note = learn_prior(training, config.prior, options)
            yield Outcome(note=note)
    provenance = {
        "method": config.method,
        "version": __version__,
        "config": config.as_json(),
        "inputs": json.dumps(inputs),
        **{str(key): text for key, text in config.origin.items()},
        **({SUITS: " ".join(config.suits)} if config.suits else {}),
    }
    return replace(made, prior=prior, provenance=provenance)


def _exemplars(training: TrainingShapes) -> Making:
    """Make every shape an atom."""
    atoms = training.alignment.shapes
    dictionary = replace(
        training.dictionary,
        atoms=atoms,
        mesh_vertices=training.mesh_vertices,
        mesh_faces=training.original.mesh_faces,
        atom_scale=training.scale,
        atom_items=training.original.items,
    )
    yield Outcome(done=len(atoms), unit="shape", note=counted(len(atoms), "atom"))
    return dictionary


class Coding(NamedTuple):
    """Sparse coding of shapes by k atoms: the weight of the sparsity, and the rounds."""

    k: int
    beta: float
    iterations: int


def _sparse_coding(training: TrainingShapes, coding: Coding) -> Making:
    """Learn by sparse coding, with the objective of each round in its note."""
    shapes = training.alignment.shapes
    rounds = learn(shapes, coding.k, coding.beta, iterations=coding.iterations)
    for learned in rounds:
        note = f"objective {learned.trace[-1]:.6g}"
        yield Outcome(done=1, total=coding.iterations, unit="round", note=note)
    summary = summarise(
        [(shapes, learned.coefficients, training.scale)], learned.atoms, coding.beta
    )
    mesh_vertices = _mix_meshes(training, learned.atoms)
    dictionary = replace(
        training.dictionary,
        atoms=learned.atoms,
        mesh_vertices=mesh_vertices,
        mesh_faces=None if mesh_vertices is None else training.original.mesh_faces,
        atom_scale=summary.atom_scale,
        objective_trace=learned.trace,
    )
    warnings = [*_dead_atoms(summary)]
    if training.mesh_vertices is not None and mesh_vertices is None:
        warnings.append("the meshes are left out: an atom is no combination of the training shapes")
    yield Outcome(total=coding.iterations, warnings=tuple(warnings), note=_note(summary))
    return dictionary


def _sparse_coding_in_batches(training: TrainingBatches, coding: Coding, size: int) -> Making:
    """Learn from a sample as large as a batch, then by rounds over all shapes.

    The trace is that of all shapes, and starts with the atoms of the sample.
    """
    sample = training.shapes.column.take(evenly(len(training), min(size, len(training))))
    for learned in learn(sample, coding.k, coding.beta, iterations=coding.iterations):
        note = f"sample of {counted(len(sample), 'shape')}, objective {learned.trace[-1]:.6g}"
        yield Outcome(done=1, unit="round", note=note)
    atoms, trace = learned.atoms, learned.trace
    if len(sample) < len(training):
        del sample, learned
        rounds = improve(training.shapes, atoms, coding.beta, iterations=coding.iterations)
        for improved in rounds:
            atoms, trace = improved.atoms, improved.trace
            yield Outcome(done=1, unit="round", note=f"objective {trace[-1]:.6g}")
    coded = (
        (shapes, sparse_code(shapes, atoms, coding.beta), scale)
        for shapes, scale in zip(training.shapes, training.scale, strict=True)
    )
    summary = summarise(coded, atoms, coding.beta)
    yield Outcome(warnings=tuple(_dead_atoms(summary)), note=_note(summary))
    return replace(
        training.dictionary,
        atoms=atoms,
        atom_scale=summary.atom_scale,
        objective_trace=trace,
    )


def _note(summary: Summary) -> str:
    """Say how well the atoms code the shapes."""
    gap = summary.largest_gap
    of_coding = "" if gap is None else f"relative gap of the coding at most {gap:.1g}, "
    return (
        f"objective {summary.objective:.6g}, relative error {summary.relative_error:.4f}, "
        f"{of_coding}{summary.active_atoms:.1f} active atoms per shape"
    )


def _pca_bases(training: TrainingShapes, wanted: float) -> Making:
    """Find the bases of each sequence, with their number in its note."""
    sequences = np.array(training.original.sequences or ("",) * len(training))
    names = dict.fromkeys(sequences.tolist())
    found = []
    for name in names:
        moving = training.alignment.shapes[sequences == name]
        found.append(principal_components(moving, wanted))
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
    return replace(training.dictionary, atoms=bases)


def _mix_meshes(training: TrainingShapes, atoms: Floats) -> Floats | None:
    """Mix the meshes as the shapes were mixed; None without meshes, or where that cannot be."""
    if training.mesh_vertices is None:
        return None
    try:
        return mesh_of_atoms(atoms, training.alignment.shapes, training.mesh_vertices)
    except ValueError:
        return None


def _dead_atoms(summary: Summary) -> Iterator[str]:
    if summary.dead_atoms:
        k = len(summary.atom_scale)
        yield f"{summary.dead_atoms} of {k} atoms are used by no training shape"
