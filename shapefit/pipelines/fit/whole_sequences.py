"""Cut a stream of images so that no sequence is divided."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from shapefit.errors import input_error
from shapefit.io import LandmarkSet
from shapefit.io.records import concatenate


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
