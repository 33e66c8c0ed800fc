"""A case: what is typed, in a folder of its own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from random import Random

Make = Callable[[Random, Path], tuple[str, ...]]
"""Spoil the files of a folder, and return the command line that reads them."""


@dataclass(frozen=True)
class Case:
    """The case of a kind and a seed: the same on every machine."""

    kind: str
    seed: int

    def __str__(self) -> str:
        return f"{self.kind} {self.seed}"
