"""From the instances of a recording to those that are asked for, each with the name of its item."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.errors import abbreviate, input_error
from shapefit.io.foreign.recording import ANYBODY, Instances, Recording, Rows
from shapefit.io.options import InputOptions

NOBODY = "individuals without a landmark left out"
INFINITE = "landmarks hidden, whose coordinates are infinite"
UNTRACKED = "untracked"
"""In place of the individual, for those without identity beside others that have one."""

DOUBTFUL = "landmarks hidden, whose confidence is below `likelihood_below`"


@dataclass(frozen=True, kw_only=True)
class Chosen(Rows):
    """Instances with the names of their items and sequences ("" for none), as in `Instances`."""

    items: tuple[str, ...]
    sequences: tuple[str, ...]


def choose(recording: Recording, options: InputOptions) -> Callable[[], Iterator[Chosen]]:
    """Return what reads anew the instances that the options ask for.

    Instances without a landmark are left out. Raises InputError for an individual that the
    recording does not have, and for images without order of which motion is asked for.
    """
    names = recording.individuals
    if options.track == "motion" and recording.unordered and (recording.frames or 0) > 1:
        found = "holds images of different files, without numbers of frames: no motion"
        fix = "set `track: nearest` if they are one all the same, or write .h5 or .csv"
        raise input_error(recording.name, found, fix)
    tracks = options.track != "none"
    if options.individual is not None and not tracks and options.individual not in names:
        raise _unknown_individual(recording, options.individual, names)

    def read() -> Iterator[Chosen]:
        blocks: Iterable[Instances] = recording.blocks()
        if tracks:
            from shapefit.io.foreign.tracking import joined

            blocks = joined(blocks, first_track(recording.individuals))
        numbers: Counter[tuple[str, str]] = Counter()
        met: set[int] = set()
        for block in blocks:
            met.update(block.individuals.tolist())
            yield _chosen(block, recording, options, numbers)
        if tracks and options.individual is not None:
            found = [name for number in sorted(met) if (name := _name(recording, number))]
            if options.individual not in found:
                raise _unknown_individual(recording, options.individual, found)

    return read


def _chosen(
    block: Instances, recording: Recording, options: InputOptions, numbers: Counter[tuple[str, str]]
) -> Chosen:
    """Name and thin out a block; `numbers` counts the anonymous instances of each frame."""
    counts = Counter(block.counts)
    points, confidence = block.points, block.confidence
    placed: NDArray[np.bool_] = np.asarray(np.isfinite(points).all(axis=2))
    counts[INFINITE] += int((~placed & np.isinf(points).any(axis=2)).sum())
    if options.likelihood_below and confidence is not None:
        doubtful = placed & (confidence < options.likelihood_below)
        counts[DOUBTFUL] += int(doubtful.sum())
        placed &= ~doubtful
    points = np.where(placed[..., None], points, np.nan)
    if confidence is not None:
        confidence = np.where(placed, _weights(confidence), 0.0)
    rows = placed.any(axis=1)
    counts[NOBODY] += int((~rows).sum())
    numbered = block.individuals.tolist()
    known_names = {number: _name(recording, number) for number in set(numbered)}
    who = [known_names[number] for number in numbered]
    if options.individual is not None:
        rows &= np.array([name == options.individual for name in who], dtype=bool)
    videos = block.videos or [recording.video] * len(block)
    items, sequences = [], []
    anonymous = f"{UNTRACKED}/" if recording.individuals else ""
    known: dict[tuple[str, str], str] = {}
    for video, name, number, label in zip(videos, who, numbered, block.labels, strict=True):
        if number == ANYBODY:
            frame = (video, label)
            items.append(f"{video}/{anonymous}{label}/{numbers[frame]}")
            sequences.append("")
            numbers[frame] += 1
        else:
            sequence = known.setdefault((video, name), f"{video}/{name}" if name else video)
            items.append(f"{sequence}/{label}")
            sequences.append(sequence)
    every = Chosen(
        points=points,
        confidence=confidence,
        frames=block.frames,
        items=tuple(items),
        sequences=tuple(sequences),
        extras=block.extras,
    )
    return every.take(
        np.flatnonzero(rows), {name: count for name, count in counts.items() if count}
    )


def _weights(confidence: Floats) -> Floats:
    """Return confidences as weights: 1 where there is none, 0 for those below 0."""
    return np.maximum(np.nan_to_num(confidence, nan=1.0, posinf=1.0, neginf=0.0), 0.0)


def _name(recording: Recording, number: int) -> str:
    """Return the name of an individual; "" for the only one of a recording that names none."""
    if number == ANYBODY or number < first_track(recording.individuals):
        return recording.individuals[number] if recording.individuals and number >= 0 else ""
    return f"person {number - first_track(recording.individuals) + 1}"


def first_track(individuals: Sequence[str]) -> int:
    """Return the number that the first individual gets who was joined over frames."""
    return max(1, len(individuals))


def _unknown_individual(recording: Recording, name: str, names: Sequence[str]) -> Exception:
    if names:
        fix = f"name one of {abbreviate(names)}"
    else:
        fix = "its format names none; leave out `individual`, or join people with `track: nearest`"
    return input_error(recording.name, f"has no individual {name!r}", fix)
