"""`verify`: a result in, every statement of it that does not hold out."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import islice
from pathlib import Path

import numpy as np

from shapefit.dictionary.model import Dictionary
from shapefit.errors import InputError, counted, input_error
from shapefit.io import (
    LandmarkSet,
    ResultSet,
    digest,
    match_landmarks,
    open_landmarks,
    read_dictionary,
)
from shapefit.io.formats import HDF5, detect_format, group_inputs
from shapefit.io.options import AS_THEY_ARE, InputOptions
from shapefit.io.source import ResultSource, open_results
from shapefit.pipelines.outcome import Failure, Outcome, unread
from shapefit.pipelines.overlap import side_by_side
from shapefit.stores.locations import files_in
from shapefit.stores.reading import read_bytes
from shapefit.stores.shelf import find_state
from shapefit.stores.urls import UrlPath
from shapefit.verification.check import Check
from shapefit.verification.claims import verify_images
from shapefit.verification.coverage import Coverage
from shapefit.verification.folder import (
    MANIFEST,
    Entry,
    Folder,
    PartItems,
    false_items,
    false_list,
    false_terms,
    read_folder,
)
from shapefit.verification.inputs import carried_by, check_landmarks, false_heads, false_inputs
from shapefit.verification.proofs.sizes import Size, check_metres, check_position
from shapefit.verification.terms import DONE, LOOKING, Terms, lacks_proof, read_terms

Chunk = tuple[ResultSet, LandmarkSet | None]
"""Results, with the landmarks of the same images where they are given."""

CHUNK_BYTES = 1 << 24
"""Of the largest arrays of the images that are checked together."""

FEWEST, MOST = 16, 4096
"""Images that are checked together."""


@dataclass(frozen=True)
class Request:
    """A result to verify, the dictionary of its fit and, if given, the landmarks."""

    result: Path
    dictionary: Path
    landmarks: tuple[Path, ...] = ()


@dataclass(frozen=True)
class Part:
    """A file of results, the landmarks of its images, and what a manifest states of it."""

    file: Path
    landmarks: tuple[Path, ...]
    entry: Entry | None = None
    folder: Folder | None = None


@dataclass(frozen=True)
class Work:
    """What all parts share, and what is found out about them together.

    digest of a file is taken once.
    """

    request: Request
    dictionary: Dictionary
    coverage: Coverage
    digest: Callable[[Path], str] = field(default_factory=lambda: cache(digest))


def run(request: Request) -> Generator[Outcome, None, None]:
    """Verify every image of a result; yields an Outcome per chunk, and the table as the last note.

    Raises InputError where the result is no HDF5 or Parquet result of `fit`, has no proof though
    its method has one, or does not go with the dictionary or the landmarks; for a folder only where
    that is so of every part.
    """
    parts, wrong = find_parts(request)
    folder = parts[0].folder if parts else None
    coverage = Coverage(in_folder=folder is not None, landmarks=bool(request.landmarks))
    work = Work(request, read_dictionary(request.dictionary), coverage)
    yield Outcome(failures=wrong)
    errors: list[InputError] = []
    for part in parts:
        try:
            yield from verify_file(part, work)
        except InputError as error:
            errors.append(error)
            if len(errors) == len(parts):
                raise InputError(each for one in errors for each in one.problems) from None
            yield Outcome(failures=(unread(part.file, error),))
    if folder is not None:  # images of parts that are not there, or were not read, are not proved
        stated = sum(entry.images for entry in folder.entries)
        coverage.images = max(coverage.images, stated)
    failures: tuple[Failure, ...] = ()
    if coverage.empty and not request.landmarks:
        reason = "not checked: give the landmarks of the fit with `--landmarks`"
        failures = (Failure(f"{counted(coverage.empty, 'image')} without a shape", reason),)
    yield Outcome(failures=failures, note="\n".join(coverage.lines()))


def find_parts(request: Request) -> tuple[list[Part], tuple[Failure, ...]]:
    """Return the files of a result, and what is wrong with the list of them in its manifest."""
    result = request.result
    if result.is_file() or not (isinstance(result, UrlPath) or result.is_dir()):
        return [Part(result, request.landmarks)], ()
    manifest = result / MANIFEST
    try:
        folder = read_folder(manifest, read_bytes(manifest))
    except FileNotFoundError:
        found = "is a folder without results"
        raise input_error(result, found, "name a result in it") from None
    there = files_in(result)
    wrong = false_list(folder, there)
    own: dict[tuple[str, ...], tuple[Path, ...]] = {}
    if request.landmarks:
        inputs = list(dict.fromkeys(entry.inputs for entry in folder.entries))
        groups = group_inputs(request.landmarks, AS_THEY_ARE)
        given = iter([path for _, paths in groups for path in paths])
        own = {each: tuple(islice(given, len(each))) for each in inputs}
        made, more = sum(map(len, inputs)), len(list(given))
        own = {each: paths for each, paths in own.items() if len(each) == len(paths)}
        if more or len(own) < len(inputs):
            found = (
                f"the parts were made from {counted(made, 'file')}, not {len(request.landmarks)}"
            )
            wrong.append(("landmarks", found))
        wrong += false_ends(folder, own)
    parts = [
        Part(result / entry.file, own.get(entry.inputs, ()), entry, folder)
        for entry in folder.entries
        if entry.file in there
    ]
    return parts, tuple(Failure(*each) for each in wrong)


def false_ends(
    folder: Folder, own: dict[tuple[str, ...], tuple[Path, ...]]
) -> list[tuple[str, str]]:
    """Return the parts whose landmarks had other sizes, and those after which some are missing."""
    wrong = []
    last = {entry.inputs: entry for entry in folder.entries}
    for entry in (entry for entry in folder.entries if entry.inputs in own):
        paths = own[entry.inputs]
        states = [state for state in map(find_state, paths) if state is not None]
        if entry.sizes != tuple(size for size, _ in states):
            wrong.append((entry.file, f"was made from a file of another size than {paths[0]}"))
        if entry is last[entry.inputs] and entry.rows is not None:
            with open_landmarks(paths) as source:
                if source.count != entry.rows[1]:
                    found = (
                        f"ends the parts at image {entry.rows[1]} of {source.count} in {paths[0]}"
                    )
                    wrong.append((entry.file, found))
    return wrong


def verify_file(part: Part, work: Work) -> Generator[Outcome, None, None]:
    """Verify the images of one file, and what it states of them all."""
    file, coverage, items = part.file, work.coverage, PartItems()
    with open_proofs(file) as results:
        head, names = results.head, results.head.landmark_names
        terms = read_terms(head.attributes, file)
        work = replace(work, dictionary=work.dictionary.marked(names))
        atoms, size = arrange_atoms(results, file, work), Size.of(work.dictionary)
        hung = dict(zip(work.dictionary.landmark_names, work.dictionary.hung >= 0, strict=True))
        looks = terms.method in LOOKING
        aside = np.array([looks and hung.get(name, False) for name in names])
        wrong = false_files(part, results, terms, work)
        with open_given(part, results, terms) as given:
            carried = set[str]()
            if given is not None:
                wrong += false_heads(head, given.head, terms)
                carried = set(carried_by(given.head)[0])
            wrong += coverage.begin(stored_names(head), head, terms, carried)
            yield Outcome(failures=tuple(Failure(*each) for each in wrong))

            def verify(chunk: Chunk) -> tuple[ResultSet, list[Check]]:
                result, images = chunk
                checks = verify_images(
                    result, atoms, work.dictionary.atom_items, aside, terms, file
                )
                checks += [*check_metres(result, size), *check_position(result, size)]
                checks += check_landmarks(result, images) if images is not None else []
                return result, checks

            chunks = require_proof(read_chunks(results, atoms, given), terms, file)
            workers = max((os.cpu_count() or 1) - 1, 1)  # one core reads
            for result, checks in side_by_side(verify, chunks, workers):
                coverage.add(result, checks)
                if part.entry is not None:
                    items.add(result.items, count_failed(result, terms))
                failures = find_failures(result, checks)
                yield Outcome(done=len(result), total=results.count, failures=failures)
    if part.entry is not None:
        yield Outcome(failures=tuple(Failure(*each) for each in false_items(part.entry, items)))


def open_proofs(file: Path) -> ResultSource:
    """Open a result with its proofs. Raises InputError where it is a table, or not a result."""
    if detect_format(file) is not HDF5:
        found = "is not HDF5, and tables hold points only"
        fix = "give a result that `shapefit fit` wrote to a name in .h5"
        raise input_error(file, found, fix)
    return open_results([file], proofs=True, check=False)


def stored_names(head: ResultSet) -> frozenset[str]:
    """Return the names of what the root of the file holds: datasets and groups."""
    return head.datasets | {name.partition("/")[0] for name in head.further}


def false_files(
    part: Part, results: ResultSource, terms: Terms, work: Work
) -> list[tuple[str, str]]:
    """Return which files, by their digests and the manifest, are not those of the fit."""
    names = (terms.dictionary, *terms.landmarks)
    paths = (work.request.dictionary, *part.landmarks)
    given = [(path, name, work.digest(path)) for path, name in zip(paths, names, strict=False)]
    wrong = false_inputs(results.head.attributes, terms, given)
    if results.head.landmark_names != work.dictionary.landmark_names:
        wrong.append(("landmark_names", "are not those of the dictionary, in its order"))
    by = Size.of(work.dictionary).by
    if results.head.attributes.get("metres_from", by) != by:
        wrong.append(("metres_from", f"is not '{by}', by which the dictionary knows sizes"))
    if part.landmarks and len(paths) != len(names):
        found = f"the fit had {counted(len(names) - 1, 'file')} of landmarks"
        wrong.append((str(part.landmarks[0]), found))
    if part.entry is not None and part.folder is not None:
        from shapefit.pipelines.parts.run import OF_THE_RUN

        config = json.loads(str(results.head.attributes["config"]))
        wrong += false_terms(part.entry, part.folder, terms, config, OF_THE_RUN)
    return wrong


@dataclass(frozen=True)
class Given:
    """Landmarks to compare with: all but the images, and what gives so many of these at a time."""

    head: LandmarkSet
    chunks: Callable[[int], Iterator[LandmarkSet]]


@contextmanager
def open_given(part: Part, results: ResultSource, terms: Terms) -> Iterator[Given | None]:
    """Open the landmarks of a part as its fit did; None where none are given.

    Raises InputError where there are not as many images as results.
    """
    if not part.landmarks:
        yield None
        return
    place = ", ".join(map(str, part.landmarks)) + ": landmark names"
    rows = part.entry.rows if part.entry is not None else None
    options = InputOptions(**terms.input)
    with open_landmarks(part.landmarks, options, None if rows is None else slice(*rows)) as source:
        if source.count != results.count and part.entry is not None:
            yield None  # the manifest says so
            return
        if source.count != results.count:
            found = f"{counted(source.count, 'image')} for {counted(results.count, 'result')}"
            raise input_error(part.landmarks[0], found, f"give the landmarks of {part.file}")
        named = namer(source.head.landmark_names, results.head.landmark_names, terms, place)

        def arranged(images: LandmarkSet) -> LandmarkSet:
            return named(images).arrange(results.head.landmark_names, place, leave_out=True)

        yield Given(arranged(source.head), lambda size: map(arranged, source.batches(size)))


def namer(
    own: tuple[str, ...], known: tuple[str, ...], terms: Terms, place: str
) -> Callable[[LandmarkSet], LandmarkSet]:
    """Return what gives landmarks the names of the joints that they stand for, if some do."""
    if set(known) <= set(own):
        return lambda images: images
    from shapefit.lifting.methods import METHODS
    from shapefit.pipelines.joints import find_joints, named_as_joints

    joints = find_joints(own, known, in_place=METHODS[terms.method].has_prior)
    return lambda images: named_as_joints(images, joints, place)


def arrange_atoms(
    results: ResultSource, file: Path, work: Work
) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Return the atoms (k, 3, p) with the landmarks of the result, in their order."""
    dictionary, path = work.dictionary, work.request.dictionary
    place = f"{path}: landmark names"
    columns = match_landmarks(dictionary.landmark_names, results.head.landmark_names, place)
    coefficients = results.head.coefficients
    k = None if coefficients is None else coefficients.shape[1]
    if k is not None and k != dictionary.k:
        found = f"has {counted(dictionary.k, 'atom')}, and {file} coefficients of {k}"
        raise input_error(path, found, "give the dictionary of the fit")
    return np.ascontiguousarray(dictionary.atoms[:, :, columns])


