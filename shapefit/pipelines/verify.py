"""`verify`: a result in, every claim of it that does not hold out.

Of each image: the certificate of the convex program, where the method has one; landmarks equal to
those of the file, where it is given; numbers in their ranges. Of each file: the digests of what it
was made of, and that the datasets of its method are there. Nothing else is claimed, and nothing
that a result names is opened.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from itertools import repeat
from pathlib import Path
from typing import Any, NamedTuple

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
from shapefit.pipelines.result import Failure, Result, unread
from shapefit.threads import side_by_side
from shapefit.verification.certificate import (
    CERTIFICATE,
    Claims,
    Program,
    check_certificate,
    check_ranges,
)

CHUNK = 512
"""Images that are checked together."""
STREAM = "stream"
"""Stands for the digest of what could not be read twice."""
STRAIGHT = 1e-8
"""Of the largest coordinate by which landmarks without the distortion of a lens may be off."""
ALWAYS = "shapes landmarks lambda scale translation rotation status objective"
ERROR_BARS = " shape_sd shape_correlation p_value inlier_probability trusted reasons"
POINTS = {"landmarks", "shape_correlation"}
POINTS |= {f"input_{name}" for name in ("shapes", "shape_sd", "shape_correlation")}
"""Datasets of a result with one point a row, in the file and maybe in memory, too."""
CERTIFIED = ("convex", "convex+refine")
"""Methods with a certificate."""
DEFAULTS: Mapping[str, tuple[Callable[[Any], Any], Any]] = {
    "outliers": (str, "none"),
    "outlier_threshold": (float, 0.1),
    "tolerance": (float, 1e-6),
}
"""Keys that say which program it is."""
FIX = "give a result that `shapefit fit` wrote to a name in .h5"

Digests = Callable[[Path], str]
Chunks = Callable[[int], Iterator[LandmarkSet]]


class Request(NamedTuple):
    """A result to verify, the dictionary of its fit and, if given, the landmarks."""

    result: Path
    dictionary: Path
    landmarks: tuple[Path, ...] = ()


class Part(NamedTuple):
    """A file of results; the inputs and range of rows that a manifest states, None without one."""

    file: Path
    inputs: Sequence[str] | None = None
    rows: tuple[int, int] | None = None


class Statement(NamedTuple):
    """What a result states of its fit: the config, and the digests of files.

    certified: its method has a certificate, and it is stored.
    """

    config: Mapping[str, Any]
    digests: Mapping[str, str]
    certified: bool


def run(request: Request) -> Generator[Result, None, None]:
    """Verify every image of a result; yields a Result per chunk, and the summary as the last.

    Raises InputError where the result is no HDF5 result of `fit`, or does not go with the
    dictionary or the landmarks; for a folder only where that is so of every part.
    """
    parts, wrong, listed = find_parts(request.result)
    dictionary, digests = read_dictionary(request.dictionary), cache(digest)
    tally = Counter(images=0, certified=0, false=0, empty=0, files=len(wrong), unread=0)
    methods: dict[str, Statement] = {}
    yield Result(failures=tuple(wrong))
    errors: list[InputError] = []
    for part in parts:
        try:
            yield from verify_part(part, request, dictionary, tally, methods, digests)
        except InputError as error:
            errors.append(error)
            if len(errors) == len(parts):
                raise InputError(line for one in errors for line in one.problems) from None
            tally["files"] += 1
            yield Result(failures=(unread(part.file, error),))
    tally["unread"] = max(listed - tally["images"], tally["unread"])
    data = {**tally, "methods": [*methods], "landmarks": bool(request.landmarks)}
    if tally["images"] + tally["unread"]:
        note = "\n".join(summary_lines(tally, methods, bool(request.landmarks)))
        yield Result(note=note, data=lambda: data)
    else:
        none = Failure(str(request.result), "holds no image")
        yield Result(failures=(none,), note="No image was checked.", data=lambda: data)


def find_parts(result: Path) -> tuple[list[Part], list[Failure], int]:
    """Return the files of a result, what is false in its manifest, and how many images it lists."""
    if not result.is_dir():
        return [Part(result)], [], 0
    from shapefit.pipelines.partition.manifest import read_manifest

    manifest = read_manifest(result)
    if manifest is None:
        raise input_error(result, "is a folder without results", "name a result in it")
    parts, images = [], 0
    unlisted = {path.name for path in result.glob("part-*")} - manifest.done.keys()
    wrong = [Failure(name, "is not in the manifest") for name in sorted(unlisted)]
    try:
        for name, entry in manifest.done.items():
            file, images = result / name, images + int(entry["images"])
            rows = entry["rows"] and (int(entry["rows"][0]), int(entry["rows"][1]))
            if file.is_file():
                parts.append(Part(file, tuple(map(str, entry["inputs"])), rows))
            if not file.is_file() or entry["bytes"] != file.stat().st_size:
                wrong.append(Failure(name, "is not the file that `fit` wrote, by its size"))
    except (KeyError, TypeError, ValueError, IndexError) as error:
        fault = f"is not a manifest of results ({type(error).__name__}: {error})"
        raise input_error(manifest.path, fault, "fit again") from None
    return parts, wrong, images


def verify_part(
    part: Part,
    request: Request,
    dictionary: Dictionary,
    tally: Counter[str],
    methods: dict[str, Statement],
    digests: Digests,
) -> Generator[Result, None, None]:
    """Verify the images of one file, and what it states of them all."""
    require_file(part.file)
    if not begins_with(part.file, HDF5_SIGNATURE):
        raise input_error(part.file, "is not HDF5, and tables hold points only", FIX)
    with open_results([part.file], (), check=False) as results:
        head = results.head
        fit = read_statement(head.attributes, part.file)
        methods[fit.config["method"]] = fit
        missing = required(fit, head.columns) - head.columns.keys()
        wrong = [(name, "is missing, and every such fit writes it") for name in sorted(missing)]
        config = str(head.attributes["config"]).encode()
        if hashlib.sha256(config).hexdigest() != head.attributes.get("config_digest"):
            wrong.append(("config", "is not that of the fit, by its digest"))
        named = fit.config["dictionary"]
        needed = [named, *(fit.config["landmarks"] if part.rows is None else ())]
        wrong += [(name, "has no digest") for name in needed if name not in fit.digests]
        wrong += compare(request.dictionary, fit.digests.get(named), named, digests)
        with open_images(part, head, fit, request.landmarks, digests) as (source, unlike):
            failures = tuple(Failure(*reason) for reason in [*wrong, *unlike])
            tally["files"] += len(failures)
            yield Result(failures=failures)
            if missing:
                tally["unread"] += results.count
                return
            program = read_program(head, part.file, request.dictionary, dictionary, fit)
            images = repeat(None) if source is None else source(results.count)
            batches = results.batches(CHUNK) if results.count else iter(())
            pairs = zip(batches, images, strict=False)
            for result, claims, certified in side_by_side(
                lambda pair: check_chunk(*pair, program, fit.certified), pairs, 1
            ):
                counts = {"images": len(result), "certified": int(certified.sum())}
                counts |= {"false": len(claims.reasons), "empty": int((~claims.fitted).sum())}
                tally.update(counts)
                reasons = sorted(claims.reasons.items())
                failures = tuple(Failure(result.items[i], why) for i, why in reasons)
                yield Result(done=len(result), total=results.count, failures=failures)


def read_statement(attributes: Mapping[str, Any], file: Path) -> Statement:
    """Return what the attributes `config` and `inputs` of a result say.

    Raises InputError where they are not those of a fit.
    """
    try:
        config, digests = (parse_json(attributes.get(name, "{}")) for name in ("config", "inputs"))
        method, landmarks = config["method"], config["landmarks"]
        landmarks = [landmarks] if isinstance(landmarks, str) else list(map(str, landmarks))
        config |= {"dictionary": str(config["dictionary"]), "landmarks": landmarks}
        for key, (type_of, default) in DEFAULTS.items():
            value = config.get(key)
            config[key] = default if value is None else type_of(value)
        stored = config.get("save", {}).get("proof") is not False
        stated = {str(name): str(value) for name, value in digests.items()}
        if method not in METHODS:
            raise ValueError(f"no method {method}")
        return Statement(config, stated, stored and method in CERTIFIED)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        wrong = f"{type(error).__name__}: {error}"
        fault = f"its attributes `config` and `inputs` are not those of a fit ({wrong[:200]})"
        raise input_error(file, fault, FIX) from None


def required(fit: Statement, columns: Mapping[str, Any]) -> set[str]:
    """Return the datasets that every such fit writes."""
    name, perspective = fit.config["method"], "focal" in columns
    names = ALWAYS + (ERROR_BARS if METHODS[name].has_prior else "")
    names += " coefficients" if METHODS[name].mixes_atoms else ""
    names += " omitted" if fit.config.get("leave_one_out") is not None else ""
    if fit.certified:
        prefix = "" if name == "convex" and not perspective else "convex_"
        names += f" {' '.join(CERTIFICATE)} {prefix}objective {prefix}relative_gap"
    bounded = name in ("convex", "global") or fit.config["outliers"] not in ROBUST
    names += " relative_gap" if bounded and fit.certified and not perspective else ""
    return set(names.split())


def read_program(
    head: ResultSet, file: Path, path: Path, dictionary: Dictionary, fit: Statement
) -> Program:
    """Return the convex program of a fit. Raises InputError for another dictionary."""
    names = f"{path}: landmark names"
    columns = columns_by_name(dictionary.landmark_names, head.landmark_names, names)
    k = dictionary.k if head.coefficients is None else head.coefficients.shape[1]
    omits = fit.config.get("leave_one_out") is not None
    if k != dictionary.k or (omits and dictionary.atom_items is None):
        fault = f"has {counted(dictionary.k, 'atom')}, and {file} coefficients of {k}"
        raise input_error(path, fault, "give the dictionary of the fit, whose atoms have items")
    outliers, perspective = fit.config["outliers"], "focal" in head.columns
    return Program(
        atoms=np.ascontiguousarray(dictionary.atoms[:, :, columns]),
        atom_items=dictionary.atom_items if omits else None,
        refined=perspective or fit.config["method"] != "convex",
        bounds=not perspective and outliers not in ROBUST,
        searched=outliers not in ("none", *ROBUST),
        loss=outliers if outliers in ROBUST else "squared",
        beta=fit.config["outlier_threshold"],
        tolerance=fit.config["tolerance"],
    )


def check_chunk(
    result: ResultSet, given: LandmarkSet | None, program: Program, certified: bool
) -> tuple[ResultSet, Claims, Any]:
    """Return the claims of some images, and which of them are certified (n,)."""
    columns = result.columns
    for name in POINTS & columns.keys() - result.LAYOUT.datasets.keys():
        columns[name] = np.ascontiguousarray(np.swapaxes(columns[name], 1, 2))
    claims = Claims(np.isfinite(columns["scale"]) & np.isfinite(columns["shapes"]).all(axis=(1, 2)))
    bounded = np.zeros_like(claims.fitted)
    with np.errstate(all="ignore"):  # what is not finite holds for nothing
        check_ranges(columns, claims)
        if certified:
            atom = columns["transform_atom"]
            if ((atom < 0) | (atom >= len(program.atoms))).any():
                fault = f"transforms of atoms that are not among the {len(program.atoms)}"
                raise input_error("transform_atom", fault, "give the dictionary of the fit")
            bounded = check_certificate(columns, program, claims)
        if given is not None:
            check_landmarks(columns, result, given, claims)
    return result, claims, bounded & ~claims.missed


def check_landmarks(
    columns: Mapping[str, Any], result: ResultSet, given: LandmarkSet, claims: Claims
) -> None:
    """Claim that n results have the landmarks and confidences of a file, under their names."""
    everyone, visible = np.ones_like(claims.fitted), given.visible()
    in_file, stated = np.where(visible[:, None], given.landmarks, np.nan), columns["landmarks"]
    off = np.where(np.isnan(stated) & np.isnan(in_file), 0.0, np.abs(stated - in_file))
    allowed = (
        STRAIGHT * np.nanmax(np.abs(in_file), initial=1.0) if REMOVED in given.columns else 0.0
    )
    claims.near("landmarks are those of the file", off, allowed, of=everyone)
    confidence = given.weights() if given.confidence is None else given.confidence
    same = np.equal(columns.get("confidence", 1.0), confidence) | ~visible
    claims.hold("confidences are those of the file", same, of=everyone)
    same = np.array(result.items, object) == np.array(given.items, object)
    claims.hold("items are those of the file", same, of=everyone)


def compare(path: Path, stated: str | None, name: str, digests: Digests) -> list[tuple[str, str]]:
    """Return what is wrong with a file beside the digest that a fit states of it."""
    actual = digests(path)
    if stated is None or STREAM in (actual, stated) or actual == stated:
        return []
    reason = f"is not the file of the fit, {name}: the digests differ"
    return [(str(path), f"{reason} ({actual[:12]}... and {stated[:12]}...)")]


@contextmanager
def open_images(
    part: Part, head: ResultSet, fit: Statement, given: Sequence[Path], digests: Digests
) -> Iterator[tuple[Chunks | None, list[tuple[str, str]]]]:
    """Open the landmarks of a part as its fit read them, if they are given; and what is wrong.

    Gives chunks(count).
    """
    files, wrong = [], list[tuple[str, str]]()
    named = part.inputs or fit.config["landmarks"]
    for name in named if given else ():
        stated = fit.digests.get(name)
        file = pair(name, stated, given, digests, alone=len(named) == 1)
        if file is None:
            wrong.append((name, "is a file of the fit that is not given by --landmarks"))
        else:
            files.append(file)
            wrong += compare(file, stated, name, digests)
    if len(files) < len(named):
        yield None, wrong
        return
    from shapefit.config.commands.input import LandmarksConfig

    place = ", ".join(map(str, files)) + ": landmark names"
    keys = LandmarksConfig.model_fields.keys() & fit.config.keys() - {"data"}
    try:
        reading = LandmarksConfig(**{key: fit.config[key] for key in keys})
        calibrated = (fit.config.get("camera") or {}).get("calibration") is not None
    except (ValueError, AttributeError):
        raise input_error(part.file, "does not state how its landmarks were read", FIX) from None
    rows, method = None if part.rows is None else slice(*part.rows), METHODS[fit.config["method"]]
    # Without identity over frames detections are no motion.
    options = input_options(reading, "motion" if method.sequences else "none")
    with open_landmarks(files, options, rows) as source:
        names = source.head.landmark_names
        joints = find_joints(names, head.landmark_names, in_place=method.has_prior)

        def as_fitted(images: LandmarkSet) -> LandmarkSet:
            if calibrated and REMOVED in head.columns:
                lens = {CAMERA_MATRIX: head.columns[CAMERA_MATRIX]}
                lens[DISTORTION] = head.columns[REMOVED]
                images = images.with_columns(whole=lens)
            images = named_as_joints(undistorted(images, None), joints, place)
            return images.arrange(head.landmark_names, place, omit=True)

        def chunks(count: int) -> Iterator[LandmarkSet]:
            if source.count != count:
                fault = f"{counted(source.count, 'image')} for {counted(count, 'result')}"
                raise input_error(files[0], fault, f"give the landmarks of {part.file}")
            return map(as_fitted, source.batches(CHUNK))

        yield chunks, wrong


def pair(
    name: str, stated: str | None, given: Sequence[Path], digests: Digests, *, alone: bool
) -> Path | None:
    """Return the given file with a stated digest, else with this name, else the only one."""
    equal = [path for path in given if stated is not None and digests(path) == stated]
    equal += [path for path in given if path.resolve().name == Path(name).name]
    return next(iter(equal or (given if alone and len(given) == 1 else ())), None)


def summary_lines(
    tally: Mapping[str, int], methods: Mapping[str, Statement], with_landmarks: bool
) -> Iterator[str]:
    """Yield the summary: what is certified of how many images, what is false."""
    total = f"of {counted(tally['images'] + tally['unread'], 'image')}"
    (method, fit), *_ = methods.items()
    why = "the convex program is solved to within the gap that is stated"
    if not fit.certified:
        none = "no certificate is stored" if method in CERTIFIED else "has no certificate"
        why = "states its gap, which is not checked" if method == "global" else none
    wrong = f", and {counted(tally['files'], 'claim')} of whole files" if tally["files"] else ""
    yield f"Method     {method}"
    yield f"Certified  {tally['certified']} {total}: {why}"
    if tally["empty"]:
        yield f"No shape   {tally['empty']} {total}"
    only = "" if with_landmarks else " only with --landmarks"
    yield f"Checked    digests, datasets, ranges; landmarks{only}"
    yield f"False      {tally['false'] + tally['unread']} {total}{wrong}"
