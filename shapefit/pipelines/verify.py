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
from dataclasses import dataclass
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
from shapefit.pipelines.fit.camera import DISTORTION, REMOVED, undistorted
from shapefit.pipelines.joints import find_joints, named_as_joints
from shapefit.pipelines.result import Failure, Result, unread
from shapefit.records import Fit, Landmarks
from shapefit.records.columns import held_columns, in_columns
from shapefit.threads import side_by_side
from shapefit.verification import certificate
from shapefit.verification.certificate import CertifiedProgram, Claims

if TYPE_CHECKING:  # pydantic takes long to import, and only folders need it
    from shapefit.config.manifest import PartLine
    from shapefit.pipelines.partition.manifest import Manifest

CHUNK = 2048
"""Images that are checked together."""
UNDISTORTED = 1e-8
"""Of the largest coordinate by which landmarks without the distortion of a lens may be
off.
"""
ALWAYS = "shapes landmarks lambda scale translation rotation status objective"
ERROR_BARS = " shape_sd shape_correlation p_value inlier_probability trusted reasons"
CERTIFIED = ("convex", "convex+refine")
"""Methods with a certificate."""
FIX = "give a result that `shapefit fit` wrote to a name in .h5"


class Request(NamedTuple):
    """A result to verify, the dictionary of its fit and, if given, the landmarks."""

    result: Path
    dictionary: Path
    landmarks: tuple[Path, ...] = ()


class Part(NamedTuple):
    """A file of results, and its line in a manifest, None without one."""

    file: Path
    line: PartLine | None = None


class Checked(NamedTuple):
    """Images that were checked: results and claims; which are certified (n,), and
    their largest gap.
    """

    result: Fit
    claims: Claims
    certified: Flags
    gap: float


@dataclass
class Tally:
    """Counts over all files: images checked, certified, with a false claim, without a
    shape; images in files whose contents are as `fit` wrote them, by their digest;
    claims of whole files that are false; images that could not be checked; files
    without such a digest; and the largest gap that was certified.
    """

    images: int = 0
    certified: int = 0
    false: int = 0
    empty: int = 0
    sealed: int = 0
    files: int = 0
    unread: int = 0
    not_sealed: int = 0
    largest_gap: float = 0.0


class Statement(NamedTuple):
    """What a result states of its fit: the config, and the digests of files.

    certified: its method has a certificate, and it is stored.
    """

    config: Mapping[str, Any]
    digests: Mapping[str, str]
    certified: bool


def run(request: Request) -> Generator[Result, None, None]:
    """Verify every image of a result; yields a Result per chunk, and the summary as the
    last.

    Raises InputError where the result is no HDF5 result of `fit`, or does not go with
    the dictionary or the landmarks; for a folder only where that is so of every part.
    """
    parts, wrong, listed = find_parts(request.result)
    dictionary = read_dictionary(request.dictionary)
    tally = Tally(files=len(wrong))
    yield Result(failures=tuple(wrong))
    fits, errors, digest_of = list[Statement](), list[InputError](), cache(digest)
    for part in parts:
        try:
            yield from verify_part(part, request, dictionary, tally, fits, digest_of)
        except InputError as error:
            errors.append(error)
            if len(errors) == len(parts):
                raise InputError(
                    line for one in errors for line in one.problems
                ) from None
            tally.files += 1
            yield Result(failures=(unread(part.file, error),))
    tally.unread = max(listed - tally.images, tally.unread)
    methods = [*dict.fromkeys(fit.config["method"] for fit in fits)]
    data = {**vars(tally), "methods": methods, "landmarks": bool(request.landmarks)}
    if tally.images + tally.unread:
        note = "\n".join(summary_lines(tally, fits[0], bool(request.landmarks)))
        yield Result(note=note, data=lambda: data)
    else:
        none = (Failure(str(request.result), "holds no image"),)
        yield Result(failures=none, note="No image was checked.", data=lambda: data)


def find_parts(result: Path) -> tuple[list[Part], list[Failure], int]:
    """Return the files of a result, what is false in its manifest, and how many images
    it lists.
    """
    if not result.is_dir():
        return [Part(result)], [], 0
    from shapefit.config.manifest import part_name
    from shapefit.pipelines.partition.manifest import PARTS, read_manifest

    manifest = read_manifest(result)
    if manifest is None:
        raise input_error(result, "is a folder without results", "name a result in it")
    unlisted = {path.name for path in result.glob(PARTS)} - manifest.done.keys()
    wrong = [Failure(name, "is not in the manifest") for name in sorted(unlisted)]
    planned = set(map(part_name, manifest.run.parts)) - manifest.parts.keys()
    reason = "has no result: run `fit` again, which did not end"
    wrong += [Failure(name, reason) for name in sorted(planned - unlisted)]
    wrong += find_overlaps(manifest)
    parts = []
    for name, line in manifest.done.items():
        file = result / name
        if file.is_file():
            parts.append(Part(file, line))
        if not file.is_file() or line.bytes != file.stat().st_size:
            wrong.append(Failure(name, "is not the file that `fit` wrote, by its size"))
    return parts, wrong, sum(line.images for line in manifest.done.values())


