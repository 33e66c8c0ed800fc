"""`verify`: a result in, every claim that does not hold out."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from shapefit.config.paths import result_parts
from shapefit.dictionary.model import Dictionary
from shapefit.errors import InputError, counted, input_error
from shapefit.io import (
    LandmarkSet,
    LandmarkSource,
    ResultSet,
    match_landmarks,
    open_landmarks,
    read_dictionary,
)
from shapefit.io.kinds.proofs import ProofFile, open_proofs
from shapefit.pipelines.outcome import Failure, Outcome
from shapefit.stores.urls import UrlPath
from shapefit.verification.check import Check
from shapefit.verification.claims import verify_images
from shapefit.verification.inputs import check_landmarks, false_inputs
from shapefit.verification.tally import Tally
from shapefit.verification.terms import LOOKING, STARTED, Terms, lacks_proof, read_terms

Chunk = tuple[ResultSet, LandmarkSet | None]
"""Results, with the landmarks of the same images where they are given."""

CHUNK_BYTES = 1 << 23
"""Of the largest arrays of the images that are checked together."""

FEWEST, MOST = 16, 4096
"""Images that are checked together."""


@dataclass(frozen=True)
class Request:
    """A result to verify, the dictionary of its fit and, if given, the landmarks."""

    result: Path
    dictionary: Path
    landmarks: tuple[Path, ...] = ()


def run(request: Request) -> Generator[Outcome, None, None]:
    """Verify every image of a result; yields an Outcome per chunk, and the table as the last note.

    Raises InputError where the result is no HDF5 result of `fit`, has no proof though its method
    has one, or does not go with the dictionary or the landmarks.
    """
    dictionary = read_dictionary(request.dictionary)
    tally = Tally()
    said: tuple[str, ...] = ()
    for file in find_results(request):
        said = yield from _verify_file(replace(request, result=file), dictionary, tally)
    yield Outcome(note="\n".join([*tally.lines(), "", *said]))


def find_results(request: Request) -> tuple[Path, ...]:
    """Return the files of a result: those in the folder, where it was fitted part by part."""
    in_store = isinstance(request.result, UrlPath)
    if request.result.is_file() or not (in_store or request.result.is_dir()):
        return (request.result,)
    try:
        parts = result_parts(request.result)
    except ValueError as error:
        raise InputError(str(error)) from None
    if not parts:
        raise input_error(request.result, "is a folder without results", "name a result in it")
    if request.landmarks:
        found = "are compared with one result file, and this is a folder"
        raise input_error("landmarks", found, f"verify the parts, such as {parts[0]}")
    return parts


def _verify_file(
    request: Request, dictionary: Dictionary, tally: Tally
) -> Generator[Outcome, None, tuple[str, ...]]:
    """Verify the images of one file; return what its claims cover, in sentences."""
    with open_proofs(request.result) as results:
        terms = read_terms(results.attributes, request.result)
        atoms = arrange_atoms(results, dictionary, request)
        false = false_inputs(results.attributes, terms, request.dictionary, request.landmarks)
        yield Outcome(failures=tuple(Failure(*one) for one in false))

        def verify(result: ResultSet, images: LandmarkSet | None) -> list[Check]:
            checks = verify_images(result, atoms, dictionary.atom_items, terms, request.result)
            return checks + (check_landmarks(result, images) if images is not None else [])

        for result, checks in side_by_side(verify, read_chunks(results, atoms, terms, request)):
            tally.add(checks)
            yield Outcome(
                done=len(result), total=results.count, failures=find_failures(result, checks)
            )
    return tuple(explain(terms))


def arrange_atoms(
    results: ProofFile, dictionary: Dictionary, request: Request
) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Return the atoms (k, 3, p) with the landmarks of the result, in their order."""
    place = f"{request.dictionary}: landmark names"
    columns = match_landmarks(dictionary.landmark_names, results.landmark_names, place)
    k = results.size("k")
    if k is not None and k != dictionary.k:
        found = f"has {counted(dictionary.k, 'atom')}, and {request.result} coefficients of {k}"
        raise input_error(request.dictionary, found, "give the dictionary of the fit")
    return np.ascontiguousarray(dictionary.atoms[:, :, columns])


