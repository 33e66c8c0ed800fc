"""Detections without identity, joined over frames: who is nearest is the same person."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from shapefit.io.foreign.recording import Instances


def joined(blocks: Iterable[Instances], first: int) -> Iterator[Instances]:
    """Give every anonymous instance the number of a track, `first` for the first of them."""
    raise NotImplementedError