def find_overlaps(manifest: Manifest) -> Iterator[Failure]:
    """Yield the parts of a folder that have rows of another one, or leave rows out."""
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


def verify_part(
    part: Part,
    request: Request,
    dictionary: Dictionary,
    tally: Tally,
    fits: list[Statement],
    digest_of: Callable[[Path], str],
) -> Generator[Result, None, None]:
    """Verify the images of one file, and what it states of them all."""
    with open_results([part.file], (), head=True) as results:
        head, attributes = results.head, results.head.attributes
        fit = read_statement(attributes, part.file)
        fits.append(fit)
        seal = read_seal(part.file)
        missing = sorted(required(fit, head) - head.column_names())
        wrong = [
            Failure(name, "is missing, and every such fit writes it")
            for name in missing
        ]
        digest_of_config = hashlib.sha256(
            str(attributes["config"]).encode()
        ).hexdigest()
        if digest_of_config != attributes.get("config_digest"):
            wrong.append(Failure("config", "is not that of the fit, by its digest"))
        wrong += check_seal(part, seal, fit, results.count)
        files, differing = match_files(part, fit, request, digest_of)
        wrong += differing
        tally.files += len(wrong)
        tally.sealed += results.count if seal.found == seal.stated else 0
        tally.not_sealed += not seal.stated
        yield Result(failures=tuple(wrong))
        if missing:
            tally.unread += results.count
            return
        program = read_program(head, part.file, request.dictionary, dictionary, fit)
        rows = rows_of(part, seal)
        with open_images(part.file, rows, head, fit, files, results.count) as images:
            batches = results.batches(CHUNK) if results.count else iter(())
            pairs = zip(batches, images, strict=False)
            for chunk in side_by_side(
                lambda pair: check_chunk(*pair, program, fit.certified), pairs, 1
            ):
                claims, items = chunk.claims, chunk.result.items
                tally.images += len(items)
                tally.certified += int(chunk.certified.sum())
                tally.false += len(claims.reasons)
                tally.empty += int((~claims.fitted).sum())
                tally.largest_gap = max(tally.largest_gap, chunk.gap)
                reasons = sorted(claims.reasons.items())
                failures = tuple(Failure(items[i], why) for i, why in reasons)
                yield Result(done=len(items), total=results.count, failures=failures)


def check_seal(part: Part, seal: Seal, fit: Statement, count: int) -> Iterator[Failure]:
    """Yield what is false of the digest of the contents of a file, and of what its
    manifest says.
    """
    name = part.file.name
    if seal.stated and seal.stated != seal.found:
        fault = "its contents are not those that `fit` wrote, by their digest"
        yield Failure(f"{name}: contents", fault)
    elif part.line is not None and seal.stated != part.line.digest:
        fault = "is not the result that the manifest lists, by its digest"
        yield Failure(f"{name}: contents", fault)
    rows = rows_of(part, seal)
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


def rows_of(part: Part, seal: Seal) -> slice | None:
    """Return the rows of its input that a part has, None for all."""
    rows = seal.rows if part.line is None else part.line.rows
    return None if rows is None else slice(*rows)


def read_statement(attributes: Mapping[str, Any], file: Path) -> Statement:
    """Return what the attributes `config` and `inputs` of a result say.

    Raises InputError where they are not those of a fit.
    """
    try:
        config, digests = (
            parse_json(attributes.get(name, "{}")) for name in ("config", "inputs")
        )
        beta = config["outlier_threshold"]
        config |= {
            "dictionary": str(config["dictionary"]),
            "landmarks": [*map(str, config["landmarks"])],
            "outliers": str(config["outliers"]),
            "outlier_threshold": 0.1 if beta is None else float(beta),
            "tolerance": float(config["tolerance"]),
        }
        certified = (
            config["method"] in CERTIFIED and config["save"]["proof"] is not False
        )
        if config["method"] not in METHODS:
            raise ValueError(f"no method {config['method']}")
        return Statement(
            config, {name: str(text) for name, text in digests.items()}, certified
        )
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        wrong = f"{type(error).__name__}: {error}"
        fault = (
            "its attributes `config` and `inputs` are not those of a fit"
            f" ({wrong[:200]})"
        )
        raise input_error(file, fault, FIX) from None


