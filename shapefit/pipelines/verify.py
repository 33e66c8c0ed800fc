"""`verify`: a result in, every claim of it that does not hold out.

Of each image: the certificate of the convex program, where the method has one; landmarks equal to
those of the file, where it is given; numbers in their ranges. Of each file: the digests of what it
was made of, and the datasets that its method writes. Nothing else is claimed, and nothing that a
result names is opened.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from itertools import repeat
from pathlib import Path, PurePath
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
OF_ERROR_BARS = "shape_sd shape_correlation p_value inlier_probability log_evidence trusted reasons"
INVENTED = f"{OF_ERROR_BARS} shape_covariance expected_error input_shape_sd input_shape_correlation"
"""Datasets that only methods with error bars write."""
POINTS = {"landmarks", "shape_correlation"}
POINTS |= {f"input_{name}" for name in ("shapes", "shape_sd", "shape_correlation")}
"""Datasets of a result with one point a row, in the file and maybe in memory, too."""
CERTIFIED = ("convex", "convex+refine")
"""Methods with a certificate."""
FIX = "give a result that `shapefit fit` wrote"


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

    options, the whole config; has_proof: the certificate of the convex program is stored;
    calibrated: a file with a calibration was read; searched, loss, beta, tolerance, omit as
    in `Program`.
    """

    method: str
    dictionary: str
    landmarks: tuple[str, ...]
    digests: Mapping[str, str]
    options: Mapping[str, Any]
    calibrated: bool
    has_proof: bool
    searched: bool
    loss: str
    beta: float
    tolerance: float
    omit: bool

    @property
    def has_prior(self) -> bool:
        """Whether shapes have error bars."""
        return METHODS[self.method].has_prior

    @property
    def certified(self) -> bool:
        """Whether the method has a certificate, and it is stored."""
        return self.has_proof and self.method in CERTIFIED

    def required(self, columns: Mapping[str, Any]) -> list[str]:
        """Return the datasets that every such fit writes."""
        names = ALWAYS.split()
        names += OF_ERROR_BARS.split() * self.has_prior
        names += ["residual", "tight"] * (self.method == "convex" and "focal" not in columns)
        names += ["omitted"] * self.omit
        if METHODS[self.method].mixes_atoms:
            names += ["coefficients", "active_atoms"]
        if "focal" in columns:
            names += ["camera_translation", "principal_point", "landmarks_fitted"]
        elif METHODS[self.method].proves in ("optimum", "global"):
            names += ["relative_gap"]
        if self.certified:
            own = self.method == "convex" and "focal" not in columns
            names += [*CERTIFICATE, *([] if own else ["convex_objective", "convex_relative_gap"])]
        return names


def run(request: Request) -> Generator[Outcome, None, None]:
    """Verify every image of a result; yields an Outcome per chunk, and the summary as the last.

    Raises InputError where the result is no HDF5 result of `fit`, or does not go with the
    dictionary or the landmarks; for a folder only where that is so of every part.
    """
    parts, wrong, listed = find_parts(request.result)
    dictionary, digests, tally = read_dictionary(request.dictionary), cache(digest), Tally(request)
    yield Outcome(failures=wrong)
    tally.files += len(wrong)
    errors: list[InputError] = []
    for part in parts:
        try:
            yield from verify_part(part, request, dictionary, tally, digests)
        except InputError as error:
            errors.append(error)
            if len(errors) == len(parts):
                raise InputError(each for one in errors for each in one.problems) from None
            tally.files += 1
            yield Outcome(failures=(unread(part.file, error),))
    tally.unread = max(listed - tally.images, tally.unread)
    none = (Failure(str(request.result), "holds no image"),) * (not tally.images + tally.unread)
    yield Outcome(failures=none, note="\n".join(tally.lines()), data=tally.values)


