"""`fit` into a folder: parts of the images, one result each, and a manifest of those that are done.

Running again does the parts that are missing, and those that changed or were damaged.
"""

from __future__ import annotations

import fnmatch
import hashlib
import json
import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

from shapefit.config import FitConfig
from shapefit.config.paths import FAILED, OLD_MANIFEST, ResultFolder
from shapefit.errors import abbreviate, counted, input_error, listed, printable
from shapefit.io import digest, read_dictionary
from shapefit.io.inputs import is_stream
from shapefit.io.names import check_items
from shapefit.io.source import open_results
from shapefit.pipelines.fit.prepare import Estimates, first_images, prepare
from shapefit.pipelines.outcome import Counted, Failure, Outcome, reading
from shapefit.pipelines.parts.executors import (
    Job,
    check_cluster,
    do_jobs,
    executor_of,
    wants_cluster,
)
from shapefit.pipelines.parts.manifest import (
    Entry,
    Manifest,
    held_folder,
    read_manifest,
    result_digest,
)
from shapefit.pipelines.parts.plan import Part, plan_parts
from shapefit.stores import STORAGE_OPTIONS, files_in, remove
from shapefit.threads import on_threads

OF_THE_RUN = (
    *("landmarks", "output", "dictionary", "data", "threads", "chunk"),
    *("scheduler", "scheduler_file", "workers", "dry_run", STORAGE_OPTIONS),
)
"""Keys that do not change what a part holds."""


def run(config: FitConfig) -> Iterator[Outcome]:
    """Lift landmarks part by part into the folder that is the output."""
    folder = config.output
    assert isinstance(folder, ResultFolder), "the output is a folder"
    check_parts(config)
    digests = digests_of(config)
    known = read_manifest(folder.path)
    yield from reading(config.landmarks)
    parts = plan_parts(config)
    kept, again = find_kept(known, parts, digests)
    if config.dry_run:
        lines = [f"{part.file}: {_words(part)}" for part in parts if part.file not in kept]
        note = f"{counted(len(lines), 'part')} to do, {len(parts) - len(lines)} done"
        yield Outcome(note=note, listing=tuple(lines))
        return
    if known is not None and kept:
        found = known.run["estimated"]
        estimates = Estimates(found["values"], *(tuple(found[it]) for it in ("lines", "warnings")))
    else:
        estimates = prepare(
            config, read_dictionary(config.dictionary), lambda: first_images(config, parts)
        )
    first = {**digests, "method": config.method, "estimated": asdict(estimates)}
    elsewhere = config.workers is not None or wants_cluster(config)
    if elsewhere and config.threads == 0:
        config = config.changed(threads=1)
    with held_folder(folder.path):
        manifest = Manifest(folder.manifest, first, kept)
        for line in estimates.lines:
            yield Outcome(line=line)
        before = f"{len(kept)} of {counted(len(parts), 'part')} done before"
        yield Outcome(warnings=(*estimates.warnings, *again), note=before)
        told = replace(estimates, lines=(), warnings=())
        shared = config.changed(landmarks=(), **estimates.values)  # each part names its own
        todo = [part for part in parts if part.file not in kept]
        jobs = deque(Job(part, shared, folder.path, told) for part in todo)
        lost: list[Failure] = []
        images, began = 0, time.monotonic()
        manifest.write()
        try:
            with (
                executor_of(config, jobs) as (start, at_once, line),
                closing(do_jobs(jobs, start, at_once)) as ended,
            ):
                yield Outcome(line=line)
                for number, done in enumerate(ended, 1):
                    images += done.outcome.done
                    if done.error is not None:
                        lost.append(_lost(done.part, done.error))
                        failed = {"status": FAILED, "error": lost[-1].reason}
                        manifest.add(done.part.describe() | failed)
                    else:
                        manifest.add(done.entry)
                    reached, seconds = len(manifest.done), time.monotonic() - began
                    left = len(parts) - reached - len(lost)
                    words = [f"{reached} of {counted(len(parts), 'part')} done"]
                    words += [f"{len(lost)} failed"] if lost else []
                    words += [f"{images / seconds:,.0f} images/s"] if images and seconds > 0 else []
                    words += [f"{in_time(left * seconds / number)} left"] if left else []
                    yield replace(done.outcome, note=", ".join(words))
        finally:
            manifest.write()
        of_earlier = {*fnmatch.filter(files_in(folder.path), "part-*.h5"), OLD_MANIFEST}
        for name in of_earlier - {part.file for part in parts}:
            remove(folder.path / name)
        equal = equal_items(folder.path, sorted(manifest.done)) if images else ()
        yield Outcome(
            failures=tuple(lost),
            warnings=equal,
            note=f"{len(manifest.done)} of {counted(len(parts), 'part')} done",
            written=(manifest.path,),
        )