def required(fit: Statement, head: Fit) -> set[str]:
    """Return the datasets that every such fit writes."""
    name, perspective = fit.config["method"], head.focal is not None
    names = ALWAYS + (ERROR_BARS if METHODS[name].has_prior else "")
    names += " coefficients" if METHODS[name].mixes_atoms else ""
    names += " omitted" if fit.config.get("leave_one_out") is not None else ""
    if fit.certified:
        prefix = "" if name == "convex" and not perspective else "convex_"
        names += f" {certificate.CERTIFICATE} {prefix}objective {prefix}relative_gap"
        bounded = not perspective and fit.config["outliers"] not in ROBUST
        names += " relative_gap" if bounded else ""
    return set(names.split())


def match_files(
    part: Part, fit: Statement, request: Request, digest_of: Callable[[Path], str]
) -> tuple[list[Path], list[Failure]]:
    """Return the landmarks of a part as its fit read them, if all are given; and false
    digests.

    A file is recognised by the digest that the fit states, else by its name, or it is
    the only one.
    """
    paths, wrong = {fit.config["dictionary"]: [request.dictionary]}, list[Failure]()
    inputs = fit.config["landmarks"] if part.line is None else part.line.inputs
    given = request.landmarks
    for name in inputs:
        equal = [path for path in given if digest_of(path) == fit.digests.get(name)]
        equal += [path for path in given if path.resolve().name == Path(name).name]
        paths[name] = equal or [*given] * (len(inputs) == len(given) == 1)
    for name, candidates in paths.items():
        path, stated = next(iter(candidates), None), fit.digests.get(name)
        if stated is None:
            wrong.append(Failure(name, "has no digest"))
        elif path is None and given:
            wrong.append(
                Failure(name, "is a file of the fit that is not given by --landmarks")
            )
        elif path is not None and stated not in (None, "stream", digest_of(path)):
            reason = f"is not the file of the fit, {name}: the digests differ"
            reason += f" ({digest_of(path)[:12]}... and {stated[:12]}...)"
            wrong.append(Failure(str(path), reason))
    _, *landmarks = paths.values()
    return [first for first, *_ in landmarks] if all(landmarks) else [], wrong