def find_parts(result: Path) -> tuple[list[Part], tuple[Failure, ...], int]:
    """Return the files of a result, what is false in its manifest, and how many images it lists."""
    if not result.is_dir():
        return [Part(result)], (), 0
    from shapefit.pipelines.partition.manifest import find_gaps, read_manifest, result_digest

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
            if entry["digest"] != result_digest(result / name):
                wrong.append(Failure(name, "is not the file that `fit` wrote, by its digest"))
        wrong += [Failure("manifest", gap) for gap in find_gaps(manifest)]
        images = max(images, int(manifest.run.get("images", 0)))
    except (KeyError, TypeError, ValueError, IndexError) as error:
        found = f"is not a manifest of results ({type(error).__name__}: {error})"
        raise input_error(manifest.path, found, "fit again") from None
    there = {path.name for path in result.iterdir()} - manifest.done.keys()
    unlisted = sorted(name for name in there if name.startswith("part-"))
    wrong += [Failure(name, "is not in the manifest") for name in unlisted]
    if not manifest.done:
        wrong.append(Failure("manifest", "lists no part"))
    return parts, tuple(wrong), images


def verify_part(
    part: Part,
    request: Request,
    dictionary: Dictionary,
    tally: Tally,
    digests: Callable[[Path], str],
) -> Generator[Outcome, None, None]:
    """Verify the images of one file, and what it states of them all."""
    require_file(part.file)
    if not begins_with(part.file, HDF5_SIGNATURE):
        fix = "give a result that `shapefit fit` wrote to a name in .h5"
        raise input_error(part.file, "is not HDF5, and tables hold points only", fix)
    with open_results([part.file], proofs=True, check=False) as results:
        fit, head = read_statement(results.head.attributes, part.file), columns_of(results.head)
        tally.methods[fit.method] = fit
        missing = [name for name in fit.required(head) if name not in head]
        wrong = false_of_file(results.head, fit, dictionary, missing)
        needed = [fit.dictionary, *(fit.landmarks if part.rows is None else ())]
        wrong += [(name, "has no digest") for name in needed if name not in fit.digests]
        known = fit.digests.get(fit.dictionary)
        wrong += compare(request.dictionary, known, fit.dictionary, digests)
        with open_images(part, results.head, fit, request.landmarks, digests) as (source, unlike):
            failures = tuple(Failure(*each) for each in [*wrong, *unlike])
            tally.files += len(failures)
            yield Outcome(failures=failures)
            if missing:
                tally.unread += results.count
                return
            program = read_program(results.head, part.file, request.dictionary, dictionary, fit)
            k, _, p = program.atoms.shape
            size = min(max(AT_A_TIME // (120 * k + 96 * p), 16), 4096)
            images = repeat(None) if source is None else source(size, results.count)

            def check(chunk: tuple[ResultSet, LandmarkSet | None]) -> tuple[ResultSet, Claims, Any]:
                return check_chunk(*chunk, program, fit)

            batches = results.batches(size) if results.count else iter(())
            pairs = zip(batches, images, strict=False)
            for result, claims, certified in side_by_side(check, pairs, 1):
                tally.add(claims, certified)
                failures = tuple(Failure(result.items[i], why) for i, why in claims.reasons())
                yield Outcome(done=len(result), total=results.count, failures=failures)


def check_chunk(
    result: ResultSet, given: LandmarkSet | None, program: Program, fit: Statement
) -> tuple[ResultSet, Claims, Any]:
    """Return the claims of some images, and which of them are certified (n,)."""
    columns = columns_of(result)
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
    found, stated = np.where(visible[:, None], given.landmarks, np.nan), columns["landmarks"]
    off = np.where(np.isnan(stated) & np.isnan(found), 0.0, np.abs(stated - found))
    allowed = STRAIGHT * np.nanmax(np.abs(found), initial=1.0) if REMOVED in given.columns else 0.0
    claims.near("landmarks are those of the file", off, allowed, of=everyone)
    ones = np.ones((n, len(result.landmark_names)))
    confidence = ones if given.confidence is None else given.confidence
    same = np.equal(columns.get("confidence", ones), confidence) | ~visible
    claims.hold("confidences are those of the file", same, of=everyone)
    same = np.array([a == b for a, b in zip(result.items, given.items, strict=True)], dtype=bool)
    claims.hold("items are those of the file", same, of=everyone)


def read_statement(attributes: Mapping[str, Any], file: Path) -> Statement:
    """Return what the attributes `config` and `inputs` of a result say.

    Raises InputError where they are not those of a fit.
    """
    try:
        config, digests = (parse_json(attributes.get(name, "{}")) for name in ("config", "inputs"))

        def key(path: str, default: Any = None) -> Any:
            section, _, name = path.rpartition(".")
            value = (config[section] if section else config).get(name)
            return default if value is None else value

        method, outliers = config["method"], key("outliers", default="none")
        if method not in METHODS:
            raise ValueError(f"no method {method}")
        named = config["landmarks"]
        return Statement(
            method=method,
            dictionary=str(config["dictionary"]),
            landmarks=tuple(map(str, [named] if isinstance(named, str) else named)),
            digests={str(name): str(value) for name, value in digests.items()},
            options=config,
            calibrated=key("camera.calibration") is not None,
            has_proof=key("save.proof", default=True) is not False,
            searched=outliers not in ("none", *ROBUST),
            loss=str(outliers) if outliers in ROBUST else "squared",
            beta=float(key("outlier_threshold", default=0.1)),  # of the robust losses
            tolerance=float(key("tolerance", default=1e-6)),
            omit=key("leave_one_out") is not None,
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
    if k != dictionary.k:
        found = f"has {counted(dictionary.k, 'atom')}, and {file} coefficients of {k}"
        raise input_error(path, found, "give the dictionary of the fit")
    if fit.omit and dictionary.atom_items is None:
        found = (
            "was fitted without atoms of some items (`leave_one_out`), which the dictionary lacks"
        )
        raise input_error(file, found, "give the dictionary of the fit, whose atoms have items")
    perspective = "focal" in head.columns
    return Program(
        atoms=np.ascontiguousarray(dictionary.atoms[:, :, columns]),
        atom_items=dictionary.atom_items if fit.omit else None,
        refined=perspective or fit.method != "convex",
        bounds=not perspective and fit.loss == "squared",
        searched=fit.searched,
        loss=fit.loss,
        beta=fit.beta,
        tolerance=fit.tolerance,
    )


def columns_of(result: ResultSet) -> dict[str, Any]:
    """Return the datasets of a result by name, points one a column."""
    columns = result.columns
    for name in POINTS & columns.keys() - result.LAYOUT.datasets.keys():
        columns[name] = np.ascontiguousarray(np.swapaxes(columns[name], 1, 2))
    return columns


Wrong = list[tuple[str, str]]
"""What a file states falsely of all its images, and why."""


def false_of_file(
    head: ResultSet, fit: Statement, dictionary: Dictionary, missing: Sequence[str]
) -> Wrong:
    """Return datasets and attributes that such a fit writes and are not there, or the reverse."""
    attributes_of_file, columns = head.attributes, columns_of(head)
    wrong = [(name, "is missing, and every such fit writes it") for name in missing]
    attributes = [name for name in ("config_digest", "inputs") if name not in attributes_of_file]
    wrong += [(name, "is missing, and every fit writes it") for name in attributes]
    own = hashlib.sha256(str(attributes_of_file["config"]).encode()).hexdigest()
    if attributes_of_file.get("config_digest", own) != own:
        wrong.append(("config", "is not that of the fit, by its digest"))
    if attributes_of_file.get("method") != fit.method:
        wrong.append(("method", "is not that of the config"))
    if not fit.has_prior:
        bars = [name for name in INVENTED.split() if name in columns]
        wrong += [(name, f"is there, and {fit.method} has no error bars") for name in bars]
    if dictionary.edges is not None and len(dictionary.edges) and "edges" not in columns:
        wrong.append(("edges", "is missing, and the dictionary has edges"))
    return wrong


def compare(path: Path, known: str | None, name: str, digests: Callable[[Path], str]) -> Wrong:
    """Return what is wrong with a file beside the digest that a fit states of it."""
    found = digests(path)
    if known is None or STREAM in (found, known) or found == known:
        return []
    reason = f"is not the file of the fit, {name}: the digests differ"
    return [(str(path), f"{reason} ({found[:12]}... and {known[:12]}...)")]


Chunks = Callable[[int, int], Iterator[LandmarkSet]]


@contextmanager
def open_images(
    part: Part,
    head: ResultSet,
    fit: Statement,
    given: Sequence[Path],
    digests: Callable[[Path], str],
) -> Iterator[tuple[Chunks | None, Wrong]]:
    """Open the landmarks of a part as its fit read them, if they are given; and what is wrong.

    The files are told apart by their digests, then by their names. Gives chunks(size, count).
    """
    if not given:
        yield None, []
        return
    from shapefit.config.commands.input import LandmarksConfig

    files, wrong = pair_files(part.inputs or fit.landmarks, given, fit.digests, digests)
    if len(files) < len(part.inputs or fit.landmarks):
        yield None, wrong
        return
    place = ", ".join(map(str, files)) + ": landmark names"
    keys = LandmarksConfig.model_fields.keys() & fit.options.keys() - {"data"}
    try:
        reading = LandmarksConfig(**{key: fit.options[key] for key in keys})
    except ValueError:
        raise input_error(part.file, "does not state how its landmarks were read", FIX) from None
    rows = None if part.rows is None else slice(*part.rows)
    joined = METHODS[fit.method].sequences  # without identity over frames detections are no motion
    options = input_options(reading, "motion" if joined else "none")
    with open_landmarks(files, options, rows) as source:
        joints = find_joints(
            source.head.landmark_names, head.landmark_names, in_place=fit.has_prior
        )

        def as_fitted(images: LandmarkSet) -> LandmarkSet:
            if fit.calibrated and REMOVED in head.columns:
                lens = {name: head.columns[name] for name in (CAMERA_MATRIX, REMOVED)}
                lens[DISTORTION] = lens.pop(REMOVED)
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

    That is the one with the digest that is stated, else the one whose path ends most alike.
    """
    files, wrong = [], Wrong()
    for name in named:
        known, parts = stated.get(name), PurePath(name).parts[::-1]

        def alike(path: Path, known: str | None = known, parts: Sequence[str] = parts) -> int:
            if known is not None and digests(path) == known != STREAM:
                return len(parts) + 1
            own = zip(path.resolve().parts[::-1], parts, strict=False)
            return next((i for i, (a, b) in enumerate(own) if a != b), len(parts))

        best = max(given, key=alike)
        if alike(best) == 0 and (len(named) > 1 or len(given) > 1):
            wrong.append((name, "is a file of the fit that is not given by --landmarks"))
            continue
        files.append(best)
        wrong += compare(best, known, name, digests)
    return files, wrong


@dataclass
class Tally:
    """What became of the claims, summed up over all files of a result.

    files: claims of whole files that are false; unread: images of parts that could not be checked.
    """

    request: Request
    methods: dict[str, Statement] = field(default_factory=dict)
    images: int = 0
    certified: int = 0
    false: int = 0
    empty: int = 0
    files: int = 0
    unread: int = 0

    def add(self, claims: Claims, certified: Any) -> None:
        """Take in the claims of some more images."""
        self.images += len(claims.fitted)
        self.certified += int(certified.sum())
        self.false += int(claims.missed.sum())
        self.empty += int((~claims.fitted).sum())

    def values(self) -> dict[str, Any]:
        """Return the numbers of the summary."""
        numbers = {name: value for name, value in vars(self).items() if isinstance(value, int)}
        return numbers | {"methods": [*self.methods], "landmarks": bool(self.request.landmarks)}

    def lines(self) -> Iterator[str]:
        """Yield the summary: what is certified of how many images, what is false."""
        if not self.methods or not self.images + self.unread:
            yield "No image was checked."
            return
        total = f"of {counted(self.images + self.unread, 'image')}"
        (method, fit), *_ = self.methods.items()
        why = "the convex program is solved to within the gap that is stated"
        if not fit.certified:
            none = "no certificate is stored" if method in CERTIFIED else "has no certificate"
            why = "states its gap, which is not checked" if method == "global" else none
        yield f"Method     {method}"
        yield f"Certified  {self.certified} {total}: {why}"
        if self.empty:
            yield f"No shape   {self.empty} {total}"
        landmarks = "landmarks" if self.request.landmarks else "landmarks only with --landmarks"
        yield f"Checked    digests, datasets, ranges; {landmarks}"
        wrong = f", and {counted(self.files, 'claim')} of whole files" * bool(self.files)
        yield f"False      {self.false + self.unread} {total}{wrong}"
