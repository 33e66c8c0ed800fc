"""`info`: what files hold, and the next command."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from shapefit.arrays import Flags
from shapefit.config import CONFIGS, InfoConfig
from shapefit.config.paths import find_dictionaries, find_presets
from shapefit.dictionary.model import SUITS, describe_learning
from shapefit.errors import InputError, abbreviate, as_typed, counted, listed, printable
from shapefit.io import (
    open_landmarks,
    open_shapes,
    read_dictionary,
)
from shapefit.io.detect import FORMATS, detect_format, group_inputs
from shapefit.io.formats import FileFormat
from shapefit.io.inputs import source_name
from shapefit.io.layout import UNKNOWN_UNIT
from shapefit.io.options import InputOptions, input_options
from shapefit.io.readers.tables import read_described_table
from shapefit.io.skeletons import installed_skeletons
from shapefit.io.source import (
    OPTIONAL_DATASETS,
    LandmarkSource,
    ResultSource,
    ShapeSource,
    find_kind,
    open_results,
)
from shapefit.pipelines.joints import is_of_people
from shapefit.pipelines.partition.manifest import (
    Manifest,
    describe_parts,
    find_folders,
    numbers_of_parts,
)
from shapefit.pipelines.result import Numbers, Result, unreadable_file
from shapefit.pipelines.unfinished import describe_unfinished
from shapefit.records.items import Items

INSPECTED_ITEMS = 1 << 14
"""Of a file that are looked at."""

CAMERA_COLUMNS = ("camera_matrix", "distortion", "image_size", "extrinsic_rotation")
"""Datasets that say how the camera saw the landmarks."""

InfoLine = tuple[str, str]
"""A label and a text."""

OF_IMAGES = ("landmarks", "result")
"""Kinds of files whose items are images."""


AnySource = ResultSource | LandmarkSource | ShapeSource


class FileNumbers(NamedTuple):
    """What a file holds, in numbers; None for what it has not.

    items are images or shapes, estimated where only the first were read; missing, the
    share of landmarks; atoms, and components of the prior, of a dictionary.
    """

    items: int | None = None
    estimated: bool = False
    landmarks: int | None = None
    sequences: int | None = None
    frame_rate: float | None = None
    missing: float | None = None
    atoms: int | None = None
    components: int | None = None


class Description(NamedTuple):
    """What an input holds: its kind, lines for people, and numbers for programs."""

    kind: str
    lines: list[InfoLine]
    numbers: FileNumbers

    def as_plain(self) -> dict[str, object]:
        """Return the lines by their labels, and the numbers, as values of JSON."""
        return {**dict(self.lines), "numbers": self.numbers._asdict()}


HOW_TO_LEARN = (
    "`shapefit learn-dict SHAPES -o DICT.h5` learns one, from 3D shapes or from"
    " landmarks alone"
)
"""Where landmarks are those of no installed dictionary."""


def describe_files(config: InfoConfig) -> Iterator[Result]:
    """Describe every input; yields one Result with the text as its note.

    Files that cannot be read are failures. Raises InputError where none can be read.
    """
    if not config.files:
        yield Result(note=describe_installed())
        return
    options = input_options(config)
    folders = find_folders(config.files)
    descriptions = [
        describe_folder(folder, manifest) for folder, manifest in folders.items()
    ]
    of_folders = [numbers_of_parts(each.done.values()) for each in folders.values()]
    errors: dict[Path, InputError] = {}
    readable: list[Path] = []
    for path in config.files:
        if path.parent not in folders:
            try:
                detect_format(path, options.format)
                readable.append(path)
            except InputError as error:
                errors[path] = error
    warnings = describe_unfinished(config.files)
    for file_format, paths in group_inputs(readable, options):
        try:
            description, notes = describe_input(file_format, paths, options)
            descriptions.append(description)
            warnings += notes
        except InputError as error:
            errors[paths[0]] = error
    if not descriptions:
        raise InputError(
            [problem for error in errors.values() for problem in error.problems]
        )
    yield Result(
        done=len(config.files),
        failures=tuple(unreadable_file(path, error) for path, error in errors.items()),
        warnings=warnings,
        note="\n\n".join(format_lines(each.lines) for each in descriptions),
        numbers=sum_numbers(descriptions, of_folders),
        data=lambda: [each.as_plain() for each in descriptions],
    )


def sum_numbers(
    descriptions: Sequence[Description], folders: Sequence[Numbers]
) -> Numbers:
    """Return the number of images of all inputs; of one folder alone, all numbers."""
    counts = [
        each.numbers.items or 0 for each in descriptions if each.kind in OF_IMAGES
    ]
    numbers = folders[0] if len(descriptions) == len(folders) == 1 else Numbers()
    return numbers._replace(images=sum(counts) if counts else None)


def format_lines(lines: Sequence[InfoLine]) -> str:
    """Return labelled lines as one text that a terminal can show.

    The first line is the title, without its label.
    """
    (_, title), *others = [(name, printable(text)) for name, text in lines]
    labelled = [f"  {name + ':':<13} {text}" for name, text in others]
    return "\n".join([title, *labelled])


def describe_installed() -> str:
    """Return a text that lists installed dictionaries, configs and skeletons."""
    configs = {command: ", ".join(find_presets(command)) for command in CONFIGS}
    lines = [
        "dictionaries (-d NAME)",
        f"  {', '.join(find_dictionaries())}",
        "configs (-c NAME)",
    ]
    lines += [f"  {command}: {names}" for command, names in configs.items() if names]
    lines.append("skeletons (--keypoints NAME)")
    for skeleton in installed_skeletons().values():
        lines.append(f"  {skeleton.name}: {len(skeleton.landmark_names)} landmarks")
    return "\n".join(lines)


def describe_folder(folder: Path, manifest: Manifest) -> Description:
    """Return the description of a folder of results, as its manifest states it."""
    following = f"shapefit eval {as_typed(folder)} --truth SHAPES -o report"
    title = [("name", source_name(folder)), ("kind", "folder of results")]
    lines = [*title, *describe_parts(manifest.done), ("next", following)]
    images = numbers_of_parts(manifest.done.values()).images
    return Description("result", lines, FileNumbers(items=images))


def describe_input(
    file_format: FileFormat, paths: tuple[Path, ...], options: InputOptions
) -> tuple[Description, tuple[str, ...]]:
    """Return the description of what one input holds, and warnings about it."""
    kind = find_kind(paths[0], options)
    name = source_name(paths[0])
    if len(paths) > 1:
        name = f"{paths[0].parent} ({len(paths):,} files)"
    title = [("name", name), ("format", file_format.title)]
    if kind == "dictionary":
        lines, numbers = describe_dictionary(paths[0])
        return Description(kind, title + lines, numbers), ()
    source: AnySource
    if kind == "result":
        source = open_results(paths, OPTIONAL_DATASETS, head=True, old=True)
    elif kind == "landmarks":
        source = open_landmarks(paths, options, head=True)
    else:
        source = open_shapes(paths, options, gaps=True, head=True)
    with source:
        head = source.head
        names = head.landmark_names
        sample = source.first(INSPECTED_ITEMS)
        noun = "shape" if kind == "shapes" else "image"
        items = describe_items(source, sample, noun)
        if kind == "result":
            title.append(("kind", f"result of {head.attributes.get('method', 'fit')}"))
            estimated = head.attributes.get("estimated")
            if estimated:
                items.append(("estimated", str(estimated)))
        elif kind == "landmarks":
            stated = "" if source.states_y_axis else ", as the file does not say"
            items.append(("y axis", f"{head.y_axis}{stated}"))
        if file_format is FORMATS["table"]:
            items += read_described_table(paths[0], 3 if kind == "shapes" else 2).lines
        if kind == "landmarks" and not is_of_people(names):
            items.append(("dictionary", HOW_TO_LEARN))
        following = next_command(kind, paths, names, options.keypoints)
        lines = [*title, *items, ("next", following)]
        return Description(kind, lines, count_items(source, sample)), source.notes


def count_items(source: AnySource, sample: Items) -> FileNumbers:
    """Return the number of items of a source, and other numbers of a sample of it."""
    is_missing = ~np.isfinite(sample.points).all(axis=2)
    return FileNumbers(
        items=source.estimate,
        estimated=source.estimate > source.count,
        landmarks=len(sample.landmark_names),
        sequences=len(find_sequences(sample)),
        frame_rate=sample.frame_rate,
        missing=float(is_missing.mean()) if is_missing.size else None,
    )


def find_sequences(sample: Items) -> list[str]:
    """Return the names of the sequences of a sample."""
    return list(dict.fromkeys(filter(None, sample.sequences or ())))


def describe_items(source: AnySource, sample: Items, noun: str) -> list[InfoLine]:
    """Return labelled lines on the items of a source, by a sample of the first ones."""
    suffix = ""
    if len(sample) != source.estimate:
        suffix = f" (of the first {len(sample):,})"
    number = f"{source.count:,}"
    if source.estimate > source.count:
        number = f"about {float(f'{source.estimate:.2g}'):,.0f}"
    names = sample.landmark_names
    lines = [
        (f"{noun}s", number),
        ("landmarks", f"{len(names)}: {abbreviate(names)}"),
        *describe_sequences(sample, suffix),
    ]
    visible: Flags = np.asarray(np.isfinite(sample.points).all(axis=2))
    if visible.any():
        lines.append(("first", describe_point(sample, visible)))
    missing = 1 - visible.sum() / max(visible.size, 1)
    lines.append(("missing", f"{missing:.1%} of the landmarks{suffix}"))
    lines.append(("unit", "not stated" if sample.unit == UNKNOWN_UNIT else sample.unit))
    camera = [name for name in CAMERA_COLUMNS if sample.column(name) is not None]
    if camera:
        lines.append(("camera", listed(camera, "and")))
    return lines


def describe_sequences(sample: Items, suffix: str) -> Iterator[InfoLine]:
    """Yield labelled lines on the sequences, frame rate and gaps of a sample.

    Texts that are true of the sample only end with the suffix.
    """
    sequences = find_sequences(sample)
    if not sequences:
        return
    yield "sequences", f"{len(sequences)}: {abbreviate(sequences)}{suffix}"
    rate = sample.frame_rate
    yield "frame rate", "unknown" if rate is None else f"{rate:g} Hz"
    if sample.frames is None:
        yield "frames", "not numbered, so one follows the other"
    gaps = describe_gaps(sample)
    if gaps:
        yield "gaps", gaps + suffix


def describe_gaps(sample: Items) -> str:
    """Return a text on the frames that sequences miss, and on their longest gap.

    It is "" where none is, or files number none.
    """
    if sample.frames is None or sample.sequences is None:
        return ""
    missing = 0
    longest = 0
    where = ""
    last: dict[str, int] = {}
    rows = zip(sample.sequences, sample.frames.tolist(), sample.items, strict=True)
    for sequence, frame, item in rows:
        gap = 0
        if sequence in last and sequence:
            gap = frame - last[sequence] - 1
        last[sequence] = frame
        missing += max(gap, 0)
        if gap > longest:
            longest = gap
            where = item
    if not missing:
        return ""
    seconds = f" ({longest / sample.frame_rate:.3g} s)" if sample.frame_rate else ""
    return (
        f"{counted(missing, 'frame')} missing, at most {longest}{seconds}, before"
        f" {where}"
    )


def describe_point(sample: Items, visible: Flags) -> str:
    """Return a text on the first visible landmark: its item, name and coordinates."""
    row, column = np.argwhere(visible)[0].tolist()
    numbers = ", ".join(f"{value:g}" for value in sample.points[row, column])
    item, landmark = sample.items[row], sample.landmark_names[column]
    return f"{printable(item)}, {printable(landmark)} at ({numbers})"


def describe_dictionary(path: Path) -> tuple[list[InfoLine], FileNumbers]:
    """Return labelled lines on content, source and use of a dictionary; its numbers."""
    dictionary = read_dictionary(path, old=True)
    names = dictionary.landmark_names
    provenance = dictionary.provenance
    prior = "none"
    if dictionary.prior is not None:
        prior = counted(len(dictionary.prior), "component")
    lines = [
        ("kind", f"dictionary of {counted(dictionary.k, 'atom')}"),
        ("landmarks", f"{len(names)}: {abbreviate(names)}"),
        ("prior", prior),
        ("unit", "not stated" if dictionary.unit == UNKNOWN_UNIT else dictionary.unit),
    ]
    lines += [("learned", text) for text in describe_learning(dictionary)]
    for key in ("source", "licence", "acknowledgement"):
        if provenance.get(key):
            lines.append((key, provenance[key]))
    method = ""
    if dictionary.prior is not None and SUITS not in provenance:
        method = " --method posterior"
    installed = {file: name for name, file in find_dictionaries().items()}
    name = installed.get(path) or as_typed(path)
    lines.append(("next", f"shapefit fit LANDMARKS -d {name} -o result.h5{method}"))
    components = 0 if dictionary.prior is None else len(dictionary.prior)
    numbers = FileNumbers(
        landmarks=len(names), atoms=dictionary.k, components=components
    )
    return lines, numbers


def next_command(
    kind: str, paths: Sequence[Path], names: Sequence[str], keypoints: str | None
) -> str:
    """Return the next command to run on files: view, fit or learn-dict, by their kind.

    For landmarks of people it names the installed dictionary.
    """
    if kind == "result":
        return f"shapefit view {as_typed(paths[0])}"
    if len(paths) > 3:
        paths = [path.parent / f"*{path.suffix}" for path in paths]
    inputs = " ".join(dict.fromkeys(map(as_typed, paths)))
    more = f" --keypoints {keypoints}" if keypoints else ""
    if kind == "landmarks":
        dictionary = "people" if is_of_people(names) else "DICT.h5"
        return f"shapefit fit {inputs} -d {dictionary} -o result.h5{more}"
    return f"shapefit learn-dict {inputs} -o dict.h5{more}"