def read_chunks(
    results: ProofFile, atoms: np.ndarray, terms: Terms, request: Request
) -> Iterator[Chunk]:
    """Give out the results, with the landmarks of the same images where they are given."""
    k, _, p = atoms.shape
    size = min(max(CHUNK_BYTES // (72 * k + 96 * p), FEWEST), MOST)
    if not request.landmarks:
        for result in results.chunks(size):
            yield require_proof(result, terms, request.result), None
        return
    with open_landmarks(request.landmarks) as source:
        check_count(source, results, request)
        names = ", ".join(map(str, request.landmarks)) + ": landmark names"
        for result, images in zip(results.chunks(size), source.chunks(size), strict=False):
            arranged = images.arrange(result.landmark_names, names)
            yield require_proof(result, terms, request.result), arranged


def check_count(source: LandmarkSource, results: ProofFile, request: Request) -> None:
    """Raise InputError where there are not as many images as results."""
    if source.count != results.count:
        found = f"{counted(source.count, 'image')} for {counted(results.count, 'result')}"
        raise input_error(request.landmarks[0], found, "give the landmarks of the fit")


def require_proof(result: ResultSet, terms: Terms, file: Path) -> ResultSet:
    """Return the result. Raises InputError where it lacks the proof that its method has."""
    if terms.has_program and lacks_proof(result):
        found = "holds no dual and transforms that prove its gaps (`proof: false`, or an older fit)"
        raise input_error(file, found, "fit again with `proof: true`")
    return result


def side_by_side(
    verify: Callable[[ResultSet, LandmarkSet | None], list[Check]], chunks: Iterable[Chunk]
) -> Iterator[tuple[ResultSet, list[Check]]]:
    """Verify chunks on all cores; gives them out in order, a few ahead of what is taken."""
    workers = os.cpu_count() or 1
    waiting: deque[tuple[ResultSet, Future[list[Check]]]] = deque()
    with ThreadPoolExecutor(workers) as pool:
        for chunk in chunks:
            waiting.append((chunk[0], pool.submit(verify, chunk[0], chunk[1])))
            if len(waiting) > workers:
                result, future = waiting.popleft()
                yield result, future.result()
        for result, future in waiting:
            yield result, future.result()


def find_failures(result: ResultSet, checks: list[Check]) -> tuple[Failure, ...]:
    """List the images that miss a claim, each with the first claim that it misses."""
    missed = np.array([one.missed for one in checks])
    failures = []
    for image in np.flatnonzero(missed.any(axis=0)).tolist():
        first, *more = np.flatnonzero(missed[:, image]).tolist()
        also = f" (and {counted(len(more), 'further claim')})" if more else ""
        failures.append(Failure(result.items[image], checks[first].reason(image) + also))
    return tuple(failures)


def explain(terms: Terms) -> list[str]:
    """State in sentences what the claims about such a fit cover, and what they do not."""
    said = []
    if terms.is_program:
        said.append("The optimum of the convex program is proved to the gap stated.")
    elif terms.has_program and terms.perspective and terms.method not in LOOKING:
        said.append(
            "The optimum of the convex program from which the refinement under perspective starts "
            "is proved; no bound is known for the result of the refinement."
        )
    elif terms.has_program and terms.method in STARTED:
        said.append(
            "Proved is the optimum of the convex program that gives the view to start from; the "
            "posterior itself has no proof."
        )
    elif terms.has_program and terms.loss == "squared":
        said.append(
            f"The objective of {terms.method} is bounded by the dual of the convex program: no "
            "shape with one rotation is better by more than the gap stated."
        )
    elif terms.has_program:
        said.append(
            "The optimum of the robust program that finds the outliers is proved; no bound is "
            "known for the refinement."
        )
    elif terms.is_global:
        said.append(
            "Where a tree is stored (`search.proof_every`) no rotation has an objective below "
            "`objective * (1 - relative_gap)`; of other images the gap is stated, not proved."
        )
    else:
        said.append(f"The method {terms.method} has no proof of an optimum.")
    if not (terms.is_program or terms.has_one_rotation):
        said.append("How its shapes are computed is not covered.")
    if terms.depths:
        said.append("Depths refined along sequences are not covered.")
    if terms.path:
        said.append("The path of lambdas is not covered.")
    return said
