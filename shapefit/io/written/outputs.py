"""Writers of files in metres: records in, one file per individual out, all of them or none."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from pathlib import Path, PurePosixPath

from shapefit.errors import input_error
from shapefit.io.atomic import atomic_path, check_output, file_stem, staged_files, write_and_sync
from shapefit.io.layout import Layout
from shapefit.io.options import OutputOptions, Summary
from shapefit.io.writing import NOTHING_APPENDED
from shapefit.io.written.metres import Solid
from shapefit.io.written.motion import (
    Motion,
    find_motion,
    find_tracks,
    points_of,
    write_verdicts,
)
from shapefit.stores import UrlPath

Write = Callable[[Path, Sequence[Motion]], None]
"""Fills a new file with motions that belong in one."""

Prepare = Callable[[Sequence[Motion], str], tuple[list[Motion], str]]
"""Makes of motions what a format holds, with a note; raises InputError at a place if it cannot."""

Group = Callable[[Sequence[Motion]], dict[str, list[Motion]]]
"""Parts motions by file: what its name ends with -> those that it holds."""

Output = Callable[[Path, Layout, OutputOptions], AbstractContextManager["MotionWriter"]]


class MotionWriter:
    """Takes shapes or results; keeps their points, as the scale of a sequence takes all of it."""

    def __init__(self, options: OutputOptions) -> None:
        self.attributes: dict[str, str | float | int] = {}
        self.summary = Summary()
        self._parts: list[Solid] = []
        self._options = options

    def append(self, record: Solid) -> None:
        """Take the items of a record after those that are there."""
        self._parts.append(points_of(record))

    def motions(self, place: str) -> list[Motion]:
        """Return all sequences in metres. Raises ValueError where nothing was appended."""
        if not self._parts:
            raise ValueError(NOTHING_APPENDED)
        tracks = find_tracks(self._parts, place)
        self._parts.clear()
        return [find_motion(track, self._options, place) for track in tracks]


def motion_output(
    write: Write, group: Group, unit: str = "m", prepare: Prepare | None = None
) -> Output:
    """Return what gives a writer to files that appear on a clean exit: `target`, or one per group.

    Several are named after the target: man.trc becomes man_NAME.trc. What is returned raises
    InputError where they cannot be written; those of an earlier run then stay as they were.
    """

    @contextmanager
    def output(target: Path, form: Layout, options: OutputOptions) -> Iterator[MotionWriter]:
        if isinstance(target, UrlPath):
            found = "motion can be several files, which do not appear together in an object store"
            raise input_error(target, found, "write it to this machine, and copy it there")
        check_output(target)
        writer = MotionWriter(options)
        yield writer
        motions, note = writer.motions(str(target)), ""
        if prepare is not None:
            motions, note = prepare(motions, str(target))
        files = _files(target, group(motions), write)
        if len(files) == 1:
            with atomic_path(target) as path:
                write(path, motions)
        else:
            _write_staged(target, files)
        paths = [target] if len(files) == 1 else [target.parent / name for name in files]
        writer.summary = _summary(motions, paths, unit, note)

    return output


def by_individual(motions: Sequence[Motion]) -> dict[str, list[Motion]]:
    """Give each motion a file of its own, named by its sequence without what all begin with."""
    return dict(
        zip(_own_names([each.name for each in motions]), ([m] for m in motions), strict=True)
    )


def by_video(motions: Sequence[Motion]) -> dict[str, list[Motion]]:
    """Put the individuals of a video in one file; a sequence is `video/individual`, or a video."""
    groups: dict[str, list[Motion]] = {}
    for motion in motions:
        groups.setdefault(motion.name.rpartition("/")[0] or motion.name, []).append(motion)
    return groups


def _files(
    target: Path, groups: dict[str, list[Motion]], write: Write
) -> dict[PurePosixPath, Callable[[Path], None]]:
    """Return the files to write, by name: a motion file per group, and its verdicts beside it."""
    resolved = Path(os.path.realpath(target))
    files: dict[PurePosixPath, Callable[[Path], None]] = {}
    for name, motions in zip(_plain_names(groups), groups.values(), strict=True):
        stem = file_stem(f"{resolved.stem}_{name}") if len(groups) > 1 else resolved.stem
        files[PurePosixPath(f"{stem}{resolved.suffix}")] = partial(_write_group, write, motions)
        if verdicts := [each.verdicts for each in motions if each.verdicts]:
            files[PurePosixPath(f"{stem}_frames.csv")] = partial(write_verdicts, verdicts)
    return files


def _write_group(write: Write, motions: Sequence[Motion], path: Path) -> None:
    write(path, motions)


def _write_staged(target: Path, files: dict[PurePosixPath, Callable[[Path], None]]) -> None:
    """Write files that appear together."""
    with staged_files(Path(os.path.realpath(target)).parent) as staged:
        for name, write in files.items():
            staged.write(name, partial(write_and_sync, write), name.stem)


def _plain_names(endings: Iterable[str]) -> list[str]:
    """Return endings without / and spaces; those that become the same get a number."""
    names: dict[str, None] = {}
    for ending in endings:
        plain = name = ending.replace("/", "_").replace(" ", "_")
        number = 1
        while name in names:
            number += 1
            name = f"{plain}_{number}"
        names[name] = None
    return list(names)


def _own_names(names: Sequence[str]) -> list[str]:
    """Return names without the folders that all begin with: cam01/a, cam01/b -> a, b."""
    parts = [name.split("/") for name in names]
    shared = 0
    while all(len(part) > shared + 1 and part[shared] == parts[0][shared] for part in parts):
        shared += 1
    return ["/".join(part[shared:]) for part in parts]


def _summary(motions: Sequence[Motion], paths: Sequence[Path], unit: str, note: str) -> Summary:
    said = dict.fromkeys(f"in {unit} by {each.size}, {each.axes}" for each in motions)
    said |= {note: None} if note else {}
    warnings = dict.fromkeys(text for each in motions for text in each.warnings)
    return Summary(note="; ".join(said), warnings=tuple(warnings), written=tuple(paths))
