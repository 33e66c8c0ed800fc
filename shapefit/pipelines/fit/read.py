"""The first step of a fit: batches of images as the dictionary has its landmarks."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from shapefit.errors import input_error
from shapefit.io import LandmarkSet, LandmarkSource
from shapefit.io.records import concatenate
from shapefit.pipelines.fit.camera import find_doubts, straightened
from shapefit.pipelines.joints import Joints, name_warnings, named_as_joints
from shapefit.pipelines.outcome import nothing_in

if TYPE_CHECKING:
    from shapefit.io.foreign.calibration import CalibratedCamera

BATCH = 4096
"""Images that are read before the first whole sequences of them are lifted."""


@dataclass(frozen=True, kw_only=True)
class ReadOptions:
    """How images are read for a fit.

    names    landmarks of the dictionary
    joints   the landmarks of the files that stand for some of them
    leave_out  landmarks that the dictionary lacks, and the fit can do without
    place    of the landmark names of the files, for messages
    batch    images at a time, whole stretches of them; None for whole sequences
    camera   the calibrated camera that took the images, where one is given
    """

    names: tuple[str, ...]
    joints: Joints
    leave_out: bool
    place: str
    batch: int | None
    camera: CalibratedCamera | None = None


def read_images(source: LandmarkSource, options: ReadOptions) -> Iterator[LandmarkSet]:
    """Yield the images batch by batch: without distortion, with the landmarks of the dictionary."""
    names, place, joints = options.names, options.place, options.joints
    for batch in batches(source, options.batch):
        straight = named_as_joints(straightened(batch, options.camera), joints, place)
        yield straight.arrange(names, place, leave_out=options.leave_out)


def batches(source: LandmarkSource, size: int | None) -> Iterator[LandmarkSet]:
    """Give out the images, cut where no result depends on it.

    An image starts from its neighbour's solution within a stretch, so batches of a size hold whole
    stretches; with None they hold whole sequences, BATCH or more images at a time.
    """
    if size is None:
        return whole_sequences(map(with_sequences, source.batches(BATCH)))
    return source.batches(size, by_file=True)


def with_sequences(images: LandmarkSet) -> LandmarkSet:
    """Return the images, and refuse them where they name no sequences."""
    if images.sequences is None:
        fix = "name the sequence of each image, or take `method: posterior`"
        raise input_error("method: sequences", "landmarks without `sequence`", fix)
    return images


def whole_sequences(chunks: Iterable[LandmarkSet]) -> Iterator[LandmarkSet]:
    """Hold back the last run of images of one sequence until its end is known.

    The images stay in their order. As much is held in memory as a chunk and the longest sequence.
    Each chunk must have sequences. Raises InputError where a sequence goes on after another.
    """
    ended: set[str] = set()
    current: str | None = None
    held: list[LandmarkSet] = []
    for chunk in chunks:
        names = chunk.sequences or ()
        for item, name in zip(chunk.items, names, strict=True):
            if name != current:
                if name in ended:
                    found = f"the sequence '{name}' goes on after others, at the item '{item}'"
                    raise input_error(
                        "sequence", found, "put its images together, in order of time"
                    )
                if current is not None:
                    ended.add(current)
                current = name
        if held and names and names[0] != (held[-1].sequences or ("",))[-1]:
            yield concatenate(held)
            held = []
        last = len(names)
        while last and names[last - 1] == names[-1]:
            last -= 1
        if last:
            yield concatenate([*held, chunk.take(slice(0, last))])
            held = [chunk.take(slice(last, None))]
        else:
            held.append(chunk)
    if held:
        yield concatenate(held)


def warn_of_source(source: LandmarkSource, options: ReadOptions) -> tuple[str, ...]:
    """Say what is doubtful of the files: their landmarks, their lens, or that they are empty."""
    return (
        *nothing_in(source.count, "images"),
        *source.notes,
        *name_warnings(source.head.landmark_names, options.names),
        *find_doubts(source.head.further, options.camera),
    )
