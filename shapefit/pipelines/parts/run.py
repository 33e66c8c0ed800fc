"""`fit` into a folder: parts of the images, one result each, and a manifest of those that are done.

Running again does the parts that are missing. Without a cluster they are done in this process.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections import deque
from collections.abc import Collection, Iterator, Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path, PurePosixPath

import numpy as np

from shapefit.config import FitConfig
from shapefit.config.paths import ResultFolder
from shapefit.errors import abbreviate, counted, input_error, printable
from shapefit.io import digest, read_dictionary
from shapefit.io.formats import HDF5
from shapefit.io.inputs import is_stream
from shapefit.io.layout import RESULTS
from shapefit.io.names import Equal, Hashes
from shapefit.io.writing import find_writer
from shapefit.pipelines.fit.prepare import Estimates, first_images, prepare
from shapefit.pipelines.outcome import Counted, Failure, Outcome
from shapefit.pipelines.parts.cluster import (
    RETRIES,
    connected,
    introduce,
    on_cluster,
    wants_cluster,
)
from shapefit.pipelines.parts.equal_items import find_equal_items
from shapefit.pipelines.parts.manifest import (
    Manifest,
    damage_of,
    held_folder,
    read_manifest,
)
from shapefit.pipelines.parts.part import Done, Job, fit_part
from shapefit.pipelines.parts.plan import Part, plan_parts
from shapefit.stores import STORAGE_OPTIONS, files_in, remove

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
    known = read_manifest(folder.manifest)
    asked = find_terms(config)
    kept = known is not None and known.estimated.get("asked") == asked
    done = known.parts.values() if known is not None and (kept or not known.estimated) else ()
    parts = plan_parts(config, done)
    if known is not None and kept and any(map(known.holds, parts)):
        setup = Estimates.restored(known.estimated)
    else:
        setup = prepare(config, read_dictionary(config.dictionary), lambda: first_images(config))
    config = setup.apply(config)
    estimated = {"asked": asked, "method": config.method, **asdict(setup)}
    manifest = Manifest(find_terms(config), estimated=estimated)
    if config.dry_run:
        yield _dry(parts, _known(folder, manifest)[0])
        return
    with held_folder(folder.path):
        yield from _run(config, folder, parts, manifest, setup)


def check_parts(config: FitConfig) -> None:
    """Raise InputError for what cannot be done part by part, and for a library that is missing."""
    assert isinstance(config.output, ResultFolder)
    if any(map(is_stream, config.landmarks)):
        found = "standard input cannot be divided into parts"
        raise input_error("landmarks", found, "save it to a file and name that")
    find_writer(config.output.manifest, RESULTS.kind, "hdf5")
    for key in ("export", "pictures"):
        if getattr(config, key).folder is not None:
            fix = "leave it out, and fit the images to be shown once more into a file"
            raise input_error(f"{key}.folder", "is not written for a folder of results", fix)


def find_terms(config: FitConfig) -> dict[str, str]:
    """Return the digests of what all parts depend on."""
    plain = {key: value for key, value in config.as_plain().items() if key not in OF_THE_RUN}
    text = json.dumps(plain, sort_keys=True)
    return {
        "config": hashlib.sha256(text.encode()).hexdigest(),
        "dictionary": digest(config.dictionary),
    }


def _known(folder: ResultFolder, new: Manifest) -> tuple[Manifest, str | None]:
    """Return the manifest of the parts that count, and why those of an earlier run do not."""
    known = read_manifest(folder.manifest)
    if known is None:
        return new, None
    changed = [name for name, value in new.terms.items() if known.terms.get(name) != value]
    if changed:
        return new, f"all parts are done again: another {' and another '.join(changed)}"
    known.estimated = new.estimated
    there = files_in(folder.path)
    known.parts = {
        name: entry for name, entry in known.parts.items() if there.get(name) == entry.get("bytes")
    }
    damaged = [name for name, entry in known.parts.items() if damage_of(folder.path / name, entry)]
    for name in damaged:
        del known.parts[name]
    return known, f"damaged, and done again: {abbreviate(damaged)}" if damaged else None


def _dry(parts: Sequence[Part], manifest: Manifest) -> Outcome:
    """Say which parts would be done."""
    lines = [f"{part.file}: {_words(part)}" for part in parts if not manifest.holds(part)]
    note = f"{counted(len(lines), 'part')} to do, {len(parts) - len(lines)} done"
    return Outcome(note=note, listing=tuple(lines))


def _words(part: Part) -> str:
    rows = "" if part.rows is None else f", rows {part.rows[0]} to {part.rows[1] - 1}"
    return abbreviate([printable(path) for path in part.inputs]) + rows


def _lost(part: Part, error: str) -> Failure:
    """Return that a part failed; its input is named where the error does not do so."""
    named = any(str(path) in error for path in part.inputs)
    return Failure(part.file, error if named else f"{_words(part)}: {error}")


def _run(
    config: FitConfig,
    folder: ResultFolder,
    planned: Sequence[Part],
    manifest: Manifest,
    setup: Estimates,
) -> Iterator[Outcome]:
    manifest, again = _known(folder, manifest)
    parts = {part.file: part for part in planned}
    manifest.parts = {file: manifest.parts[file] for file in parts if manifest.holds(parts[file])}
    elsewhere = config.workers is not None or wants_cluster(config)
    alone = {"threads": 1} if elsewhere and config.threads == 0 else {}
    shared = config.model_copy(update={"landmarks": (), **alone})  # each part names its own
    job = partial(
        Job, config=shared, folder=folder.path, setup=replace(setup, lines=(), warnings=())
    )
    todo = deque(job(part) for file, part in parts.items() if file not in manifest.parts)
    warnings = (*setup.warnings, *(() if again is None else (again,)))
    for line in setup.lines:
        yield Outcome(line=line)
    before = len(parts) - len(todo)
    note = f"{before} of {counted(len(parts), 'part')} done before"
    yield Outcome(warnings=warnings, note=note)
    lost: list[Failure] = []
    images = 0
    lifted, met = set[Path](), list[Hashes]()
    began = time.monotonic()

    def pace() -> str:
        reached, seconds = len(manifest.parts), time.monotonic() - began
        return tell_pace(reached, len(parts), len(lost), images, len(lifted), seconds)

    manifest.write(folder.manifest)
    try:
        for done in _do(config, todo):
            if isinstance(done, str):
                yield Outcome(line=done)
                continue
            if done.error is not None:
                smaller = () if done.passing else tuple(done.part.divide())
                todo.extend(map(job, smaller))
                parts |= {part.file: part for part in smaller}
                lost += () if smaller else (_lost(done.part, done.error),)
                yield Outcome(note=pace())
                continue
            images += done.outcome.done
            lifted.add(folder.path / done.part.file)
            met.append(np.frombuffer(done.hashes, np.uint64))
            entry = done.part.describe() | done.entry()
            manifest.add(done.part.file, entry, folder.manifest)
            yield replace(done.outcome, note=pace())
    finally:
        manifest.write(folder.manifest)
    _remove_stale(folder.path, parts)
    yield Outcome(
        failures=tuple(lost),
        warnings=_warn_of_equal(find_equal_items(manifest.spans(folder.path), met, lifted)),
        note=f"{len(manifest.parts)} of {counted(len(parts), 'part')} done",
        written=(folder.manifest,),
    )


def _warn_of_equal(equal: Equal) -> tuple[Counted, ...]:
    """Warn of items that are in two parts."""
    if not equal.count:
        return ()
    text = "in more than one part: `eval` cannot tell them apart"
    return (Counted(equal.count, "item", text, worst=str(equal)),)


def _do(config: FitConfig, jobs: deque[Job]) -> Iterator[Done | str]:
    """Do jobs on processes, or a cluster, which a line introduces, or one after the other here.

    Those that are added meanwhile are done, too.
    """
    if jobs and config.workers is not None:
        from shapefit.pipelines.parts.processes import on_processes

        yield from on_processes(jobs, config.workers)
        return
    if not jobs or not wants_cluster(config):
        while jobs:
            yield _tried(jobs.popleft())
        return
    with connected(config) as client:
        yield introduce(client)
        yield from on_cluster(client, jobs)


def _tried(job: Job, retries: int = RETRIES) -> Done:
    """Do a job in this process, again where it fails for what may pass."""
    done = fit_part(job)
    return _tried(job, retries - 1) if done.passing and retries else done


def _remove_stale(folder: Path, own: Collection[str]) -> None:
    """Remove the results of an earlier run that this one does not have."""
    for name in files_in(folder):
        is_part = name.startswith("part-") and PurePosixPath(name).suffix == HDF5.suffixes[0]
        if is_part and name not in own:
            remove(folder / name)


MINUTE, HOUR = 60, 3600


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
        words.append(f"{_duration(left * seconds / ended)} left")
    return ", ".join(words)


def _duration(seconds: float) -> str:
    if seconds < MINUTE:
        return f"{seconds:.0f} s"
    if seconds < HOUR:
        return f"{seconds / MINUTE:.0f} min"
    return f"{seconds / HOUR:.1f} h"
