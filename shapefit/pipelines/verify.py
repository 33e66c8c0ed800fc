"""`verify`: a result in, every claim of it that does not hold out.

Of each image: the certificate of the convex program, where the method has one; landmarks equal to
those of the file, where it is given; numbers in their ranges. Of each file: the digests of what it
was made of, and that the datasets of its method are there. Nothing else is claimed, and nothing
that a result names is opened.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from itertools import repeat
from pathlib import Path
from typing import Any

import numpy as np

from shapefit.dictionary.model import Dictionary
from shapefit.errors import InputError, counted, input_error, parse_json
from shapefit.geometry.pinhole import CAMERA_MATRIX
from shapefit.io import LandmarkSet, ResultSet, digest, open_landmarks, read_dictionary
from shapefit.io import match_landmarks as columns_by_name
from shapefit.io.inputs import HDF5_SIGNATURE, begins_with, require_file
from shapefit.io.options import input_options
from shapefit.io.source import open_results
from shapefit.lifting.methods import METHODS, ROBUST
from shapefit.pipelines.fit.camera import DISTORTION, REMOVED, undistorted
from shapefit.pipelines.joints import find_joints, named_as_joints
from shapefit.pipelines.outcome import Failure, Outcome, unread
from shapefit.threads import side_by_side
from shapefit.verification.certificate import CERTIFICATE, Program, check_certificate
from shapefit.verification.claims import Claims, check_ranges

AT_A_TIME = 1 << 24
"""Bytes of the largest arrays of the images that are checked together."""
STREAM = "stream"
"""Stands for the digest of what could not be read twice."""
STRAIGHT = 1e-8
"""Of the largest coordinate by which landmarks without the distortion of a lens may be off."""

ALWAYS = "shapes landmarks lambda scale translation rotation status objective"
ERROR_BARS = "shape_sd shape_correlation p_value inlier_probability trusted reasons"
POINTS = {"landmarks", "shape_correlation"}
POINTS |= {f"input_{name}" for name in ("shapes", "shape_sd", "shape_correlation")}
"""Datasets of a result with one point a row, in the file and maybe in memory, too."""
CERTIFIED = ("convex", "convex+refine")
"""Methods with a certificate."""
FIX = "give a result that `shapefit fit` wrote"

Wrong = list[tuple[str, str]]
"""What a file states falsely of all its images, and why."""
Chunks = Callable[[int, int], Iterator[LandmarkSet]]


@dataclass(frozen=True)
class Request:
    """A result to verify, the dictionary of its fit and, if given, the landmarks."""

    result: Path
    dictionary: Path
    landmarks: tuple[Path, ...] = ()


@dataclass(frozen=True)
class Part:
    """A file of results; the inputs and range of rows that a manifest states, None without one."""

    file: Path
    inputs: tuple[str, ...] | None = None
    rows: tuple[int, int] | None = None


@dataclass(frozen=True)
class Statement:
    """What a result states of its fit: the method, the dictionary, the landmarks, their digests.

    config: the keys of the fit; certified: its method has a certificate, and it is stored.
    """

    method: str
    dictionary: str
    landmarks: tuple[str, ...]
    digests: Mapping[str, str]
    config: Mapping[str, Any]
    certified: bool

    def key(self, name: str, default: Any = None) -> Any:
        """Return a key of the config, the default where it is not set."""
        value = self.config.get(name)
        return default if value is None else value

    def required(self, columns: Mapping[str, Any]) -> list[str]:
        """Return the datasets that every such fit writes."""
        names = ALWAYS.split() + ERROR_BARS.split() * METHODS[self.method].has_prior
        if METHODS[self.method].mixes_atoms:
            names = [*names, "coefficients"]
        if self.key("leave_one_out") is not None:
            names = [*names, "omitted"]
        if self.certified:
            of_program = self.method == "convex" and "focal" not in columns
            before = "" if of_program else "convex_"
            names = [*names, *CERTIFICATE, f"{before}objective", f"{before}relative_gap"]
        bounded = self.certified and self.key("outliers", "none") not in ROBUST
        if "focal" not in columns and (bounded or self.method in ("convex", "global")):
            names = [*names, "relative_gap"]
        return list(dict.fromkeys(names))


@dataclass
class Tally:
    """What became of the claims, summed up over all files of a result.

    files: claims of whole files that are false; unread: images of parts that could not be checked.
    """

    images: int = 0
    certified: int = 0
    false: int = 0
    empty: int = 0
    files: int = 0
    unread: int = 0


def run(request: Request) -> Generator[Outcome, None, None]:
    """Verify every image of a result; yields an Outcome per chunk, and the summary as the last.

    Raises InputError where the result is no HDF5 result of `fit`, or does not go with the
    dictionary or the landmarks; for a folder only where that is so of every part.
    """
    parts, wrong, listed = find_parts(request.result)
    dictionary, digests, tally = read_dictionary(request.dictionary), cache(digest), Tally()
    methods: dict[str, Statement] = {}
    yield Outcome(failures=wrong)
    tally.files += len(wrong)
    errors: list[InputError] = []
    for part in parts:
        try:
            yield from verify_part(part, request, dictionary, tally, methods, digests)
        except InputError as error:
            errors.append(error)
            if len(errors) == len(parts):
                raise InputError(each for one in errors for each in one.problems) from None
            tally.files += 1
            yield Outcome(failures=(unread(part.file, error),))
    tally.unread = max(listed - tally.images, tally.unread)
    none = (Failure(str(request.result), "holds no image"),) * (not tally.images + tally.unread)
    note = "\n".join(summary_lines(tally, methods, with_landmarks=bool(request.landmarks)))
    data = vars(tally) | {"methods": [*methods], "landmarks": bool(request.landmarks)}
    yield Outcome(failures=none, note=note, data=lambda: data)


def find_parts(result: Path) -> tuple[list[Part], tuple[Failure, ...], int]:
    """Return the files of a result, what is false in its manifest, and how many images it lists."""
    if not result.is_dir():
        return [Part(result)], (), 0
    from shapefit.pipelines.partition.manifest import read_manifest

    manifest = read_manifest(result)
    if manifest is None:
        raise input_error(result, "is a folder without results", "name a result in it")
    wrong, parts, images = [], [], 0
    try:
        for name, entry in manifest.done.items():
            rows = entry["rows"] and (int(entry["rows"][0]), int(entry["rows"][1]))
            images += int(entry["images"])
            if not (result / name).is_file():
                wrong.append(Failure(name, "is not there, and the manifest lists it"))
                continue
            parts.append(Part(result / name, tuple(map(str, entry["inputs"])), rows))
            if entry["bytes"] != (result / name).stat().st_size:
                wrong.append(Failure(name, "is not the file that `fit` wrote, by its size"))
    except (KeyError, TypeError, ValueError, IndexError) as error:
        found = f"is not a manifest of results ({type(error).__name__}: {error})"
        raise input_error(manifest.path, found, "fit again") from None
    unlisted = {path.name for path in result.glob("part-*")} - manifest.done.keys()
    wrong += [Failure(name, "is not in the manifest") for name in sorted(unlisted)]
    if not manifest.done:
        wrong.append(Failure("manifest", "lists no part"))
    return parts, tuple(wrong), images


def verify_part(
    part: Part,
    request: Request,
    dictionary: Dictionary,
    tally: Tally,
    methods: dict[str, Statement],
    digests: Callable[[Path], str],
) -> Generator[Outcome, None, None]:
    """Verify the images of one file, and what it states of them all."""
    require_file(part.file)
    if not begins_with(part.file, HDF5_SIGNATURE):
        fix = "give a result that `shapefit fit` wrote to a name in .h5"
        raise input_error(part.file, "is not HDF5, and tables hold points only", fix)
    with open_results([part.file], proofs=True, check=False) as results:
        head = results.head
        fit = read_statement(head.attributes, part.file)
        methods[fit.method] = fit
        missing = [name for name in fit.required(head.columns) if name not in head.columns]
        wrong = [(name, "is missing, and every such fit writes it") for name in missing]
        if hashlib.sha256(
            str(head.attributes["config"]).encode()
        ).hexdigest() != head.attributes.get("config_digest"):
            wrong.append(("config", "is not that of the fit, by its digest"))
        needed = [fit.dictionary, *(fit.landmarks if part.rows is None else ())]
        wrong += [(name, "has no digest") for name in needed if name not in fit.digests]
        stated = fit.digests.get(fit.dictionary)
        wrong += compare(request.dictionary, stated, fit.dictionary, digests)
        with open_images(part, head, fit, request.landmarks, digests) as (source, unlike):
            failures = tuple(Failure(*each) for each in [*wrong, *unlike])
            tally.files += len(failures)
            yield Outcome(failures=failures)
            if missing:
                tally.unread += results.count
                return
            program = read_program(head, part.file, request.dictionary, dictionary, fit)
            k, _, p = program.atoms.shape
            size = min(max(AT_A_TIME // (120 * k + 96 * p), 16), 4096)
            images = repeat(None) if source is None else source(size, results.count)

            def check(chunk: tuple[ResultSet, LandmarkSet | None]) -> tuple[ResultSet, Claims, Any]:
                return check_chunk(*chunk, program, fit)

            batches = results.batches(size) if results.count else iter(())
            pairs = zip(batches, images, strict=False)
            for result, claims, certified in side_by_side(check, pairs, 1):
                tally.images += len(result)
                tally.certified += int(certified.sum())
                tally.false += int(claims.missed.sum())
                tally.empty += int((~claims.fitted).sum())
                failures = tuple(Failure(result.items[i], why) for i, why in claims.reasons())
                yield Outcome(done=len(result), total=results.count, failures=failures)


def check_chunk(
    result: ResultSet, given: LandmarkSet | None, program: Program, fit: Statement
) -> tuple[ResultSet, Claims, Any]:
    """Return the claims of some images, and which of them are certified (n,)."""
    columns = result.columns
    for name in POINTS & columns.keys() - result.LAYOUT.datasets.keys():
        columns[name] = np.ascontiguousarray(np.swapaxes(columns[name], 1, 2))
    claims = Claims(np.isfinite(columns["scale"]) & np.isfinite(columns["shapes"]).all(axis=(1, 2)))
    certified = np.zeros_like(claims.fitted)
    with np.errstate(all="ignore"):  # what is not finite holds for nothing
        check_ranges(columns, claims)
        if fit.certified:
            atom = columns["transform_atom"]
            if ((atom < 0) | (atom >= len(program.atoms))).any():
                found = f"transforms of atoms that are not among the {len(program.atoms)}"
                raise input_error("transform_atom", found, "give the dictionary of the fit")
            certified = check_certificate(columns, program, claims)
        if given is not None:
            check_landmarks(columns, result, given, claims)
        return result, claims, certified & ~claims.missed


def check_landmarks(
    columns: Mapping[str, Any], result: ResultSet, given: LandmarkSet, claims: Claims
) -> None:
    """Claim that n results have the landmarks and confidences of a file, under their names."""
    n, everyone = len(result), np.ones_like(claims.fitted)
    if len(given) != n:
        raise input_error("landmarks", "has fewer images than results", "give those of the fit")
    visible = given.visible()
    in_file, stated = np.where(visible[:, None], given.landmarks, np.nan), columns["landmarks"]
    off = np.where(np.isnan(stated) & np.isnan(in_file), 0.0, np.abs(stated - in_file))
    lens = REMOVED in given.columns
    allowed = STRAIGHT * np.nanmax(np.abs(in_file), initial=1.0) if lens else 0.0
    claims.near("landmarks are those of the file", off, allowed, of=everyone)
    ones = np.ones((n, len(result.landmark_names)))
    confidence = ones if given.confidence is None else given.confidence
    same = np.equal(columns.get("confidence", ones), confidence) | ~visible
    claims.hold("confidences are those of the file", same, of=everyone)
    same = np.array(result.items, object) == np.array(given.items, object)
    claims.hold("items are those of the file", same, of=everyone)


def read_statement(attributes: Mapping[str, Any], file: Path) -> Statement:
    """Return what the attributes `config` and `inputs` of a result say.

    Raises InputError where they are not those of a fit.
    """
    try:
        config, digests = (parse_json(attributes.get(name, "{}")) for name in ("config", "inputs"))
        method, named = config["method"], config["landmarks"]
        if method not in METHODS:
            raise ValueError(f"no method {method}")
        stored = config.get("save", {}).get("proof") is not False
        float(config.get("tolerance") or 1e-6)
        return Statement(
            method=method,
            dictionary=str(config["dictionary"]),
            landmarks=tuple(map(str, [named] if isinstance(named, str) else named)),
            digests={str(name): str(value) for name, value in digests.items()},
            config=config,
            certified=stored and method in CERTIFIED,
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        wrong = f"{type(error).__name__}: {error}"
        found = f"its attributes `config` and `inputs` are not those of a fit ({wrong[:200]})"
        raise input_error(file, found, FIX) from None


def read_program(
    head: ResultSet, file: Path, path: Path, dictionary: Dictionary, fit: Statement
) -> Program:
    """Return the convex program of a fit. Raises InputError for another dictionary."""
    names = f"{path}: landmark names"
    columns = columns_by_name(dictionary.landmark_names, head.landmark_names, names)
    k = dictionary.k if head.coefficients is None else head.coefficients.shape[1]
    omits = fit.key("leave_one_out") is not None
    if k != dictionary.k or (omits and dictionary.atom_items is None):
        found = f"has {counted(dictionary.k, 'atom')}, and {file} coefficients of {k}"
        raise input_error(path, found, "give the dictionary of the fit, whose atoms have items")
    outliers, perspective = fit.key("outliers", "none"), "focal" in head.columns
    return Program(
        atoms=np.ascontiguousarray(dictionary.atoms[:, :, columns]),
        atom_items=dictionary.atom_items if omits else None,
        refined=perspective or fit.method != "convex",
        bounds=not perspective and outliers not in ROBUST,
        searched=outliers not in ("none", *ROBUST),
        loss=outliers if outliers in ROBUST else "squared",
        beta=float(fit.key("outlier_threshold", 0.1)),  # of the robust losses
        tolerance=float(fit.key("tolerance", 1e-6)),
    )


def compare(path: Path, stated: str | None, name: str, digests: Callable[[Path], str]) -> Wrong:
    """Return what is wrong with a file beside the digest that a fit states of it."""
    own = digests(path)
    if stated is None or STREAM in (own, stated) or own == stated:
        return []
    reason = f"is not the file of the fit, {name}: the digests differ"
    return [(str(path), f"{reason} ({own[:12]}... and {stated[:12]}...)")]


@contextmanager
def open_images(
    part: Part,
    head: ResultSet,
    fit: Statement,
    given: Sequence[Path],
    digests: Callable[[Path], str],
) -> Iterator[tuple[Chunks | None, Wrong]]:
    """Open the landmarks of a part as its fit read them, if they are given; and what is wrong.

    Gives chunks(size, count).
    """
    named = part.inputs or fit.landmarks
    files, wrong = pair_files(named, given, fit.digests, digests) if given else ([], Wrong())
    if len(files) < len(named):
        yield None, wrong
        return
    from shapefit.config.commands.input import LandmarksConfig

    place = ", ".join(map(str, files)) + ": landmark names"
    keys = LandmarksConfig.model_fields.keys() & fit.config.keys() - {"data"}
    try:
        reading = LandmarksConfig(**{key: fit.config[key] for key in keys})
    except ValueError:
        raise input_error(part.file, "does not state how its landmarks were read", FIX) from None
    rows = None if part.rows is None else slice(*part.rows)
    joined = METHODS[fit.method].sequences  # without identity over frames detections are no motion
    options = input_options(reading, "motion" if joined else "none")
    with open_landmarks(files, options, rows) as source:
        joints = find_joints(
            source.head.landmark_names, head.landmark_names, in_place=METHODS[fit.method].has_prior
        )
        calibrated = (fit.key("camera") or {}).get("calibration") is not None

        def as_fitted(images: LandmarkSet) -> LandmarkSet:
            if calibrated and REMOVED in head.columns:
                lens = {CAMERA_MATRIX: head.columns[CAMERA_MATRIX]}
                lens[DISTORTION] = head.columns[REMOVED]
                images = images.with_columns(whole=lens)
            images = named_as_joints(undistorted(images, None), joints, place)
            return images.arrange(head.landmark_names, place, omit=True)

        def chunks(size: int, count: int) -> Iterator[LandmarkSet]:
            if source.count != count:
                found = f"{counted(source.count, 'image')} for {counted(count, 'result')}"
                raise input_error(files[0], found, f"give the landmarks of {part.file}")
            return map(as_fitted, source.batches(size))

        yield chunks, wrong


def pair_files(
    named: Sequence[str],
    given: Sequence[Path],
    stated: Mapping[str, str],
    digests: Callable[[Path], str],
) -> tuple[list[Path], Wrong]:
    """Return the given file of each that a fit names, and those that are missing or another.

    That is the one with the digest that is stated, else with the same name, else the only one.
    """
    files, wrong = [], Wrong()
    for name in named:
        known = stated.get(name)
        candidates = [path for path in given if known is not None and digests(path) == known]
        candidates += [path for path in given if path.resolve().name == Path(name).name]
        if len(named) == len(given) == 1:
            candidates += given
        if not candidates:
            wrong.append((name, "is a file of the fit that is not given by --landmarks"))
            continue
        files.append(candidates[0])
        wrong += compare(candidates[0], known, name, digests)
    return files, wrong


def summary_lines(
    tally: Tally, methods: Mapping[str, Statement], *, with_landmarks: bool
) -> Iterator[str]:
    """Yield the summary: what is certified of how many images, what is false."""
    if not methods or not tally.images + tally.unread:
        yield "No image was checked."
        return
    total = f"of {counted(tally.images + tally.unread, 'image')}"
    (method, fit), *_ = methods.items()
    why = "the convex program is solved to within the gap that is stated"
    if not fit.certified:
        none = "no certificate is stored" if method in CERTIFIED else "has no certificate"
        why = "states its gap, which is not checked" if method == "global" else none
    yield f"Method     {method}"
    yield f"Certified  {tally.certified} {total}: {why}"
    if tally.empty:
        yield f"No shape   {tally.empty} {total}"
    landmarks = "landmarks" if with_landmarks else "landmarks only with --landmarks"
    yield f"Checked    digests, datasets, ranges; {landmarks}"
    wrong = f", and {counted(tally.files, 'claim')} of whole files" * bool(tally.files)
    yield f"False      {tally.false + tally.unread} {total}{wrong}"
