"""`fit` into a folder: parts of the images, one result each, and a manifest of those that are done.

Running again does the parts that are missing, and those that changed or were damaged.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections import deque
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path, PurePosixPath

import numpy as np

from shapefit.config import FitConfig
from shapefit.config.paths import FAILED, ResultFolder
from shapefit.errors import abbreviate, counted, input_error, printable
from shapefit.io import digest, read_dictionary
from shapefit.io.formats import HDF5
from shapefit.io.inputs import is_stream
from shapefit.io.names import Equal, find_equal_names, repeated, stable_hashes
from shapefit.io.source import open_results
from shapefit.pipelines.fit.prepare import Estimates, first_images, prepare
from shapefit.pipelines.outcome import Counted, Failure, Outcome
from shapefit.pipelines.parts.executors import Done, Job, do_jobs, executor_of, wants_cluster
from shapefit.pipelines.parts.manifest import (
    Entry,
    Manifest,
    held_folder,
    read_manifest,
    remove_old,
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
    with held_folder(folder.path):
        manifest = Manifest(folder.manifest, first, kept)
        for line in estimates.lines:
            yield Outcome(line=line)
        before = f"{len(kept)} of {counted(len(parts), 'part')} done before"
        yield Outcome(warnings=(*estimates.warnings, *again), note=before)
        yield from _run(config.changed(**estimates.values), folder.path, parts, manifest, estimates)


def _run(
    config: FitConfig,
    folder: Path,
    parts: Sequence[Part],
    manifest: Manifest,
    estimates: Estimates,
) -> Iterator[Outcome]:
    elsewhere = config.workers is not None or wants_cluster(config)
    alone = {"threads": 1} if elsewhere and config.threads == 0 else {}
    shared = config.model_copy(update={"landmarks": (), **alone})  # each part names its own
    told = replace(estimates, lines=(), warnings=())
    job = partial(Job, config=shared, folder=folder, estimates=told)
    kept = tuple(manifest.done)
    jobs = deque(job(part) for part in parts if part.file not in kept)
    lost: list[Failure] = []
    hashes: list[bytes] = []
    images, began = 0, time.monotonic()
    manifest.write()
    try:
        for done in on_executor(jobs, config):
            if isinstance(done, str):
                yield Outcome(line=done)
                continue
            if done.error is not None:
                lost.append(_lost(done.part, done.error))
                failed = {"status": FAILED, "error": lost[-1].reason}
                manifest.add(done.part.describe() | failed)
            else:
                images += done.outcome.done
                hashes.append(done.hashes)
                manifest.add(done.entry)
            reached, seconds = len(manifest.done), time.monotonic() - began
            note = tell_pace(reached, len(parts), len(lost), images, len(hashes), seconds)
            yield replace(done.outcome, note=note)
    finally:
        manifest.write()
    remove_stale(folder, {part.file for part in parts})
    equal = equal_items(folder, kept, tuple(manifest.done), hashes)
    text = "in more than one part: `eval` cannot tell them apart"
    yield Outcome(
        failures=tuple(lost),
        warnings=(Counted(equal.count, "item", text, worst=str(equal)),) if equal.count else (),
        note=f"{len(manifest.done)} of {counted(len(parts), 'part')} done",
        written=(manifest.path,),
    )


def on_executor(jobs: deque[Job], config: FitConfig) -> Iterator[Done | str]:
    """Do jobs on the executor that the config names, which a line introduces."""
    if not jobs:
        return
    with executor_of(config) as (start, at_once, line):
        if line:
            yield line
        yield from do_jobs(jobs, start, at_once)


def check_parts(config: FitConfig) -> None:
    """Raise InputError for what cannot be done part by part,."""
    assert isinstance(config.output, ResultFolder)
    if any(map(is_stream, config.landmarks)):
        found = "standard input cannot be divided into parts"
        raise input_error("landmarks", found, "save it to a file and name that")
    for key in ("export", "pictures"):
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


def equal_items(
    folder: Path, kept: Sequence[str], files: Sequence[str], hashes: Sequence[bytes]
) -> Equal:
    """Return the items that are in two or more parts.

    hashes of the names in those that were just done; of others they are read, and of all where two
    hashes are the same. Where nothing was done, an earlier run has reported them.
    """
    if not hashes:
        return Equal(0, ())

    def names_in(file: str) -> Iterator[Sequence[str]]:
        with open_results([folder / file], check=False) as source:
            yield from source.names()

    met = [np.frombuffer(each, np.uint64) for each in hashes]
    met += [stable_hashes(block) for file in kept for block in names_in(file)]
    if not len(repeated(np.concatenate(met))):
        return Equal(0, ())
    return find_equal_names({folder / file: partial(names_in, file) for file in sorted(files)})


def remove_stale(folder: Path, own: Collection[str]) -> None:
    """Remove the results of an earlier run that this one does not have."""
    for name in files_in(folder):
        is_part = name.startswith("part-") and PurePosixPath(name).suffix == HDF5.suffixes[0]
        if is_part and name not in own:
            remove(folder / name)
    remove_old(folder)


UNITS = ((3600, "h", 1), (60, "min", 0), (0.0, "s", 0))


def tell_pace(reached: int, parts: int, lost: int, images: int, ended: int, seconds: float) -> str:
    """Return one line: `12 of 40 parts done, 1 failed, 34,500 images/s, 3 min left`.

    reached   parts that are done, those of earlier runs included
    lost      parts that failed
    images    lifted by this run, in the `ended` parts that it did, within `seconds`
    """
    words = [f"{reached} of {counted(parts, 'part')} done"]
    if lost:
        words.append(f"{lost} failed")
    if images and seconds > 0:
        words.append(f"{images / seconds:,.0f} images/s")
    left = parts - reached - lost
    if left and ended:
        rest = left * seconds / ended
        size, unit, digits = next(each for each in UNITS if rest >= each[0])
        words.append(f"{rest / (size or 1):.{digits}f} {unit} left")
    return ", ".join(words)
