"""Images whose sequences are whole, however the files were divided into batches."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from shapefit.errors import input_error
from shapefit.lifting.sequences.clips import MAX_CLIP_FRAMES, split_into_clips
from shapefit.records import Landmarks, concatenate


def whole_sequences(batches: Iterable[Landmarks]) -> Iterator[Landmarks]:
    """Regroup batches of images into whole sequences, a long one into clips.

    Raises InputError for images without sequences, for those of a sequence that are
    apart, and for two of one frame.
    """
    begun: set[str] = set()
    rest: list[Landmarks] = []
    for batch in batches:
        images = concatenate([*rest, batch])
        checked = len(images) - len(batch)
        last = find_last_sequence(images, checked, begun)
        if last:
            yield from divide_sequences(images.take(slice(0, last)))
        rest = [images.take(slice(last, None))]
    yield from divide_sequences(concatenate(rest))


def find_last_sequence(images: Landmarks, first: int, begun: set[str]) -> int:
    """Return the row where the last sequence begins, at or after `first`, else 0.

    Images before that row have been checked; names of sequences that begin are added to
    those that have begun. Raises InputError as `whole_sequences`.
    """
    names = images.sequences
    if names is None:
        fix = "name the sequence of each image, or take `method: posterior`"
        raise input_error("method: sequences", "landmarks without `sequence`", fix)
    last = 0
    for row in range(first, len(images)):
        if not names[row]:  # an image by itself
            last = row
            continue
        if row and names[row] == names[row - 1]:
            check_order(images, row)
            continue
        if names[row] in begun:
            item = images.items[row]
            fault = f"'{names[row]}' goes on after others, at the item '{item}'"
            fix = "put its images together, in order of time"
            raise input_error("sequence", fault, fix)
        begun.add(names[row])
        last = row
    return last


def check_order(images: Landmarks, row: int) -> None:
    """Raise InputError where an image is not of a later frame than that before it."""
    frames = images.frames
    names = images.sequences
    if frames is None or not (names and names[row]) or frames[row] > frames[row - 1]:
        return
    fault = (
        f"'{images.items[row - 1]}' is of the frame {frames[row - 1]}, and then"
        f" '{images.items[row]}' of {frames[row]}"
    )
    fix = "give one image per frame of a sequence, in order of time"
    raise input_error("frame", fault, fix)


def divide_sequences(images: Landmarks) -> Iterator[Landmarks]:
    """Yield at most MAX_CLIP_FRAMES images at a time, cut between sequences or clips.

    The clips of a long sequence are refined by themselves, in less memory.
    """
    start = stop = 0
    for clip in split_into_clips(images.sequences or ()):
        if clip.stop - start > MAX_CLIP_FRAMES and stop > start:
            yield images.take(slice(start, stop))
            start = stop
        stop = clip.stop
    yield images.take(slice(start, stop))
