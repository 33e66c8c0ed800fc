"""`verify`: a result in, every claim of it that does not hold out.

Recomputed of each image: the certificate of the convex program, where the method has
one. Compared of each image: landmarks with those of the file, where it is given, and
numbers with their ranges; of each file: the digest of all that it holds, those of what
it was made of, and the datasets of its method; of a folder: its parts with its
manifest, and with each other. Nothing that a result names is opened.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
from itertools import repeat
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from shapefit.arrays import Flags
from shapefit.dictionary.model import Dictionary
from shapefit.errors import InputError, counted, input_error, parse_json
from shapefit.geometry.pinhole import CAMERA_MATRIX
from shapefit.io import (
    digest,
    match_landmarks,
    open_landmarks,
    read_dictionary,
)
from shapefit.io.arrange import arrange
from shapefit.io.hdf5_file import Seal, read_seal
from shapefit.io.options import input_options
from shapefit.io.source import open_results
from shapefit.lifting.methods import METHODS, ROBUST
from shapefit.pipelines.fit.camera import DISTORTION, REMOVED, remove_distortion
from shapefit.pipelines.joints import find_joints, rename_to_joints
from shapefit.pipelines.result import Failure, Numbers, Result, unreadable_file
from shapefit.records import Fit, Landmarks
from shapefit.records.columns import in_columns, present_columns
from shapefit.threads import map_ahead
from shapefit.timeline import parse_frame_range
from shapefit.verification import certificate
from shapefit.verification.certificate import CertifiedProgram, Claims, Numeric

if TYPE_CHECKING:  # pydantic takes long to import, and only folders need it
    from shapefit.config.manifest import PartLine
    from shapefit.pipelines.partition.manifest import Manifest

IMAGES_CHECKED_AT_ONCE = 2048
"""Images that are checked together."""

UNDISTORTED_WITHIN = 1e-8
"""Share of the largest coordinate by which landmarks without the distortion of a lens
may be off.
"""

FIT_COLUMNS = "shapes landmarks lambda scale translation rotation status objective"
"""Datasets that every fit writes."""

PRIOR_COLUMNS = "shape_sd shape_correlation p_value inlier_probability trusted reasons"
"""Datasets that fits with a prior write."""

CERTIFIED_METHODS = ("convex", "convex+refine")
"""Methods with a certificate."""

RESULT_OF_FIT = "give a result that `shapefit fit` wrote to a name in .h5"
"""What to do about a file that is none."""


class Request(NamedTuple):
    """A result to verify, the dictionary of its fit and, if given, the landmarks."""

    result: Path
    dictionary: Path
    landmarks: tuple[Path, ...] = ()


class ResultFile(NamedTuple):
    """A file of results, and its line in a manifest, None without one."""

    file: Path
    line: PartLine | None = None


class CheckedBatch(NamedTuple):
    """A batch that was checked: claims, which images are certified, largest gap."""

    result: Fit
    claims: Claims
    certified: Flags
    gap: float


@dataclass
class VerifyTally:
    """Counts over all files."""

    images: int = 0
    """Images that were checked."""

    certified: int = 0
    """Images that are certified."""

    false: int = 0
    """Images with a false claim."""

    empty: int = 0
    """Images without a shape."""

    sealed: int = 0
    """Images in files whose contents are as `fit` wrote them, by their digest."""

    files: int = 0
    """Claims of whole files that are false."""

    unread: int = 0
    """Images that could not be checked."""

    not_sealed: int = 0
    """Files without a digest of their contents."""

    largest_gap: float = 0.0
    """That was certified."""


class Statement(NamedTuple):
    """What a result states of its fit: the config, and the digests of files.

    certified: its method has a certificate, and it is stored.
    """

    config: Mapping[str, Any]
    digests: Mapping[str, str]
    certified: bool


def verify_results(request: Request) -> Generator[Result, None, None]:
    """Verify every image of a result; yields a Result per chunk, then the summary.

    Raises InputError where the result is no HDF5 result of `fit`, or does not go with
    the dictionary or the landmarks; for a folder only where that is so of every part.
    """
    files, wrong, listed = find_files(request.result)
    dictionary = read_dictionary(request.dictionary)
    tally = VerifyTally(files=len(wrong))
    yield Result(failures=tuple(wrong))
    fits: list[Statement] = []
    errors: list[InputError] = []
    digest_of = cache(digest)
    for part in files:
        try:
            yield from verify_file(part, request, dictionary, tally, fits, digest_of)
        except InputError as error:
            errors.append(error)
            if len(errors) == len(files):
                problems = [problem for one in errors for problem in one.problems]
                raise InputError(problems) from None
            tally.files += 1
            yield Result(failures=(unreadable_file(part.file, error),))
    tally.unread = max(listed - tally.images, tally.unread)
    methods = [*dict.fromkeys(fit.config["method"] for fit in fits)]
    data = {**vars(tally), "methods": methods, "landmarks": bool(request.landmarks)}
    has_gap = any(fit.certified for fit in fits)
    numbers = Numbers(
        images=tally.images + tally.unread,
        largest_gap=tally.largest_gap if has_gap else None,
    )
    if tally.images + tally.unread:
        note = "\n".join(summary_lines(tally, fits[0], bool(request.landmarks)))
        yield Result(note=note, numbers=numbers, data=lambda: data)
    else:
        none = (Failure(str(request.result), "holds no image"),)
        yield Result(failures=none, note="No image was checked.", data=lambda: data)


def find_files(result: Path) -> tuple[list[ResultFile], list[Failure], int]:
    """Return the files of a result, faults of its manifest, and the number of images.

    It is the number that the manifest lists, 0 for a single file. Raises InputError for
    a folder without a manifest.
    """
    if not result.is_dir():
        return [ResultFile(result)], [], 0
    from shapefit.config.manifest import part_name
    from shapefit.pipelines.partition.manifest import PARTS_PATTERN, read_manifest

    manifest = read_manifest(result)
    if manifest is None:
        raise input_error(result, "is a folder without results", "name a result in it")
    there = {path.name for path in result.glob(PARTS_PATTERN)}
    unlisted = there - manifest.done.keys()
    wrong = [Failure(name, "is not in the manifest") for name in sorted(unlisted)]
    planned = set(map(part_name, manifest.run.parts)) - manifest.parts.keys()
    reason = "has no result: run `fit` again, which did not end"
    wrong += [Failure(name, reason) for name in sorted(planned - unlisted)]
    wrong += find_overlaps(manifest)
    files = []
    for name, line in manifest.done.items():
        file = result / name
        if file.is_file():
            files.append(ResultFile(file, line))
        if not file.is_file() or line.bytes != file.stat().st_size:
            wrong.append(Failure(name, "is not the file that `fit` wrote, by its size"))
    return files, wrong, sum(line.images for line in manifest.done.values())


def find_overlaps(manifest: Manifest) -> Iterator[Failure]:
    """Yield a failure for each part that shares rows with another, or skips rows."""
    of_inputs: dict[tuple[str, ...], list[PartLine]] = {}
    for line in manifest.parts.values():
        of_inputs.setdefault(line.inputs, []).append(line)
    for lines in of_inputs.values():
        if len(lines) == 1 and lines[0].rows is None:
            continue
        end = 0
        for line in sorted(lines, key=lambda line: line.rows or (0, 0)):
            first, stop = line.rows or (0, end + 1)
            if first < end:
                yield Failure(
                    line.file, "has images of its input that another part has"
                )
            elif first > end:
                fault = f"begins at row {first} of its input, and no part has row {end}"
                yield Failure(line.file, fault)
            end = max(end, stop)


def verify_file(
    part: ResultFile,
    request: Request,
    dictionary: Dictionary,
    tally: VerifyTally,
    fits: list[Statement],
    digest_of: Callable[[Path], str],
) -> Generator[Result, None, None]:
    """Verify one file; yields a Result per chunk, and adds to `tally` and `fits`.

    Raises InputError where the file cannot be verified.
    """
    with open_results([part.file], (), head=True) as results:
        head = results.head
        fit = parse_statement(head.attributes, part.file)
        fits.append(fit)
        seal = read_seal(part.file)
        missing = sorted(required_datasets(fit, head) - head.column_names())
        wrong = [
            Failure(name, "is missing, and every such fit writes it")
            for name in missing
        ]
        wrong += check_config(head.attributes)
        wrong += check_seal(part, seal, fit, results.count)
        files, differing = match_files(part, fit, request, digest_of)
        wrong += differing
        tally.files += len(wrong)
        if seal.found == seal.stated:
            tally.sealed += results.count
        if not seal.stated:
            tally.not_sealed += 1
        yield Result(failures=tuple(wrong))
        if missing:
            tally.unread += results.count
            return
        program = certified_program(
            head, part.file, request.dictionary, dictionary, fit
        )
        rows = result_rows(part, seal)
        with open_images(part.file, rows, head, fit, files, results.count) as images:
            batches: Iterator[Fit] = iter(())
            if results.count:
                batches = results.batches(IMAGES_CHECKED_AT_ONCE)
            pairs = zip(batches, images, strict=False)
            for chunk in map_ahead(
                lambda pair: check_chunk(*pair, program, fit.certified), pairs, 1
            ):
                yield add_to_tally(tally, chunk)._replace(total=results.count)


def add_to_tally(tally: VerifyTally, chunk: CheckedBatch) -> Result:
    """Add a checked batch to the tally, and return its images and failures."""
    claims = chunk.claims
    items = chunk.result.items
    tally.images += len(items)
    tally.certified += int(chunk.certified.sum())
    tally.false += len(claims.reasons)
    tally.empty += int((~claims.fitted).sum())
    tally.largest_gap = max(tally.largest_gap, chunk.gap)
    failures = [
        Failure(items[image], reason)
        for image, reason in sorted(claims.reasons.items())
    ]
    return Result(done=len(items), failures=tuple(failures))


def check_config(attributes: Mapping[str, object]) -> Iterator[Failure]:
    """Yield a failure where the stored config does not have its stored digest."""
    config = str(attributes["config"]).encode()
    if hashlib.sha256(config).hexdigest() != attributes.get("config_digest"):
        yield Failure("config", "is not that of the fit, by its digest")


def check_seal(
    part: ResultFile, seal: Seal, fit: Statement, count: int
) -> Iterator[Failure]:
    """Yield failures where a file differs from its own digest or from its manifest.

    count is the number of images that the file holds.
    """
    name = part.file.name
    if seal.stated and seal.stated != seal.found:
        fault = "its contents are not those that `fit` wrote, by their digest"
        yield Failure(f"{name}: contents", fault)
    elif part.line is not None and seal.stated != part.line.digest:
        fault = "is not the result that the manifest lists, by its digest"
        yield Failure(f"{name}: contents", fault)
    rows = result_rows(part, seal)
    if rows is not None and rows.stop - rows.start != count:
        fault = f"states {counted(rows.stop - rows.start, 'image')}, and holds {count}"
        yield Failure(f"{name}: rows", fault)
    if part.line is None:
        return
    if part.line.images != count:
        fault = f"holds {counted(count, 'image')}, and its manifest {part.line.images}"
        yield Failure(f"{name}: images", fault)
    made_of = (tuple(fit.config["landmarks"]), seal.rows)
    if seal.stated and made_of != (part.line.inputs, part.line.rows):
        fault = "is of other images than the manifest says"
        yield Failure(f"{name}: inputs", fault)


def result_rows(part: ResultFile, seal: Seal) -> slice | None:
    """Return the rows of its input that a part has, None for all."""
    rows = seal.rows if part.line is None else part.line.rows
    return None if rows is None else slice(*rows)


def parse_statement(attributes: Mapping[str, object], file: Path) -> Statement:
    """Parse the attributes `config` and `inputs` of a result.

    Raises InputError where they are not those of a fit.
    """
    try:
        config = parse_json(attributes.get("config", "{}"))
        inputs = parse_json(attributes.get("inputs", "{}"))
        beta = config["outlier_threshold"]
        config |= {
            "dictionary": str(config["dictionary"]),
            "landmarks": [*map(str, config["landmarks"])],
            "outliers": str(config["outliers"]),
            "outlier_threshold": 0.1 if beta is None else float(beta),
            "tolerance": float(config["tolerance"]),
        }
        has_certificate = config["method"] in CERTIFIED_METHODS
        is_stored = config["save"]["proof"] is not False
        if config["method"] not in METHODS:
            raise ValueError(f"no method {config['method']}")
        digests = {name: str(text) for name, text in inputs.items()}
        return Statement(config, digests, has_certificate and is_stored)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        wrong = f"{type(error).__name__}: {error}"
        fault = (
            "its attributes `config` and `inputs` are not those of a fit"
            f" ({wrong[:200]})"
        )
        raise input_error(file, fault, RESULT_OF_FIT) from None


def required_datasets(fit: Statement, head: Fit) -> set[str]:
    """Return the names of the datasets that every fit by this method writes."""
    name = fit.config["method"]
    names = set(FIT_COLUMNS.split())
    if METHODS[name].needs_prior:
        names.update(PRIOR_COLUMNS.split())
    if METHODS[name].mixes_atoms:
        names.add("coefficients")
    if fit.config.get("leave_one_out") is not None:
        names.add("omitted")
    if fit.certified:
        is_perspective = head.focal is not None
        is_program_itself = name == "convex" and not is_perspective
        prefix = "" if is_program_itself else "convex_"
        names.update(certificate.CERTIFICATE.split())
        names.update((f"{prefix}objective", f"{prefix}relative_gap"))
        if not is_perspective and fit.config["outliers"] not in ROBUST:
            names.add("relative_gap")
    return names


def match_files(
    part: ResultFile,
    fit: Statement,
    request: Request,
    digest_of: Callable[[Path], str],
) -> tuple[list[Path], list[Failure]]:
    """Return the landmark files that a part was fitted to, and failures of digests.

    There are no files where not all are given. A file is recognised by the digest that
    the fit states, else by its name, or it is the only one.
    """
    candidates = {fit.config["dictionary"]: [request.dictionary]}
    inputs = fit.config["landmarks"] if part.line is None else part.line.inputs
    files = request.landmarks
    for name in inputs:
        matching = [path for path in files if digest_of(path) == fit.digests.get(name)]
        matching += [path for path in files if path.resolve().name == Path(name).name]
        if not matching and len(inputs) == len(files) == 1:
            matching = [*files]
        candidates[name] = matching
    wrong = []
    for name, paths in candidates.items():
        path = paths[0] if paths else None
        stated = fit.digests.get(name)
        if stated is None:
            wrong.append(Failure(name, "has no digest"))
        elif path is None and files:
            wrong.append(
                Failure(name, "is a file of the fit that is not given by --landmarks")
            )
        elif path is not None and stated not in ("stream", digest_of(path)):
            reason = (
                f"is not the file of the fit, {name}: the digests differ"
                f" ({digest_of(path)[:12]}... and {stated[:12]}...)"
            )
            wrong.append(Failure(str(path), reason))
    _, *landmarks = candidates.values()
    if not all(landmarks):
        return [], wrong
    return [paths[0] for paths in landmarks], wrong


def certified_program(
    head: Fit, file: Path, path: Path, dictionary: Dictionary, fit: Statement
) -> CertifiedProgram:
    """Return the convex program that a fit solved, by its config and its dictionary.

    file is the result, path the dictionary. Raises InputError for another dictionary
    than that of the fit.
    """
    names = f"{path}: landmark names"
    columns = match_landmarks(dictionary.landmark_names, head.landmark_names, names)
    k = dictionary.k if head.coefficients is None else head.coefficients.shape[1]
    omits = fit.config.get("leave_one_out") is not None
    if k != dictionary.k or (omits and dictionary.atom_items is None):
        fault = f"has {counted(dictionary.k, 'atom')}, and {file} coefficients of {k}"
        raise input_error(
            path, fault, "give the dictionary of the fit, whose atoms have items"
        )
    outliers = fit.config["outliers"]
    is_perspective = head.focal is not None
    return CertifiedProgram(
        atoms=np.ascontiguousarray(dictionary.atoms[:, :, columns]),
        atom_items=dictionary.atom_items if omits else None,
        refined=is_perspective or fit.config["method"] != "convex",
        has_bound=not is_perspective and outliers not in ROBUST,
        hides_outliers=outliers not in ("none", *ROBUST),
        loss=outliers if outliers in ROBUST else "squared",
        beta=fit.config["outlier_threshold"],
        tolerance=fit.config["tolerance"],
    )


@contextmanager
def open_images(
    file: Path,
    rows: slice | None,
    head: Fit,
    fit: Statement,
    files: Sequence[Path],
    count: int,
) -> Iterator[Iterator[Landmarks | None]]:
    """Open the landmark files of a fit; gives its images batch by batch.

    Without `files` each batch is None. Raises InputError where these do not have
    `count` images.
    """
    if not files:
        yield repeat(None)
        return
    from shapefit.config.commands.input import LandmarksConfig

    place = f"{', '.join(map(str, files))}: landmark names"
    method = METHODS[fit.config["method"]]
    keys = LandmarksConfig.model_fields.keys() & fit.config.keys() - {"data"}
    try:
        reading = LandmarksConfig(**{key: fit.config[key] for key in keys})
        camera = fit.config.get("camera") or {}
        is_calibrated = camera.get("calibration") is not None
        frames = parse_frame_range(fit.config.get("frames"))
        every = int(fit.config.get("every", 1))
    except (ValueError, AttributeError):
        fault = "does not state how its landmarks were read"
        raise input_error(file, fault, RESULT_OF_FIT) from None
    # Without identity over frames detections are no motion.
    options = input_options(reading, "motion" if method.takes_sequences else "none")
    options = replace(options, frames=frames, every=every)
    with open_landmarks(files, options, rows) as source:
        names = source.head.landmark_names
        joints = find_joints(names, head.landmark_names, in_place=method.needs_prior)
        if source.count != count:
            fault = f"{counted(source.count, 'image')} for {counted(count, 'result')}"
            raise input_error(files[0], fault, f"give the landmarks of {file}")

        def as_fitted(images: Landmarks) -> Landmarks:
            """Return images as `fit` lifts them: undistorted, landmarks as joints."""
            matrix = head.column(CAMERA_MATRIX)
            removed = head.column(REMOVED)
            if is_calibrated and matrix is not None and removed is not None:
                lens = {CAMERA_MATRIX: matrix, DISTORTION: removed}
                images = images.with_file_extras(lens)
            images = rename_to_joints(remove_distortion(images, None), joints, place)
            return arrange(images, head.landmark_names, place, omit=True)

        yield map(as_fitted, source.batches(IMAGES_CHECKED_AT_ONCE))


def check_chunk(
    result: Fit,
    images: Landmarks | None,
    program: CertifiedProgram,
    certified: bool,
) -> CheckedBatch:
    """Check the claims of a batch of results, also against its images if given."""
    columns = claimed_columns(result)
    has_scale = np.isfinite(columns["scale"])
    claims = Claims(has_scale & np.isfinite(columns["shapes"]).all(axis=(1, 2)))
    is_bounded = np.zeros_like(claims.fitted)
    gaps = np.zeros(len(result))
    with np.errstate(all="ignore"):  # what is not finite holds for nothing
        certificate.check_ranges(columns, claims)
        if certified:
            is_bounded = certificate.check_certificate(columns, program, claims)
            gaps = certificate.stated_gap(columns, program)
        if images is not None:
            check_landmarks(columns, result, images, claims)
    is_certified = np.asarray(is_bounded & ~claims.missed)
    largest_gap = float(np.max(gaps[is_certified], initial=0.0))
    return CheckedBatch(result, claims, is_certified, largest_gap)


def claimed_columns(result: Fit) -> dict[str, Numeric]:
    """Return name -> values of the columns of a result, points as (..., 3, p)."""
    columns: dict[str, Numeric] = dict(result.extras)
    for column, value in present_columns(result):
        values = np.asarray(value)
        columns[column.name] = in_columns(values) if column.has_points else values
    return columns


def check_landmarks(
    columns: Mapping[str, Numeric], result: Fit, images: Landmarks, claims: Claims
) -> None:
    """Check that results have the landmarks, confidences and items of a file.

    Images for which that is false get a reason in `claims`.
    """
    everyone = np.ones_like(claims.fitted)
    visible = images.visible()
    in_file = np.where(visible[:, None], images.as_columns(), np.nan)
    stated = columns["landmarks"]
    both_hidden = np.isnan(stated) & np.isnan(in_file)
    off = np.where(both_hidden, 0.0, np.abs(stated - in_file))
    allowed = 0.0
    if images.column(REMOVED) is not None:
        allowed = UNDISTORTED_WITHIN * np.nanmax(np.abs(in_file), initial=1.0)
    claims.near("landmarks are those of the file", off, allowed, where=everyone)
    confidence = images.weights() if images.confidence is None else images.confidence
    same = np.equal(columns.get("confidence", 1.0), confidence) | ~visible
    claims.hold("confidences are those of the file", same, where=everyone)
    same = np.array(result.items, object) == np.array(images.items, object)
    claims.hold("items are those of the file", same, where=everyone)


def summary_lines(
    tally: VerifyTally, fit: Statement, with_landmarks: bool
) -> Iterator[str]:
    """Yield lines of text: what was recomputed and compared, and what is false."""
    method = fit.config["method"]
    total = f"of {counted(tally.images + tally.unread, 'image')}"
    yield f"Method     {method}"
    yield f"Certified  {tally.certified} {total}: {_describe_certified(tally, fit)}"
    yield f"Sealed     {tally.sealed} {total}: {_describe_sealed(tally)}"
    if tally.empty:
        yield f"No shape   {tally.empty} {total}"
    recomputed = "nothing"
    unchecked = "shapes, error bars and all other numbers"
    if fit.certified:
        recomputed = "objective, gap and certificate of the convex program"
        if method == "convex":
            recomputed += "; of its solution the shape"
        unchecked = "numbers that no certificate names"
    compared = "digests, datasets, ranges"
    unread_landmarks = "; landmarks, without --landmarks"
    if with_landmarks:
        compared += "; landmarks with the files"
        unread_landmarks = ""
    yield f"Recomputed {recomputed}"
    yield f"Compared   {compared}"
    yield f"Unchecked  how {unchecked} follow from the landmarks{unread_landmarks}"
    wrong = ""
    if tally.files:
        wrong = f", and {counted(tally.files, 'claim')} of whole files"
    yield f"False      {tally.false + tally.unread} {total}{wrong}"


def _describe_certified(tally: VerifyTally, fit: Statement) -> str:
    """Return a text on what the certificates of a fit prove, or why it has none."""
    if fit.certified:
        return (
            "the convex program is solved to within the gap that is stated,"
            f" {tally.largest_gap:.1g} at most"
        )
    if fit.config["method"] in CERTIFIED_METHODS:
        return "no certificate is stored"
    if fit.config["method"] == "global":
        return (
            "its bound on all rotations is stated, not checked: no file holds the"
            " search that proves it"
        )
    return "has no certificate"


def _describe_sealed(tally: VerifyTally) -> str:
    """Return a text on whether files are as `fit` wrote them, by their digests."""
    if tally.not_sealed:
        return "not sealed: the file has no digest of what it holds"
    if tally.sealed < tally.images + tally.unread:
        return "the others were changed after `fit`"
    return "all that the file holds is as `fit` wrote it, by one digest"
