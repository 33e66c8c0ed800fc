"""`verify`: a result in, every statement of it that does not hold out.

A claim is proved, consistent with the rest of the file, or false. Proved is an optimum, by its
certificate; all else of an honest file is consistent; what nothing else determines is named.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cache, partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from shapefit.dictionary.bodies import has_lengths, knows_size, metres_per_unit
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
from shapefit.io.foreign.calibration import CalibratedCamera, read_camera
from shapefit.io.formats import HDF5, detect_format, group_inputs
from shapefit.io.layout import free_names
from shapefit.io.options import AS_THEY_ARE, InputOptions
from shapefit.io.source import ResultSource, open_results
from shapefit.lifting.methods import METHODS
from shapefit.meshes.dense import metric_scale
from shapefit.pipelines.fit.camera import straightened
from shapefit.pipelines.fit.record import OF_A_RESULT
from shapefit.pipelines.joints import MEANS, Joints, find_joints, named_as_joints
from shapefit.pipelines.outcome import Failure, Outcome, unread
from shapefit.pipelines.overlap import side_by_side
from shapefit.pipelines.parts.manifest import read_manifest, result_digest
from shapefit.stores import UrlPath, files_in
from shapefit.verification.checks import Checks
from shapefit.verification.claims import Model, check_images
from shapefit.verification.fit import Fit, read_fit

CHUNK_BYTES = 1 << 24
"""Of the largest arrays of the images that are checked together."""
FEWEST, MOST = 16, 4096
"""Images that are checked together."""

STREAM = "stream"
"""Stands for the digest of what could not be read twice."""
STRAIGHT = 1e-8
"""Of the largest coordinate by which landmarks without the distortion of a lens may be off."""


@dataclass(frozen=True)
class Request:
    """A result to verify, the dictionary of its fit and, if given, the landmarks."""

    result: Path
    dictionary: Path
    landmarks: tuple[Path, ...] = ()


@dataclass(frozen=True)
class Part:
    """A file of results, and the landmarks of its images: a range of rows of them, or all."""

    file: Path
    landmarks: tuple[Path, ...]
    rows: tuple[int, int] | None = None


@dataclass
class Tally:
    """What became of the claims, summed up over all files of a result.

    claims: images of which each is made, and those for which it is false; datasets, what the files
    state, and settled, what was checked of that; without_landmarks: what could be, were they given.
    """

    claims: dict[str, list[int]] = field(default_factory=dict)
    datasets: set[str] = field(default_factory=set)
    settled: set[str] = field(default_factory=set)
    without_landmarks: set[str] = field(default_factory=set)
    fit: Fit | None = None
    images: int = 0
    proved: int = 0
    false: int = 0
    empty: int = 0
    proofless: bool = False

    def add(self, checks: Checks, proved: int) -> None:
        """Take in the checks of some more images."""
        for check in checks.made:
            sums = self.claims.setdefault(check.claim, [0, 0])
            sums[0] += int(check.made.sum())
            sums[1] += int(check.missed.sum())
        self.settled |= checks.settled
        self.images += len(checks.fitted)
        self.proved += proved
        self.false += int(checks.missed().sum())
        self.empty += int((~checks.fitted).sum())

    def lines(self) -> list[str]:
        """Return the table of claims, of how many images what is proved, and what is unchecked."""
        lines = ["| claim | images | false |", "|---|--:|--:|"]
        lines += [f"| {claim} | {made} | {false} |" for claim, (made, false) in self.claims.items()]
        lines += ["", *self.verdict()]
        unknown = sorted(self.datasets - self.settled - self.without_landmarks)
        left = ", ".join(f"`{name}`" for name in unknown) or "nothing"
        if self.without_landmarks:
            names = ", ".join(f"`{name}`" for name in sorted(self.without_landmarks))
            left += f"; without `--landmarks` also not {names}"
        return [*lines, f"Not checked, or not to the last number: {left}."]

    def verdict(self) -> list[str]:
        """Say of how many images what is proved, and what an image without a proof is."""
        if self.fit is None or not self.images:
            return ["No image was checked: nothing is proved."]
        of = f"of {counted(self.images, 'image')}"
        consistent = self.images - self.proved - self.false - self.empty
        said = [f"Proved: {self.proved} {of}. {proof_of(self.fit)}"] if self.proved else []
        if consistent > 0:
            reason = "the file holds no proof" if self.proofless else without_proof(self.fit)
            said.append(f"Consistent, not proved: {consistent} {of}; {reason}.")
        if self.false:
            said.append(f"False: {self.false} {of}.")
        if self.empty:
            said.append(f"Without a shape: {self.empty} {of}.")
        return said


def proof_of(fit: Fit) -> str:
    """Say what is proved of an image whose claims all hold."""
    if fit.is_program:
        return "The objective is within the gap stated of the optimum of the convex program."
    if fit.is_global:
        return "No rotation has an objective below `objective * (1 - relative_gap)`."
    return (
        "The dual of the convex program bounds the objective: no shape with one rotation is "
        "better by more than the gap stated."
    )


def without_proof(fit: Fit) -> str:
    """Say why an image has no proof."""
    if fit.is_global:
        return "no tree is stored (`search.proof_every`), and the gap is stated only"
    if fit.has_posterior:
        return (
            f"shapes of {fit.method} have error bars and a verdict, no certificate; that of the "
            "convex program is of the view to start from"
        )
    if fit.solves_program:
        return "the convex program that it starts from is certified, the refinement is not"
    return f"{fit.method} has no certificate"


def run(request: Request) -> Generator[Outcome, None, None]:
    """Verify every image of a result; yields an Outcome per chunk, and the table as the last note.

    Raises InputError where the result is no HDF5 result of `fit`, or does not go with
    the dictionary or the landmarks; for a folder only where that is so of every part.
    """
    parts, wrong, listed = find_parts(request)
    dictionary, tally, digests = read_dictionary(request.dictionary), Tally(), cache(digest)
    yield Outcome(failures=wrong)
    errors: list[InputError] = []
    for part in parts:
        try:
            yield from verify_file(part, request.dictionary, dictionary, tally, digests)
        except InputError as error:
            errors.append(error)
            if len(errors) == len(parts):
                raise InputError(each for one in errors for each in one.problems) from None
            yield Outcome(failures=(unread(part.file, error),))
    missing = max(listed - tally.images, 0)  # in parts that are not there, or were not read
    tally.images, tally.false = tally.images + missing, tally.false + missing
    failures = () if tally.images else (Failure(str(request.result), "holds no image"),)
    yield Outcome(failures=failures, note="\n".join(tally.lines()))


def verify_file(
    part: Part,
    path: Path,
    dictionary: Dictionary,
    tally: Tally,
    digests: Callable[[Path], str],
) -> Generator[Outcome, None, None]:
    """Verify the images of one file, and what it states of them all; `path` of the dictionary."""
    with open_proofs(part.file) as results:
        fit = read_fit(results.head.attributes, part.file)
        fit = replace(fit, depth_is_open=dictionary.depth_is_open)
        head = columns_of(results.head)
        tally.fit, tally.datasets = (
            fit,
            tally.datasets | stored_names(results.head) | set(results.head.attributes),
        )
        tally.datasets |= {"unit", "y_axis"} | (
            {"frame_rate"} if results.head.frame_rate else set()
        )
        tally.proofless |= fit.solves_program and "dual" not in head
        known = dictionary.marked(results.head.landmark_names)
        wrong = false_attributes(results, fit, known, {path: fit.key("dictionary")}, digests)
        missing = [name for name in fit.required if name not in head]
        wrong += [(name, "is missing, and every such fit writes it") for name in missing]
        with open_given(part, results, fit, known, digests) as given:
            yield Outcome(failures=tuple(Failure(*each) for each in [*wrong, *given.wrong]))
            if missing:
                tally.images += results.count
                tally.false += results.count
                return
            tally.settled |= {"landmark_names", "edges", "method", "config", "config_digest"}
            tally.settled |= {"inputs", "metres_from"} | given.compared
            tally.without_landmarks |= of_the_file(head) if given.chunks is None else set()
            model, sizes = (
                make_model(results, head, part.file, path, known, fit, given.joints),
                known,
            )
            check = partial(check_chunk, model=model, dictionary=sizes, fit=fit, head=head)
            chunks = read_chunks(results, model, given.chunks)
            workers = max((os.cpu_count() or 1) - 1, 1)  # one core reads
            for result, checks, proved in side_by_side(check, chunks, workers):
                tally.add(checks, proved)
                failures = tuple(Failure(result.items[i], why) for i, why in checks.reasons())
                yield Outcome(done=len(result), total=results.count, failures=failures)


def open_proofs(file: Path) -> ResultSource:
    """Open a result with its proofs. Raises InputError where it is a table, or not a result."""
    if detect_format(file) is not HDF5:
        found = "is not HDF5, and tables hold points only"
        fix = "give a result that `shapefit fit` wrote to a name in .h5"
        raise input_error(file, found, fix)
    return open_results([file], proofs=True, check=False)


def stored_names(head: ResultSet) -> set[str]:
    """Return the names of what the root of the file holds: datasets and groups."""
    return set(head.datasets) | {name.partition("/")[0] for name in head.further}


def columns_of(result: ResultSet) -> dict[str, Any]:
    """Return the datasets of a result by name, and `y_axis`; points one a column."""
    columns = result.columns | {"y_axis": np.asarray(result.y_axis)}
    for name in AS_ROWS & columns.keys():
        columns[name] = np.ascontiguousarray(columns[name].swapaxes(1, 2))
    return columns


AS_ROWS = {"landmarks", "input_shapes", "input_shape_sd"}
AS_ROWS |= {"shape_correlation", "input_shape_correlation"}
"""Columns of a result that have one point a row in memory, too."""

FROM_LANDMARKS = {
    *("item", "sequence", "landmarks", "confidence", "unit", "y_axis", "frame_rate"),
    *("landmark_map", "input_landmark_names", "removed_distortion"),
}
"""What a result has from the files of landmarks, beside the datasets that it carries."""


def of_the_file(head: Mapping[str, Any]) -> set[str]:
    """Return what a result seems to have from the files of landmarks."""
    return FROM_LANDMARKS | (head.keys() - OF_A_RESULT - {"edges"})


@dataclass(frozen=True)
class PartLandmarks:
    """The landmarks of a part as its fit read them: so many at a time, and what they stand for.

    wrong: what the result states falsely of the files; compared: names of what is compared.
    """

    chunks: Callable[[int], Iterator[LandmarkSet]] | None = None
    joints: Joints | None = None
    wrong: tuple[tuple[str, str], ...] = ()
    compared: frozenset[str] = frozenset()


def make_model(
    results: ResultSource,
    head: Mapping[str, Any],
    file: Path,
    path: Path,
    dictionary: Dictionary,
    fit: Fit,
    joints: Joints | None,
) -> Model:
    """Return what the images were fitted with. Raises InputError for another dictionary."""
    names = results.head.landmark_names
    columns = match_landmarks(dictionary.landmark_names, names, f"{path}: landmark names")
    coefficients = results.head.coefficients
    k = None if coefficients is None else coefficients.shape[1]
    if k is not None and k != dictionary.k:
        found = f"has {counted(dictionary.k, 'atom')}, and {file} coefficients of {k}"
        raise input_error(path, found, "give the dictionary of the fit")
    A, p = np.asarray(head.get("landmark_map", np.eye(len(names)))), len(names)
    depends = dict(zip(dictionary.landmark_names, dictionary.depends_on >= 0, strict=True))
    rows, shown = None, [str(name) for name in head.get("input_landmark_names", ())]
    if shown:
        parts = joints or find_joints(shown, names, in_place=True)
        rows = np.full((len(shown), p), np.nan)
        if set(shown) <= parts.parts.keys():
            rows = parts.rows(shown, fit.key("theta", MEANS))
    if fit.left_out and dictionary.atom_items is None:
        found = f"models were left out (`leave_out: {fit.left_out}`)"
        raise input_error(file, found, "give the dictionary of the fit, whose atoms have items")
    return Model(
        atoms=np.ascontiguousarray(dictionary.atoms[:, :, columns]),
        A=A if A.shape == (p, p) else np.full((p, p), np.nan),
        atom_items=dictionary.atom_items,
        dependent=np.array([fit.has_posterior and depends.get(name, False) for name in names]),
        rows=rows,
    )


Chunk = tuple[ResultSet, LandmarkSet | None]


def read_chunks(
    results: ResultSource, model: Model, given: Callable[[int], Iterator[LandmarkSet]] | None
) -> Iterator[Chunk]:
    """Give out the results, with the landmarks of the same images where they are given."""
    k, _, p = model.atoms.shape
    size = min(max(CHUNK_BYTES // (72 * k + 96 * p), FEWEST), MOST)
    chunks = results.batches(size) if results.count else iter(())
    return (
        ((result, None) for result in chunks)
        if given is None
        else zip(chunks, given(size), strict=False)
    )


def check_chunk(
    chunk: Chunk, model: Model, dictionary: Dictionary, fit: Fit, head: Mapping[str, Any]
) -> tuple[ResultSet, Checks, int]:
    """Check some images; returns how many of them are proved, too."""
    result, images = chunk
    columns = columns_of(result)
    atom = columns.get("transform_atom", np.zeros(0))
    if ((atom < 0) | (atom >= dictionary.k)).any():
        found = f"transforms of atoms that are not among the {dictionary.k}"
        raise input_error("transform_atom", found, "give the dictionary of the fit")
    metres = unit = None
    with np.errstate(all="ignore"):
        if "metres_per_unit" in columns:
            metres = metres_per_unit(result.shapes, dictionary)
        scale, c = dictionary.atom_scale, result.coefficients
        if "position" in columns and scale is not None and c is not None:
            unit = metric_scale(dictionary.atoms, c, scale)
    checks, proved = check_images(columns, result.items, model, fit, metres, unit)
    if images is not None:
        check_landmarks(columns, result, images, checks)
        proved &= ~checks.missed()
    return result, checks, int(proved.sum())


def false_attributes(
    results: ResultSource,
    fit: Fit,
    dictionary: Dictionary,
    files: Mapping[Path, str],
    digests: Callable[[Path], str],
) -> list[tuple[str, str]]:
    """Return what a result states of all its images that is not so, and why."""
    said, wrong = results.head.attributes, list[tuple[str, str]]()
    wrong += [
        (name, "is missing, and every fit writes it")
        for name in ("config_digest", "inputs")
        if name not in said
    ]
    stated = hashlib.sha256(str(said["config"]).encode()).hexdigest()
    if said.get("config_digest", stated) != stated:
        wrong.append(("config", "is not the text with the stored digest"))
    if said.get("method") != fit.method:
        wrong.append(("method", f"is not that of the config, {fit.method}"))
    if results.head.landmark_names != dictionary.landmark_names:
        wrong.append(("landmark_names", "are not those of the dictionary, in its order"))
    by = ("edges" if has_lengths(dictionary) else "spread") if knows_size(dictionary) else ""
    if said.get("metres_from", by) != by:
        wrong.append(("metres_from", f"is not '{by}', by which the dictionary knows sizes"))
    columns = results.head.columns
    if "removed_distortion" in columns and "camera_matrix" not in columns:
        wrong.append(("removed_distortion", "was never removed: there is no `camera_matrix`"))
    edges = dictionary.edges
    if edges is not None and not np.array_equal(results.head.columns.get("edges", edges), edges):
        wrong.append(("edges", "are not those of the dictionary"))
    return wrong + false_digests(files, fit, digests)


def false_digests(
    files: Mapping[Path, str], fit: Fit, digests: Callable[[Path], str]
) -> list[tuple[str, str]]:
    """Return the files that are not those of the fit, which names each with its SHA-256."""
    wrong = []
    for path, name in files.items():
        found, known = digests(path), fit.inputs.get(str(name), STREAM)
        if STREAM not in (found, known) and found != known:
            reason = f"is not the file of the fit, {name}: the digests differ"
            wrong.append((str(path), f"{reason} ({found[:12]}... and {known[:12]}...)"))
    return wrong


@contextmanager
def open_given(
    part: Part,
    results: ResultSource,
    fit: Fit,
    dictionary: Dictionary,
    digests: Callable[[Path], str],
) -> Iterator[PartLandmarks]:
    """Open the landmarks of a part as its fit read them, if they are given.

    Raises InputError where there are not as many images as results.
    """
    if not part.landmarks:
        yield PartLandmarks()
        return
    named = [str(name) for name in fit.key("landmarks", ())]
    wrong = false_digests(dict(zip(part.landmarks, named, strict=False)), fit, digests)
    if part.rows is None and len(part.landmarks) != len(named):
        found = f"the fit had {counted(len(named), 'file')} of landmarks"
        wrong.append((str(part.landmarks[0]), found))
    place = ", ".join(map(str, part.landmarks)) + ": landmark names"
    options, camera = InputOptions(**read_as(fit)), calibrated(fit)
    rows = None if part.rows is None else slice(*part.rows)
    with open_landmarks(part.landmarks, options, rows) as source:
        if source.count != results.count:
            found = f"{counted(source.count, 'image')} for {counted(results.count, 'result')}"
            raise input_error(part.landmarks[0], found, f"give the landmarks of {part.file}")
        known = results.head.landmark_names
        in_place = METHODS[fit.method].has_prior
        joints = find_joints(source.head.landmark_names, known, in_place=in_place)

        def as_fitted(images: LandmarkSet) -> LandmarkSet:
            images = named_as_joints(straightened(images, camera), joints, place)
            return images.arrange(known, place, leave_out=True)

        head = as_fitted(source.head)
        wrong += false_head(results, head, fit)
        wrong += false_joints(results.head.columns, joints, dictionary, fit)
        yield PartLandmarks(
            lambda size: map(as_fitted, source.batches(size)),
            joints,
            tuple(wrong),
            frozenset(FROM_LANDMARKS | carried_by(head).keys()),
        )


def read_as(fit: Fit) -> dict[str, Any]:
    """Return how the fit read its landmarks; detections became sequences where it needed those."""
    default = "nearest" if fit.method == "sequences" else "none"
    return dict(fit.key("input", {})) | {"track": fit.key("input.track") or default}


def calibrated(fit: Fit) -> CalibratedCamera | None:
    """Return the camera of the calibration that the config names. Raises InputError."""
    path = fit.key("camera.calibration")
    return None if path is None else read_camera(Path(path), fit.key("camera.name"))


def carried_by(images: LandmarkSet) -> dict[str, Any]:
    """Return the datasets that a fit carries from landmarks into its result, as it names them."""
    names = free_names(images.further, OF_A_RESULT)
    return {names[name]: values for name, values in images.further.items() if name != "edges"}


def false_head(results: ResultSource, images: LandmarkSet, fit: Fit) -> list[tuple[str, str]]:
    """Return what a result states of all its images otherwise than the landmarks and the config."""
    rate = fit.key("sequences.frame_rate") or images.frame_rate
    pairs = {
        "unit": (results.head.unit, images.unit),
        "y_axis": (results.head.y_axis, images.y_axis),
        "frame_rate": (results.head.frame_rate, rate),
    }
    wrong = [
        (name, f"is {stated}, and that of the landmarks {given}")
        for name, (stated, given) in pairs.items()
        if stated != given
    ]
    stated, carried = results.head, carried_by(images)
    for name, values in carried.items():
        of_file = name.removeprefix("input_") in images.of_file or name in images.of_file
        if of_file and not np.array_equal(np.asarray(stated.columns.get(name)), np.asarray(values)):
            wrong.append((name, "is not that of the landmarks"))
    if "removed_distortion" in stated.columns and "removed_distortion" not in carried:
        found = "was never there: neither the landmarks nor a calibration state a distortion"
        wrong.append(("removed_distortion", found))
    return wrong


def false_joints(
    stated: Mapping[str, Any], joints: Joints, dictionary: Dictionary, fit: Fit
) -> list[tuple[str, str]]:
    """Return what a result states falsely of how landmarks of the files stand for joints."""
    maps = fit.has_posterior and bool(joints.markers or (dictionary.depends_on >= 0).any())
    names = tuple(joints.parts) if maps else ()
    theta = fit.key("theta", MEANS)
    wrong = []
    if tuple(map(str, stated.get("input_landmark_names", ()))) != names:
        found = "are not the landmarks of the files that mark joints"
        wrong.append(("input_landmark_names", found))
    A = joints.matrix(theta) if names else np.eye(len(dictionary.landmark_names))
    given = np.asarray(stated.get("landmark_map", np.eye(len(A))))
    if given.shape != A.shape or not (np.abs(given - A) <= 1e-9).all():
        wrong.append(("landmark_map", "is not where the landmarks of the files lie"))
    return wrong


def check_landmarks(
    columns: Mapping[str, Any], result: ResultSet, images: LandmarkSet, checks: Checks
) -> None:
    """Check that n results have the landmarks of a file, and all that came with these."""
    n, everyone = len(result), np.ones(len(result), dtype=bool)
    expected = np.where(images.seen()[:, None], images.landmarks, np.nan)
    allowed = 0.0
    if "removed_distortion" in images.columns:
        allowed = STRAIGHT * np.nanmax(np.abs(expected), initial=1.0)
    off = np.abs(columns["landmarks"] - expected)
    off = np.where(np.isnan(columns["landmarks"]) & np.isnan(expected), 0.0, off)
    checks.add("landmarks are those of the file", off, allowed, of=everyone)
    pairs: dict[str, tuple[Any, Any]] = {"item": (result.items, images.items)}
    if result.sequences is not None or images.sequences is not None:
        pairs["sequence"] = (result.sequences or [""] * n, images.sequences or [""] * n)
    if images.confidence is not None or "confidence" in columns:
        none = np.ones((n, len(result.landmark_names)))
        given = none if images.confidence is None else images.confidence
        pairs["confidence"] = columns.get("confidence"), given
    carried = carried_by(images).items()
    pairs |= {n: (columns.get(n), values) for n, values in carried if n not in images.of_file}
    for name, (stated, given) in pairs.items():
        checks.hold(f"{name} is that of the file", equal(stated, given, n), of=everyone)


def equal(stated: Any, given: Any, n: int) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Whether the rows (n,) of two datasets are equal, nan where the other is."""
    if stated is None or np.shape(stated) != np.shape(given):
        return np.zeros(n, dtype=bool)
    a, b = np.asarray(stated), np.asarray(given)
    if a.dtype.kind in "biufc" and b.dtype.kind in "biufc":
        same = (a == b) | (np.isnan(a) & np.isnan(b))
    else:
        same = a.astype(str) == b.astype(str)
    return np.asarray(same.reshape(n, -1).all(axis=1))


