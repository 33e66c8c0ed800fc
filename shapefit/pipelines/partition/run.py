"""`fit` into a folder: parts of the images, one result each, and a manifest of those that are done.

Running again does the parts that are missing or damaged, and those of inputs that were added. A
folder that holds results which this run would not give is refused, but with `replace`.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

from shapefit.config import FitConfig
from shapefit.config.paths import FAILED, ResultFolder
from shapefit.errors import abbreviate, counted, input_error, listed, path_text, printable
from shapefit.io import digest, read_dictionary
from shapefit.io.inputs import is_stream
from shapefit.io.names import check_items
from shapefit.io.source import open_results
from shapefit.lifting.methods import AUTO
from shapefit.pipelines.fit.default import choose_default
from shapefit.pipelines.fit.prepare import Estimates, files_of, first_images, prepare
from shapefit.pipelines.outcome import Counted, Failure, Outcome, reading
from shapefit.pipelines.partition.executors import Job, do_jobs, executor, on_cluster
from shapefit.pipelines.partition.manifest import (
    Entry,
    Manifest,
    held_folder,
    key_of,
    read_manifest,
    result_digest,
)
from shapefit.pipelines.partition.plan import Part, plan_parts, warn_of_large
from shapefit.threads import on_threads

OF_THE_RUN = (
    *("landmarks", "output", "dictionary", "data", "threads"),
    *("scheduler", "scheduler_file", "workers", "dry_run", "replace"),
)
"""Keys that do not change what a part holds."""


def run(config: FitConfig) -> Iterator[Outcome]:
    """Lift landmarks part by part into the folder that is the output."""
    folder = config.output
    assert isinstance(folder, ResultFolder), "the output is a folder"
    if any(map(is_stream, config.landmarks)):
        found = "standard input cannot be divided into parts"
        raise input_error("landmarks", found, "save it to a file and name that")
    if config.export.folder is not None:
        fix = "leave it out; `shapefit convert FOLDER -d DICT -o meshes/ --to ply` writes them"
        raise input_error("export.folder", "is not written for a folder of results", fix)
    on_cluster(config)
    known = read_manifest(folder.path)
    if config.method == AUTO and known is not None:
        config = config.changed(method=known.run["method"])
    config, chosen = choose_default(config)
    yield from reading(config.landmarks)
    plan = make_plan(config, known)
    if config.dry_run:
        yield Outcome(note=plan.note, listing=tuple(plan.lines))
        return
    if plan.refused and not config.replace:
        fix = "name another folder, or add --replace, which removes and redoes what differs"
        raise input_error(folder.path, f"holds results that differ: {plan.refused}", fix)
    if known is not None and plan.kept:
        stored = known.run["estimated"]
        estimates = Estimates(**stored)
    else:
        images, dictionary = first_images(config, plan.parts), read_dictionary(config.dictionary)
        estimates = prepare(config, dictionary, images.landmark_names, lambda: images).estimates
    first = {**plan.digests, "method": config.method, "estimated": asdict(estimates)}
    with held_folder(folder.path):
        for line in (chosen, *estimates.lines):
            yield Outcome(line=line)
        warnings = (*estimates.warnings, *plan.again, *warn_of_large(plan.parts))
        yield Outcome(
            warnings=warnings, note=f"{len(plan.kept)} of {counted(len(plan.parts), 'part')} done"
        )
        yield from do_parts(
            config, plan, Manifest(folder.manifest, first, dict(plan.kept)), estimates
        )


@dataclass(frozen=True)
class Plan:
    """What a run does to a folder.

    parts    all that there are to be
    kept     lines of those that are done and as they were, by their files
    removed  files of results of other inputs
    again    warnings about those that are damaged
    refused  why results would be lost, "" where none would
    digests  of all that every part depends on
    """

    parts: Sequence[Part]
    kept: Mapping[str, Entry]
    redone: Sequence[str]
    removed: Sequence[str]
    again: tuple[str, ...]
    refused: str
    digests: Mapping[str, str]

    @property
    def lines(self) -> Iterator[str]:
        """A line for each part that is to be done, done again or removed."""
        for part in self.parts:
            if part.file not in self.kept:
                again = "again, " if part.file in self.redone else ""
                yield f"{part.file}: {again}{describe(part)}"
        yield from (f"{file}: removed" for file in self.removed)

    @property
    def note(self) -> str:
        """What is to be done, counted."""
        todo = len(self.parts) - len(self.kept) - len(self.redone)
        words = [f"{counted(todo, 'part')} to do", f"{len(self.kept)} done"]
        words += [f"{len(self.redone)} to do again"] if self.redone else []
        words += [f"{len(self.removed)} to remove"] if self.removed else []
        words += [f"refused without --replace: {self.refused}"] if self.refused else []
        return ", ".join(words)


def make_plan(config: FitConfig, known: Manifest | None) -> Plan:
    """Compare the parts that a config asks for with those that a folder has."""
    entries = {} if known is None else known.parts
    done = {} if known is None else known.done
    parts = plan_parts(config, {key_of(each): number_of(each) for each in entries.values()})
    digests = digests_of(config)
    changed = [] if known is None else [k for k, v in digests.items() if known.run.get(k) != v]
    folder = Path() if known is None else known.path.parent
    held = [part for part in parts if part.file in done]
    there = dict(zip(held, on_threads(lambda p: result_digest(folder / p.file), held), strict=True))
    altered = [part for part in held if is_altered(part, done[part.file])]
    damaged = [p.file for p in held if there[p] not in (None, done[p.file]["digest"])]
    whole = {part.file for part in held if there[part] == done[part.file]["digest"]}
    kept = whole - {part.file for part in altered} if not changed else set()
    removed = [file for file in done if file not in {part.file for part in parts}]
    reasons = [f"of another {listed(changed, 'and')}"] if changed and done else []
    reasons += [f"of {abbreviate([describe(p) for p in altered], 3)} before it changed"] * bool(
        altered
    )
    reasons += [f"of {inputs_of([done[file] for file in removed])}"] if removed else []
    return Plan(
        parts,
        {file: done[file] for file in done if file in kept},
        [part.file for part in held if part.file not in kept],
        removed,
        (f"damaged, and done again: {abbreviate(damaged)}",) if damaged else (),
        ", and ".join(reasons),
        digests,
    )


def digests_of(config: FitConfig) -> dict[str, str]:
    """Return the digests of what all parts depend on: the config, and every file that it names."""
    plain = {key: value for key, value in config.as_plain().items() if key not in OF_THE_RUN}
    text = json.dumps(plain, sort_keys=True)
    found = {"config": hashlib.sha256(text.encode()).hexdigest()}
    return found | {key: digest(path) for key, path in files_of(config).items()}


def number_of(entry: Entry) -> int:
    """Return the number of the part of a line."""
    return int(entry["file"].removeprefix("part-").partition(".")[0])


def is_altered(part: Part, entry: Entry) -> bool:
    """Whether inputs are not those of a line: by their sizes, times of change and then digests."""
    own = part.describe()
    if own["sizes"] != entry["sizes"]:
        return True
    return own["changed"] != entry["changed"] and input_digests(part) != entry.get("digests")


def input_digests(part: Part) -> dict[str, str]:
    """Return the digests of the inputs of a part under their paths."""
    return {path_text(path): digest(path) for path in part.inputs}


def inputs_of(entries: Sequence[Entry]) -> str:
    """Name the inputs of lines, each once, that this run does not have or divides otherwise."""
    names = dict.fromkeys(Path(path).name for entry in entries for path in entry["inputs"])
    return f"{abbreviate(list(names), 3)}, not among these parts"


def describe(part: Part) -> str:
    """Name the inputs of a part and its rows."""
    rows = "" if part.rows is None else f", rows {part.rows[0]} to {part.rows[1] - 1}"
    return abbreviate([printable(path) for path in part.inputs]) + rows


def do_parts(
    config: FitConfig, plan: Plan, manifest: Manifest, estimates: Estimates
) -> Iterator[Outcome]:
    """Do the parts that are not kept, as they end; then remove what is of no part."""
    folder, total = manifest.path.parent, len(plan.parts)
    if config.threads == 0 and (config.workers is not None or on_cluster(config)):
        config = config.changed(threads=1)
    shared = config.changed(landmarks=(), **estimates.values)  # each part names its own
    given = replace(estimates, lines=(), warnings=())
    todo = [part for part in plan.parts if part.file not in plan.kept]
    jobs = deque(Job(part, shared, folder, given) for part in todo)
    lost: list[Failure] = []
    images, began = 0, time.monotonic()
    manifest.write()
    for file in plan.removed:
        (folder / file).unlink(missing_ok=True)
    try:
        with (
            executor(config, idle=not jobs) as (start, at_once, line),
            closing(do_jobs(jobs, start, at_once)) as ended,
        ):
            yield Outcome(line=line)
            for number, done in enumerate(ended, 1):
                images += done.outcome.done
                if done.error is not None:
                    named = any(str(path) in done.error for path in done.part.inputs)
                    reason = done.error if named else f"{describe(done.part)}: {done.error}"
                    lost.append(Failure(done.part.file, reason))
                    failed = {"status": FAILED, "error": reason}
                    manifest.add(done.part.describe() | failed)
                else:
                    manifest.add(done.entry)
                seconds = time.monotonic() - began
                words = [f"{len(manifest.done)} of {counted(total, 'part')} done"]
                words += [f"{len(lost)} failed"] if lost else []
                words += [f"{images / seconds:,.0f} images/s"] if images and seconds > 0 else []
                left = len(todo) - number
                words += [f"{in_time(left * seconds / number)} left"] if left else []
                yield replace(done.outcome, note=", ".join(words))
    finally:
        manifest.write()
    yield Outcome(
        failures=tuple(lost),
        warnings=equal_items(folder, sorted(manifest.done)) if images else (),
        note=f"{len(manifest.done)} of {counted(total, 'part')} done",
        written=(manifest.path,),
    )


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
