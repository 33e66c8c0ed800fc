"""`info`: what files hold, and the next command."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from shapefit.config import CONFIGS, InfoConfig
from shapefit.config.paths import find_dictionaries, find_presets
from shapefit.dictionary.model import SUITS, describe_learning
from shapefit.errors import InputError, abbreviate, counted, input_error, listed
from shapefit.io import (
    LandmarkSet,
    open_landmarks,
    open_shapes,
    read_dictionary,
)
from shapefit.io.detect import detect_format, group_inputs
from shapefit.io.formats import FileFormat
from shapefit.io.inputs import is_stream, source_name
from shapefit.io.layout import UNKNOWN_UNIT
from shapefit.io.listing import OPTIONAL, find_kind
from shapefit.io.options import InputOptions, input_options
from shapefit.io.readers.items import read_poses
from shapefit.io.records import Records
from shapefit.io.skeletons import installed_skeletons, skeletons_of_size
from shapefit.io.source import Source, open_results
from shapefit.pipelines.joints import is_of_people
from shapefit.pipelines.outcome import Failure, Outcome, unread
from shapefit.pipelines.partition.manifest import Manifest, find_folders, sum_up

BATCH, MOST_LANDMARKS = 1 << 14, 1 << 22
"""Items that are looked at, the first of a file, and the landmarks of these together."""

CAMERA = ("camera_matrix", "distortion", "image_size", "extrinsic_rotation")
"""Datasets that say how the camera saw the landmarks."""

FIRST_OF_TABLES = 1 << 18
"""Landmarks of a table that are read; of more the number of items is estimated."""

LISTED_FILES = 3
"""Of one recording that a command names one by one."""

NEXT = "next"

Line = tuple[str, str]


def run(config: InfoConfig) -> Iterator[Outcome]:
    """Describe every input; yields one Outcome with the text as its note.

    Raises InputError where none can be read.
    """
    if not config.files:
        yield Outcome(note=describe_installed())
        return
    options = input_options(config)
    for path in config.files:
        if is_stream(path):
            found = "standard input can be read only once"
            raise input_error("-", found, "save it to a file and name that")
    descriptions: list[list[Line]] = []
    notes: tuple[str, ...] = ()
    failures: list[Failure] = []
    problems: list[str] = []

    def fail(path: Path, error: InputError) -> None:
        problems.extend(error.problems)
        failures.append(unread(path, error))

    known: list[Path] = []
    folders = find_folders(config.files)
    for folder, manifest in folders.items():
        for part in (folder / name for name in manifest.done):
            try:
                descriptions.append(_of_folder(folder, manifest, dict(_of_result(part))))
                break  # all others are like the first that can be read
            except InputError as error:
                fail(part, error)
    for path in config.files:
        if path.parent in folders:
            continue
        try:
            detect_format(path, options.format)
        except InputError as error:
            fail(path, error)
        else:
            known.append(path)
    for form, paths in group_inputs(known, options):
        try:
            lines, warnings = _describe(form, paths, options)
        except InputError as error:
            fail(paths[0], error)
        else:
            descriptions.append(lines)
            notes += warnings
    if not descriptions:
        raise InputError(problems)
    yield Outcome(
        done=len(config.files),
        failures=tuple(failures),
        warnings=notes,
        note="\n\n".join(map(_as_text, descriptions)),
        data=lambda: [{key or "name": text for key, text in lines} for lines in descriptions],
    )


def describe_installed() -> str:
    """Return the names of installed dictionaries, configs and skeletons, for the terminal."""
    configs = {command: ", ".join(find_presets(command)) for command in CONFIGS}
    lines = ["dictionaries (-d NAME)", f"  {', '.join(find_dictionaries())}", "configs (-c NAME)"]
    lines += [f"  {command}: {names}" for command, names in configs.items() if names]
    skeletons = installed_skeletons().values()
    lines += ["skeletons (--keypoints NAME)"]
    lines += [f"  {each.name}: {len(each.landmark_names)} landmarks" for each in skeletons]
    return "\n".join(lines)


def _as_text(lines: Sequence[Line]) -> str:
    (_, title), *others = lines
    return "\n".join([title, *(f"  {name + ':':<13} {text}" for name, text in others)])


def _describe(
    known: FileFormat, paths: tuple[Path, ...], options: InputOptions
) -> tuple[list[Line], tuple[str, ...]]:
    """Return what is said of one input, and warnings about it."""
    path = paths[0]
    kind = find_kind(path, options)
    name = source_name(path) if len(paths) == 1 else f"{path.parent} ({len(paths):,} files)"
    title = [("", name), ("format", known.title)]
    if kind == "dictionary":
        return title + _of_dictionary(path), ()
    if kind == "result":
        return title + _of_result(path), ()
    if known.read_poses is not None:
        recording = read_poses(known, paths, keep=True)
        title += (
            [("frames", f"{recording.frame_count:,}")] if recording.frame_count is not None else []
        )
        count = recording.landmark_count
        fitting = skeletons_of_size(count)
        nameless = recording.landmark_names is None and not recording.skeleton
        if nameless and options.keypoints is None and fitting:
            hint = " or ".join(f"`keypoints={name}`" for name in fitting)
            title.append(("landmarks", f"{count} without names: say which with {hint}"))
            names = installed_skeletons()[fitting[0]].landmark_names
            following = _following(kind, paths, replace(options, keypoints="NAME"), names)
            return [*title, (NEXT, following)], recording.notes
    opened = None
    if kind == "landmarks":
        opened = open_landmarks(paths, options, check=False, first=FIRST_OF_TABLES)
    with opened or open_shapes(
        paths, options, gaps=True, check=False, first=FIRST_OF_TABLES
    ) as source:
        sample = _first(source)
        noun = "image" if kind == "landmarks" else "shape"
        lines = title + _of_records(sample, source, noun)
        if isinstance(source.head, LandmarkSet):
            stated = "" if source.states_y_axis else ", as the file does not say"
            lines.append(("y axis", f"{source.head.y_axis}{stated}"))
        lines.append((NEXT, _following(kind, paths, options, source.head.landmark_names)))
        return lines, source.notes


def _first(source: Source[Any]) -> Any:
    """Return the first items of a source."""
    most = MOST_LANDMARKS // max(1, len(source.head.landmark_names))
    return source.first(min(BATCH, max(1, most)))


def _of_records(sample: Records, source: Source[Any], noun: str) -> list[Line]:
    """Describe the items of a file by its head and its first items."""
    names, sequences = sample.landmark_names, dict.fromkeys(filter(None, sample.sequences or ()))
    about, count = source.estimate, source.count
    number = f"{count:,}" if about is None else f"about {about:,}"
    of = "" if len(sample) == (about or count) else f" (of the first {len(sample):,})"
    lines = [(f"{noun}s", number), ("landmarks", f"{len(names)}: {abbreviate(names)}")]
    if sequences:
        lines.append(("sequences", f"{len(sequences)}: {abbreviate(list(sequences))}{of}"))
        rate = sample.frame_rate
        lines.append(("frame rate", "unknown" if rate is None else f"{rate:g} Hz"))
    known = np.isfinite(sample.points).all(axis=1)
    lines.append(("missing", f"{1 - known.sum() / max(known.size, 1):.1%} of the landmarks{of}"))
    confidence = sample.confidence if isinstance(sample, LandmarkSet) else None
    if confidence is not None and known.any():
        least, most = confidence[known].min(), confidence[known].max()
        lines.append(("confidence", f"{least:.3g} to {most:.3g}"))
    lines.append(("unit", sample.unit if sample.unit != UNKNOWN_UNIT else "not stated"))
    if camera := [name for name in CAMERA if name in sample.columns]:
        lines.append(("camera", listed(camera, "and")))
    return lines


def _of_folder(folder: Path, manifest: Manifest, first: Mapping[str, str]) -> list[Line]:
    """Describe a folder of results by its manifest, and what all of them share by the first."""
    shared = [(name, first[name]) for name in ("landmarks", "unit")]
    title = [("", source_name(folder)), ("kind", f"folder with {first['kind']}")]
    following = [(NEXT, f"shapefit eval {_typed(folder)} --truth SHAPES -o report")]
    return title + sum_up(manifest.done) + shared + following


def _of_result(path: Path) -> list[Line]:
    with open_results([path], OPTIONAL, check=False, old=True, first=FIRST_OF_TABLES) as source:
        head = source.head
        lines = [("kind", f"result of {head.attributes.get('method', 'fit')}")]
        lines += _of_records(_first(source), source, "image")
        if estimated := head.attributes.get("estimated"):
            lines.append(("estimated", str(estimated)))
        return [*lines, (NEXT, f"shapefit view {_typed(path)}")]


def _of_dictionary(path: Path) -> list[Line]:
    dictionary = read_dictionary(path, old=True)
    names = dictionary.landmark_names
    prior = dictionary.prior
    has = "none" if prior is None else counted(len(prior.weights), "component")
    lines = [
        ("kind", f"dictionary of {counted(dictionary.k, 'atom')}"),
        ("landmarks", f"{len(names)}: {abbreviate(names)}"),
        ("prior", has),
        ("unit", dictionary.unit if dictionary.unit != UNKNOWN_UNIT else "not stated"),
    ]
    lines += [("learned", text) for text in describe_learning(dictionary)]
    origin = ("source", "licence", "acknowledgement")
    lines += [(k, text) for k in origin if (text := dictionary.provenance.get(k))]
    installed = {file: name for name, file in find_dictionaries().items()}
    given = installed.get(path) or _typed(path)
    with_prior = prior is not None and SUITS not in dictionary.provenance
    method = " --set method=posterior" if with_prior else ""
    lines.append((NEXT, f"shapefit fit LANDMARKS -d {given} -o result.h5{method}"))
    return lines


def _following(
    kind: str, paths: Sequence[Path], options: InputOptions, names: Sequence[str]
) -> str:
    """Return the command to go on with; for joints of people one that needs no dictionary."""
    given = [f"--set keypoints={options.keypoints}"] if options.keypoints else []
    given += [f"--set individual={shlex.quote(options.individual)}"] if options.individual else []
    if options.image_size:
        given.append(f"--set image_size=[{','.join(f'{side:g}' for side in options.image_size)}]")
    more = "".join(f" {each}" for each in given)
    files = [paths[0].parent / f"*{paths[0].suffix}"] if len(paths) > LISTED_FILES else paths
    what = " ".join(map(_typed, files))
    if kind == "landmarks":
        with_what = "-d people" if is_of_people(names) else "-d DICT.h5"
        return f"shapefit fit {what} {with_what} -o result.h5{more}"
    return f"shapefit learn-dict {what} -o dict.h5{more}"


def _typed(path: Path) -> str:
    """Return a path as it is typed in a shell: relative to the working folder if it is inside."""
    here = Path.cwd()
    return shlex.quote(str(path.relative_to(here) if path.is_relative_to(here) else path))