def read_program(
    head: Fit, file: Path, path: Path, dictionary: Dictionary, fit: Statement
) -> CertifiedProgram:
    """Return the convex program of a fit. Raises InputError for another dictionary."""
    names = f"{path}: landmark names"
    columns = match_landmarks(dictionary.landmark_names, head.landmark_names, names)
    k = dictionary.k if head.coefficients is None else head.coefficients.shape[1]
    omits = fit.config.get("leave_one_out") is not None
    if k != dictionary.k or (omits and dictionary.atom_items is None):
        fault = f"has {counted(dictionary.k, 'atom')}, and {file} coefficients of {k}"
        raise input_error(
            path, fault, "give the dictionary of the fit, whose atoms have items"
        )
    outliers, perspective = fit.config["outliers"], head.focal is not None
    return CertifiedProgram(
        atoms=np.ascontiguousarray(dictionary.atoms[:, :, columns]),
        atom_items=dictionary.atom_items if omits else None,
        refined=perspective or fit.config["method"] != "convex",
        bounds=not perspective and outliers not in ROBUST,
        searched=outliers not in ("none", *ROBUST),
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
    """Open the landmarks of a file of results as its fit read them; gives None for each
    without files.
    """
    if not files:
        yield repeat(None)
        return
    from shapefit.config.commands.input import LandmarksConfig

    place, method = (
        f"{', '.join(map(str, files))}: landmark names",
        METHODS[fit.config["method"]],
    )
    keys = LandmarksConfig.model_fields.keys() & fit.config.keys() - {"data"}
    try:
        reading = LandmarksConfig(**{key: fit.config[key] for key in keys})
        calibrated = (fit.config.get("camera") or {}).get("calibration") is not None
    except (ValueError, AttributeError):
        raise input_error(
            file, "does not state how its landmarks were read", FIX
        ) from None
    # Without identity over frames detections are no motion.
    options = input_options(reading, "motion" if method.sequences else "none")
    with open_landmarks(files, options, rows) as source:
        names = source.head.landmark_names
        joints = find_joints(names, head.landmark_names, in_place=method.has_prior)
        if source.count != count:
            fault = f"{counted(source.count, 'image')} for {counted(count, 'result')}"
            raise input_error(files[0], fault, f"give the landmarks of {file}")

        def as_fitted(images: Landmarks) -> Landmarks:
            matrix, removed = head.column(CAMERA_MATRIX), head.column(REMOVED)
            if calibrated and matrix is not None and removed is not None:
                lens = {CAMERA_MATRIX: matrix, DISTORTION: removed}
                images = images.with_file_extras(lens)
            images = named_as_joints(undistorted(images, None), joints, place)
            return arrange(images, head.landmark_names, place, omit=True)

        yield map(as_fitted, source.batches(CHUNK))


def check_chunk(
    result: Fit,
    given: Landmarks | None,
    program: CertifiedProgram,
    certified: bool,
) -> Checked:
    """Check the claims of some images."""
    columns = claimed_columns(result)
    claims = Claims(
        np.isfinite(columns["scale"]) & np.isfinite(columns["shapes"]).all(axis=(1, 2))
    )
    check_confidence(columns, claims)
    bounded, gaps = np.zeros_like(claims.fitted), np.zeros(len(result))
    with np.errstate(all="ignore"):  # what is not finite holds for nothing
        certificate.check_ranges(columns, claims)
        if certified:
            bounded = certificate.check_certificate(columns, program, claims)
            gaps = certificate.stated_gap(columns, program)
        if given is not None:
            check_landmarks(columns, result, given, claims)
    holds = np.asarray(bounded & ~claims.missed)
    return Checked(result, claims, holds, float(np.max(gaps[holds], initial=0.0)))


def claimed_columns(result: Fit) -> dict[str, Any]:
    """Return the columns of a result by their names, points one a column."""
    columns: dict[str, Any] = dict(result.extras)
    for column, value in held_columns(result):
        values = np.asarray(value)
        columns[column.name] = in_columns(values) if column.has_points else values
    return columns


def check_confidence(columns: dict[str, Any], claims: Claims) -> None:
    """Claim that there is a number for each landmark, where confidences are stored;
    others are taken out.
    """
    confidence, (n, _, p) = columns.get("confidence"), columns["landmarks"].shape
    if confidence is None:
        return
    if confidence.shape != (n, p) or confidence.dtype.kind not in "biuf":
        del columns["confidence"]
        nobody = np.zeros(n, bool)
        claims.hold("each landmark has a confidence", nobody, of=~nobody)


def check_landmarks(
    columns: Mapping[str, Any], result: Fit, given: Landmarks, claims: Claims
) -> None:
    """Claim that n results have the landmarks and confidences of a file, under their
    names.
    """
    everyone, visible = np.ones_like(claims.fitted), given.visible()
    in_file, stated = (
        np.where(visible[:, None], given.as_columns(), np.nan),
        columns["landmarks"],
    )
    off = np.where(np.isnan(stated) & np.isnan(in_file), 0.0, np.abs(stated - in_file))
    allowed = 0.0
    if given.column(REMOVED) is not None:
        allowed = UNDISTORTED * np.nanmax(np.abs(in_file), initial=1.0)
    claims.near("landmarks are those of the file", off, allowed, of=everyone)
    confidence = given.weights() if given.confidence is None else given.confidence
    same = np.equal(columns.get("confidence", 1.0), confidence) | ~visible
    claims.hold("confidences are those of the file", same, of=everyone)
    same = np.array(result.items, object) == np.array(given.items, object)
    claims.hold("items are those of the file", same, of=everyone)


def summary_lines(tally: Tally, fit: Statement, with_landmarks: bool) -> Iterator[str]:
    """Yield the summary: what was recomputed and compared of how many images, what was
    not, and what is false.
    """
    total = f"of {counted(tally.images + tally.unread, 'image')}"
    method, why = fit.config["method"], "has no certificate"
    if fit.certified:
        why = (
            "the convex program is solved to within the gap that is stated,"
            f" {tally.largest_gap:.1g} at most"
        )
    elif method in CERTIFIED:
        why = "no certificate is stored"
    elif method == "global":
        why = (
            "its bound on all rotations is stated, not checked: no file holds the"
            " search that proves it"
        )
    sealed = "all that the file holds is as `fit` wrote it, by one digest"
    if tally.not_sealed:
        sealed = "not sealed: the file has no digest of what it holds"
    elif tally.sealed < tally.images + tally.unread:
        sealed = "the others were changed after `fit`"
    recomputed, unchecked = "nothing", "shapes, error bars and all other numbers"
    if fit.certified:
        recomputed = "objective, gap and certificate of the convex program"
        recomputed += "; of its solution the shape" if method == "convex" else ""
        unchecked = "numbers that no certificate names"
    landmarks = "; landmarks with the files" if with_landmarks else ""
    wrong = ""
    if tally.files:
        wrong = f", and {counted(tally.files, 'claim')} of whole files"
    yield f"Method     {method}"
    yield f"Certified  {tally.certified} {total}: {why}"
    yield f"Sealed     {tally.sealed} {total}: {sealed}"
    if tally.empty:
        yield f"No shape   {tally.empty} {total}"
    yield f"Recomputed {recomputed}"
    yield f"Compared   digests, datasets, ranges{landmarks}"
    yield (
        f"Unchecked  how {unchecked} follow from the landmarks"
        + ("" if with_landmarks else "; landmarks, without --landmarks")
    )
    yield f"False      {tally.false + tally.unread} {total}{wrong}"