def read_chunks(results: ResultSource, atoms: np.ndarray, given: Given | None) -> Iterator[Chunk]:
    """Give out the results, with the landmarks of the same images where they are given."""
    k, _, p = atoms.shape
    size = min(max(CHUNK_BYTES // (72 * k + 96 * p), FEWEST), MOST)
    chunks = results.batches(size)
    if given is None:
        return ((result, None) for result in chunks)
    return zip(chunks, given.chunks(size), strict=False)


def require_proof(chunks: Iterator[Chunk], terms: Terms, file: Path) -> Iterator[Chunk]:
    """Pass chunks on. Raises InputError where one lacks the proof that its method has."""
    for chunk in chunks:
        if terms.has_program and lacks_proof(chunk[0]):
            found = "holds no dual and transforms that prove its gaps (`proof: false`)"
            raise input_error(file, found, "fit again with `proof: true`")
        yield chunk


def find_failures(result: ResultSet, checks: list[Check]) -> tuple[Failure, ...]:
    """List the images that miss a claim, each with the first claim that it misses."""
    missed = np.array([one.missed for one in checks])
    failures = []
    for image in np.flatnonzero(missed.any(axis=0)).tolist():
        first, *more = np.flatnonzero(missed[:, image]).tolist()
        also = f" (and {counted(len(more), 'further claim')})" if more else ""
        failures.append(Failure(result.items[image], checks[first].reason(image) + also))
    return tuple(failures)


def count_failed(result: ResultSet, terms: Terms) -> int:
    """Count the images that `fit` reports as failed: without a shape or, if strict, not optimal."""
    empty = np.isnan(result.shapes).all(axis=(1, 2))
    if terms.strict and result.status is not None:
        empty |= ~np.isin(np.asarray(result.status).astype(str), DONE)
    return int(empty.sum())