def find_parts(request: Request) -> tuple[list[Part], tuple[Failure, ...], int]:
    """Return the files of a result, what is false in its manifest, and how many images it lists."""
    result = request.result
    if result.is_file() or not (isinstance(result, UrlPath) or result.is_dir()):
        return [Part(result, request.landmarks)], (), 0
    manifest = read_manifest(result)
    if manifest is None:
        raise input_error(result, "is a folder without results", "name a result in it")
    try:
        done = {str(name): entry for name, entry in manifest.done.items()}
        inputs = [tuple(map(str, entry["inputs"])) for entry in done.values()]
        rows = [entry["rows"] and tuple(map(int, entry["rows"])) for entry in done.values()]
        images = sum(int(entry["images"]) for entry in done.values())
        stated = {name: (int(entry["bytes"]), entry["digest"]) for name, entry in done.items()}
    except (KeyError, TypeError, ValueError) as error:
        found = f"is not a manifest of results ({type(error).__name__}: {error})"
        raise input_error(manifest.path, found, "fit again") from None
    there = files_in(result)
    wrong = [] if done else [Failure("manifest", "lists no part")]
    for name, (size, own) in stated.items():
        if there.get(name) != size:
            why = f"is not there as the manifest states it, with {size} bytes"
        elif own not in (None, result_digest(result / name)):
            why = "is not the file that `fit` wrote, by its digest"
        else:
            continue
        wrong.append(Failure(name, why))
    strange = sorted(name for name in there.keys() - done if name.startswith("part-"))
    wrong += [Failure(name, "is not in the manifest") for name in strange]
    groups = group_inputs(request.landmarks, AS_THEY_ARE) if request.landmarks else []
    given = iter([path for _, paths in groups for path in paths])
    own = {each: tuple(islice(given, len(each))) for each in dict.fromkeys(inputs)}
    parts = [
        Part(result / name, own[each] if groups else (), part)
        for name, each, part in zip(done, inputs, rows, strict=True)
        if name in there
    ]
    return parts, tuple(wrong), images