def check_parts(config: FitConfig) -> None:
    """Raise InputError for what cannot be done part by part."""
    assert isinstance(config.output, ResultFolder)
    check_cluster(config)
    if any(map(is_stream, config.landmarks)):
        found = "standard input cannot be divided into parts"
        raise input_error("landmarks", found, "save it to a file and name that")
    for key in ("export",):
        if getattr(config, key).folder is not None:
            fix = "leave it out, and fit the images to be shown once more into a file"
            raise input_error(f"{key}.folder", "is not written for a folder of results", fix)


def digests_of(config: FitConfig) -> dict[str, str]:
    """Return the digests of what all parts depend on beside their inputs."""
    plain = {key: value for key, value in config.as_plain().items() if key not in OF_THE_RUN}
    text = json.dumps(plain, sort_keys=True)
    return {
        "config": hashlib.sha256(text.encode()).hexdigest(),
        "dictionary": digest(config.dictionary),
    }


def find_kept(
    known: Manifest | None, parts: Sequence[Part], digests: Mapping[str, str]
) -> tuple[dict[str, Entry], tuple[str, ...]]:
    """Return the lines of the parts that are done and as they were, and why others are not."""
    if known is None:
        return {}, ()
    changed = [name for name, value in digests.items() if known.run.get(name) != value]
    if changed:
        return {}, (f"all parts are done again: another {' and another '.join(changed)}",)
    done, folder = known.done, known.path.parent
    there = files_in(folder)
    held = [
        part.file
        for part in parts
        if part.file in there and part.describe().items() <= done.get(part.file, {}).items()
    ]
    found = on_threads(lambda file: result_digest(folder / file), held)
    kept = {
        file: done[file]
        for file, own in zip(held, found, strict=True)
        if own == done[file]["digest"]
    }
    damaged = [file for file in held if file not in kept]
    return kept, (f"changed or damaged, and done again: {abbreviate(damaged)}",) if damaged else ()


def _words(part: Part) -> str:
    rows = "" if part.rows is None else f", rows {part.rows[0]} to {part.rows[1] - 1}"
    return abbreviate([printable(path) for path in part.inputs]) + rows


def _lost(part: Part, error: str) -> Failure:
    """Return that a part failed; its input is named where the error does not do so."""
    named = any(str(path) in error for path in part.inputs)
    return Failure(part.file, error if named else f"{_words(part)}: {error}")


def equal_items(folder: Path, files: Sequence[str]) -> tuple[Counted, ...]:
    """Return a warning about items that are in two or more parts, if there are any."""

    def names_in(file: str) -> Iterator[Sequence[str]]:
        with open_results([folder / file], check=False) as source:
            yield from source.names()

    again = check_items([(partial(names_in, file), str) for file in files])
    if again is None:
        return ()
    text = "in more than one part: `eval` cannot tell them apart; give each its own folder"
    example = f"'{again.item}' in {listed((files[n] for n in again.files), 'and')}"
    return (Counted(again.number, "item", text, worst=example),)


def in_time(seconds: float) -> str:
    """Return a duration in its largest unit: `1.5 h`, `3 min`, `20 s`."""
    for size, unit, digits in ((3600, "h", 1), (60, "min", 0)):
        if seconds >= size:
            return f"{seconds / size:.{digits}f} {unit}"
    return f"{seconds:.0f} s"
