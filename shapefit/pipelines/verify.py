"""`verify`: a result in, every statement of it that does not hold out.

A claim is proved, consistent with the rest of the file, or false. Proved is an optimum, by its
certificate; all else of an honest file is consistent; what nothing else determines is named.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache, partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from shapefit.arrays import Flags
from shapefit.convex.solver import Status
from shapefit.dictionary.bodies import has_lengths, knows_size, metres_per_unit
from shapefit.dictionary.model import Dictionary
from shapefit.errors import InputError, counted, input_error
from shapefit.geometry.pinhole import CAMERA_MATRIX
from shapefit.io import (
    LandmarkSet,
    ResultSet,
    digest,
    match_landmarks,
    open_landmarks,
    read_dictionary,
)
from shapefit.io.formats import HDF5, detect_format, group_inputs
from shapefit.io.layout import free_names
from shapefit.io.options import AS_THEY_ARE, InputOptions
from shapefit.io.readers.calibration import read_camera
from shapefit.io.source import ResultSource, open_results
from shapefit.lifting.degeneracy import find_degenerate
from shapefit.lifting.lift import lambda_for_noise
from shapefit.lifting.methods import METHODS
from shapefit.lifting.verdict import find_doubts
from shapefit.meshes.dense import metric_scale
from shapefit.pipelines.fit.camera import straightened
from shapefit.pipelines.fit.record import OF_A_RESULT
from shapefit.pipelines.joints import MEANS, Joints, find_joints, named_as_joints
from shapefit.pipelines.outcome import Failure, Outcome, unread
from shapefit.threads import side_by_side
from shapefit.verification.checks import FLOOR, Checks
from shapefit.verification.claims import Model, check_images
from shapefit.verification.fit import LIMITED, Fit, Images, read_fit, seen_in

CHUNK_BYTES = 1 << 24
"""Of the largest arrays of the images that are checked together."""
FEWEST, MOST = 16, 4096
"""Images that are checked together."""
STREAM = "stream"
"""Stands for the digest of what could not be read twice."""
STRAIGHT = 1e-8
"""Of the largest coordinate by which landmarks without the distortion of a lens may be off."""

AS_ROWS = {"landmarks", "input_shapes", "input_shape_sd"}
AS_ROWS |= {"shape_correlation", "input_shape_correlation"}
"""Columns of a result that have one point a row in memory, too."""

OF_A_FILE = {
    "landmark_names",
    "edges",
    "method",
    "config",
    "config_digest",
    "inputs",
    "metres_from",
}
"""What is compared once a file."""
FROM_LANDMARKS = {
    *("item", "sequence", "landmarks", "confidence", "unit", "y_axis", "frame_rate"),
    *("landmark_map", "input_landmark_names", "removed_distortion"),
}
"""What a result has from the files of landmarks, beside the datasets that it carries."""


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
    if detect_format(part.file) is not HDF5:
        fix = "give a result that `shapefit fit` wrote to a name in .h5"
        raise input_error(part.file, "is not HDF5, and tables hold points only", fix)
    with open_results([part.file], proofs=True, check=False) as results:
        fit, head = read_fit(results.head.attributes, part.file), columns_of(results.head)
        known = dictionary.marked(results.head.landmark_names)
        tally.open(fit, results.head)
        missing = fit.missing(head)
        wrong = false_digests({path: str(fit.key("dictionary"))}, fit, digests)
        wrong += false_attributes(results.head, fit, known)
        wrong += [(name, "is missing, and every such fit writes it") for name in missing]
        with open_images(part, results, fit, known, digests) as given:
            yield Outcome(failures=tuple(Failure(*each) for each in [*wrong, *given.wrong]))
            if missing:
                tally.images += results.count
                tally.false += results.count
                return
            tally.settled |= OF_A_FILE | given.compared
            if given.chunks is None:
                tally.without_landmarks |= FROM_LANDMARKS | (head.keys() - OF_A_RESULT - {"edges"})
            model = make_model(results, head, part.file, path, known, fit, given.joints)
            k, _, p = model.atoms.shape
            size = min(max(CHUNK_BYTES // (72 * k + 96 * p), FEWEST), MOST)
            chunks = results.batches(size) if results.count else iter(())
            images = iter(lambda: None, 0) if given.chunks is None else given.chunks(size)
            check = partial(check_chunk, model=model, dictionary=known, fit=fit)
            workers = max((os.cpu_count() or 1) - 1, 1)  # one core reads
            for result, checks, proved in side_by_side(
                check, zip(chunks, images, strict=False), workers
            ):
                tally.add(checks, proved)
                failures = tuple(Failure(result.items[i], why) for i, why in checks.reasons())
                yield Outcome(done=len(result), total=results.count, failures=failures)


def check_chunk(
    chunk: tuple[ResultSet, LandmarkSet | None], model: Model, dictionary: Dictionary, fit: Fit
) -> tuple[ResultSet, Checks, Flags]:
    """Check some images, with their landmarks if given; returns which are proved (n,), too."""
    result, given = chunk
    columns = columns_of(result)
    atom = columns.get("transform_atom", np.zeros(0))
    if ((atom < 0) | (atom >= dictionary.k)).any():
        found = f"transforms of atoms that are not among the {dictionary.k}"
        raise input_error("transform_atom", found, "give the dictionary of the fit")
    with np.errstate(all="ignore"):  # what is not finite holds for nothing
        checks, images, proved = check_images(columns, result.items, model, fit)
        check_by_rules(images, model, dictionary, checks)
        if given is not None:
            check_landmarks(columns, result, given, checks)
    return result, checks, proved & checks.fitted & ~checks.missed()


def check_by_rules(images: Images, model: Model, dictionary: Dictionary, checks: Checks) -> None:
    """Check what rules of `fit` decide: lambda, no shape, the verdict, sizes in metres."""
    columns, fit, fitted = images.columns, images.fit, images.fitted
    seen, everyone = seen_in(columns), np.ones_like(fitted)
    if fit.key("lambda") == "auto" and fit.loss != "exact" and not fit.left_out:
        share = (images.weights > 0).mean(axis=1)
        found = lambda_for_noise(model.seen, fit.key("noise", 0.0), images.size, share)
        checks.equal("lambda", "the noise", found, images.allow(3 * found, found))
    some = np.flatnonzero(~fitted)
    reasons = find_degenerate(
        columns["landmarks"][some], (seen & ~model.dependent)[some].astype(float)
    )
    degenerate = np.isin(np.arange(len(fitted)), some[list(reasons)])
    checks.hold("an image without a shape has degenerate landmarks", degenerate, of=~fitted)
    if fit.has_posterior and {"trusted", "reasons"} <= columns.keys():
        limited = columns["status"].astype(str) == LIMITED
        causes = find_doubts(
            *(columns["shapes"], columns["shape_sd"], seen, columns["p_value"]),
            [Status.ITERATION_LIMIT if each else Status.OPTIMAL for each in limited],
            implausible=fit.key("posterior.implausible", 0.0),
            depth_ambiguity=dictionary.depth_ambiguity,
        )
        right = (columns["reasons"] == causes) & (columns["trusted"] == (causes == ""))
        checks.hold("trusted and reasons follow from bars", right, "trusted reasons", everyone)
    if "metres_per_unit" in columns:
        stated, metres = columns["metres_per_unit"], metres_per_unit(columns["shapes"], dictionary)
        metres = np.full(len(fitted), np.nan) if metres is None else metres
        off = np.where(np.isnan(stated) & np.isnan(metres), 0.0, np.abs(stated - metres))
        claim = "metres_per_unit follows from the shapes"
        checks.add(claim, off, FLOOR * np.nan_to_num(metres), "metres_per_unit")
    if "position" in columns and dictionary.atom_scale is not None and "coefficients" in columns:
        unit = metric_scale(dictionary.atoms, columns["coefficients"], dictionary.atom_scale)
        found = unit[:, None] * columns["camera_translation"]
        allowed = FLOOR * np.abs(found).max(axis=1)
        checks.equal("position", "the camera_translation", found, allowed)


def check_landmarks(
    columns: Mapping[str, Any], result: ResultSet, images: LandmarkSet, checks: Checks
) -> None:
    """Check that n results have the landmarks of a file, and all that came with these."""
    n, everyone = len(result), np.ones(len(result), dtype=bool)
    found, stated = np.where(images.seen()[:, None], images.landmarks, np.nan), columns["landmarks"]
    removed = "removed_distortion" in images.columns
    allowed = STRAIGHT * np.nanmax(np.abs(found), initial=1.0) if removed else 0.0
    off = np.where(np.isnan(stated) & np.isnan(found), 0.0, np.abs(stated - found))
    checks.add("landmarks are those of the file", off, allowed, of=everyone)
    pairs: dict[str, tuple[Any, Any]] = {"item": (result.items, images.items)}
    if result.sequences is not None or images.sequences is not None:
        pairs["sequence"] = (result.sequences or [""] * n, images.sequences or [""] * n)
    if images.confidence is not None or "confidence" in columns:
        none = np.ones((n, len(result.landmark_names)))
        given = none if images.confidence is None else images.confidence
        pairs["confidence"] = columns.get("confidence"), given
    carried = carried_by(images).items()
    pairs |= {n: (columns.get(n), values) for n, values in carried if n not in images.whole}
    for name, (own, given) in pairs.items():
        checks.hold(f"{name} is that of the file", equal(own, given, n), of=everyone)


def equal(stated: Any, found: Any, n: int = 1) -> Flags:
    """Whether the rows (n,) of two datasets are equal, nan where the other is."""
    if stated is None or found is None or np.shape(stated) != np.shape(found):
        return np.full(n, stated is None and found is None)
    a, b = np.asarray(stated), np.asarray(found)
    if a.dtype.kind in "biufc" and b.dtype.kind in "biufc":
        same = (a == b) | (np.isnan(a) & np.isnan(b))
    else:
        same = a.astype(str) == b.astype(str)
    return np.asarray(same.reshape(n, -1).all(axis=1))


Wrong = list[tuple[str, str]]
"""What a file states falsely of all its images, and why."""


def differing(pairs: Mapping[str, tuple[Any, Any]], whose: str) -> Wrong:
    """Return the names of which what is stated is not what was found."""
    wrong = {name for name, (stated, found) in pairs.items() if not equal(stated, found).all()}
    return [(name, f"is not that of {whose}") for name in pairs if name in wrong]


def false_attributes(head: ResultSet, fit: Fit, dictionary: Dictionary) -> Wrong:
    """Return what a result states of all its images otherwise than its config and dictionary."""
    said, columns, edges = head.attributes, head.columns, dictionary.edges
    wrong = [
        (name, "is missing, and every fit writes it")
        for name in ("config_digest", "inputs")
        if name not in said
    ]
    text = hashlib.sha256(str(said["config"]).encode()).hexdigest()
    of_config: dict[str, tuple[Any, Any]] = {
        "config": (said.get("config_digest", text), text),
        "method": (said.get("method"), fit.method),
    }
    by = ("edges" if has_lengths(dictionary) else "spread") if knows_size(dictionary) else ""
    of_dictionary = {
        "landmark_names": (head.landmark_names, dictionary.landmark_names),
        "metres_from": (said.get("metres_from", by), by),
        "edges": (columns.get("edges", edges), edges),
    }
    if CAMERA_MATRIX not in columns:
        of_config["removed_distortion"] = columns.get("removed_distortion"), None
    return wrong + differing(of_config, "the config") + differing(of_dictionary, "the dictionary")


def false_digests(files: Mapping[Path, str], fit: Fit, digests: Callable[[Path], str]) -> Wrong:
    """Return the files that are not those of the fit, which names each with its SHA-256."""
    wrong = []
    for path, name in files.items():
        found, known = digests(path), fit.inputs.get(name, STREAM)
        if STREAM not in (found, known) and found != known:
            reason = f"is not the file of the fit, {name}: the digests differ"
            wrong.append((str(path), f"{reason} ({found[:12]}... and {known[:12]}...)"))
    return wrong


@dataclass(frozen=True)
class PartLandmarks:
    """The landmarks of a part as its fit read them: so many at a time, and what they stand for.

    wrong: what the result states falsely of the files; compared: names of what is compared.
    """

    chunks: Callable[[int], Iterator[LandmarkSet]] | None = None
    joints: Joints | None = None
    wrong: Wrong = field(default_factory=list)
    compared: frozenset[str] = frozenset()


@contextmanager
def open_images(
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
    default = "nearest" if fit.method == "sequences" else "none"  # detections become sequences
    options = dict(fit.key("input", {})) | {"track": fit.key("input.track") or default}
    calibration = fit.key("camera.calibration")
    camera = calibration and read_camera(Path(calibration), fit.key("camera.name"))
    rows = None if part.rows is None else slice(*part.rows)
    with open_landmarks(part.landmarks, InputOptions(**options), rows) as source:
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
        wrong += false_head(results.head, head, joints, dictionary, fit)
        compared = frozenset(FROM_LANDMARKS | carried_by(head).keys())
        yield PartLandmarks(
            lambda size: map(as_fitted, source.batches(size)), joints, wrong, compared
        )


def carried_by(images: LandmarkSet) -> dict[str, Any]:
    """Return the datasets that a fit carries from landmarks into its result, as it names them."""
    names = free_names(images.further, OF_A_RESULT)
    return {names[name]: values for name, values in images.further.items() if name != "edges"}


def false_head(
    head: ResultSet, images: LandmarkSet, joints: Joints, dictionary: Dictionary, fit: Fit
) -> Wrong:
    """Return what a result states of all its images otherwise than the landmarks and the config."""
    stated, carried = head.columns, carried_by(images)
    maps = fit.has_posterior and bool(joints.markers or (dictionary.depends_on >= 0).any())
    none = np.eye(len(dictionary.landmark_names))
    A = joints.matrix(fit.key("theta", MEANS)) if maps and joints.parts else none
    pairs: dict[str, tuple[Any, Any]] = {
        "unit": (head.unit, images.unit),
        "y_axis": (head.y_axis, images.y_axis),
        "frame_rate": (head.frame_rate, fit.key("sequences.frame_rate") or images.frame_rate),
        "input_landmark_names": (
            tuple(stated.get("input_landmark_names", ())),
            tuple(joints.parts) if maps else (),
        ),
        "landmark_map": (stated.get("landmark_map", none), A),
    }
    of_file = {name for name in carried if {name, name.removeprefix("input_")} & {*images.whole}}
    for name in of_file | {"removed_distortion"}:
        pairs[name] = stated.get(name), carried.get(name)
    return differing(pairs, "the landmarks")


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
    k = dictionary.k if coefficients is None else coefficients.shape[1]
    if k != dictionary.k:
        found = f"has {counted(dictionary.k, 'atom')}, and {file} coefficients of {k}"
        raise input_error(path, found, "give the dictionary of the fit")
    if fit.left_out and dictionary.atom_items is None:
        found = f"models were left out (`leave_out: {fit.left_out}`)"
        raise input_error(file, found, "give the dictionary of the fit, whose atoms have items")
    A, p = np.asarray(head.get("landmark_map", np.eye(len(names)))), len(names)
    depends = dict(zip(dictionary.landmark_names, dictionary.depends_on >= 0, strict=True))
    rows, shown = None, [str(name) for name in head.get("input_landmark_names", ())]
    if shown:
        parts = joints or find_joints(shown, names, in_place=True)
        known = set(shown) <= parts.parts.keys()
        theta = fit.key("theta", MEANS)
        rows = parts.rows(shown, theta) if known else np.full((len(shown), p), np.nan)
    return Model(
        atoms=np.ascontiguousarray(dictionary.atoms[:, :, columns]),
        A=A if A.shape == (p, p) else np.full((p, p), np.nan),
        atom_items=dictionary.atom_items,
        dependent=np.array([fit.has_posterior and depends.get(name, False) for name in names]),
        rows=rows,
    )


def columns_of(result: ResultSet) -> dict[str, Any]:
    """Return the datasets of a result by name, and `y_axis`; points one a column."""
    columns = result.columns | {"y_axis": np.asarray(result.y_axis)}
    for name in AS_ROWS & columns.keys():
        columns[name] = np.ascontiguousarray(columns[name].swapaxes(1, 2))
    return columns


def find_parts(request: Request) -> tuple[list[Part], tuple[Failure, ...], int]:
    """Return the files of a result, what is false in its manifest, and how many images it lists."""
    result = request.result
    if not result.is_dir():
        return [Part(result, request.landmarks)], (), 0
    from shapefit.pipelines.partition.manifest import read_manifest, result_digest

    manifest = read_manifest(result)
    if manifest is None:
        raise input_error(result, "is a folder without results", "name a result in it")
    try:
        listed = {
            str(name): (tuple(map(str, e["inputs"])), e["rows"] and tuple(map(int, e["rows"])))
            for name, e in manifest.done.items()
        }
        images = sum(int(entry["images"]) for entry in manifest.done.values())
        stated = {name: entry["digest"] for name, entry in manifest.done.items()}
    except (KeyError, TypeError, ValueError) as error:
        found = f"is not a manifest of results ({type(error).__name__}: {error})"
        raise input_error(manifest.path, found, "fit again") from None
    there = {path.name for path in result.iterdir()}
    wrong = [] if listed else [Failure("manifest", "lists no part")]
    for name, own in stated.items():
        if name not in there:
            wrong.append(Failure(name, "is not there, and the manifest lists it"))
        elif own not in (None, result_digest(result / name)):
            wrong.append(Failure(name, "is not the file that `fit` wrote, by its digest"))
    strange = sorted(name for name in there - set(listed) if name.startswith("part-"))
    wrong += [Failure(name, "is not in the manifest") for name in strange]
    groups = group_inputs(request.landmarks, AS_THEY_ARE) if request.landmarks else []
    given = iter([path for _, paths in groups for path in paths])
    own = {inputs: tuple(islice(given, len(inputs))) for inputs, _ in listed.values()}
    parts = [
        Part(result / name, own[inputs], rows)
        for name, (inputs, rows) in listed.items()
        if name in there
    ]
    return parts, tuple(wrong), images


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

    def open(self, fit: Fit, head: ResultSet) -> None:
        """Take in what a file states."""
        self.fit = fit
        self.datasets |= {"unit", "y_axis", *head.attributes, *head.datasets}
        self.datasets |= {name.partition("/")[0] for name in head.further}
        self.datasets |= {"frame_rate"} if head.frame_rate else set()

    def add(self, checks: Checks, proved: Flags) -> None:
        """Take in the checks of some more images."""
        for check in checks.made:
            sums = self.claims.setdefault(check.claim, [0, 0])
            sums[0] += int(check.made.sum())
            sums[1] += int(check.missed.sum())
        self.settled |= checks.settled
        self.images += len(checks.fitted)
        self.proved += int(proved.sum())
        self.false += int(checks.missed().sum())
        self.empty += int((~checks.fitted).sum())

    def lines(self) -> Iterable[str]:
        """Give out the table of claims, what is proved of how many images, what is unchecked."""
        yield from ("| claim | images | false |", "|---|--:|--:|")
        yield from (
            f"| {claim} | {made} | {false} |" for claim, (made, false) in self.claims.items()
        )
        yield ""
        if self.fit is None or not self.images:
            yield "No image was checked: nothing is proved."
        else:
            proof, none = certificate(self.fit)
            of, others = (
                f"of {counted(self.images, 'image')}",
                self.proved + self.false + self.empty,
            )
            if self.proved:
                yield f"Proved: {self.proved} {of}. {proof}"
            if self.images > others:
                yield f"Consistent, not proved: {self.images - others} {of}; {none}."
            if self.false:
                yield f"False: {self.false} {of}."
            if self.empty:
                yield f"Without a shape: {self.empty} {of}."
        unknown, given = (
            self.datasets - self.settled - self.without_landmarks,
            self.without_landmarks,
        )
        left, more = (
            ", ".join(f"`{name}`" for name in sorted(names)) for names in (unknown, given)
        )
        more = f"; without `--landmarks` also not {more}" if more else ""
        yield f"Not checked, or not to the last number: {left or 'nothing'}{more}."


def certificate(fit: Fit) -> tuple[str, str]:
    """Say what is proved of an image whose claims all hold, and why another has no proof."""
    proof = (
        "The dual of the convex program bounds the objective: no shape with one rotation is "
        "better by more than the gap stated."
    )
    none = f"{fit.method} has no certificate"
    if fit.is_global:
        proof = "No rotation has an objective below `objective * (1 - relative_gap)`."
        none = "no tree is stored (`search.proof_every`), and the gap is stated only"
    elif fit.solves_program and not fit.has_proof:
        none = "the file holds no proof"
    elif fit.is_program:
        proof = "The objective is within the gap stated of the optimum of the convex program."
    elif fit.has_posterior:
        none = (
            f"shapes of {fit.method} have error bars and a verdict, no certificate; that of the "
            "convex program is of the view to start from"
        )
    elif fit.solves_program:
        none = "the convex program that it starts from is certified, the refinement is not"
    return proof, none
