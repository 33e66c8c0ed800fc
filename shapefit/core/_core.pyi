"""Signatures of the extension module."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
Indices = NDArray[np.int64]

LEVEL: str
LEVELS: tuple[str, ...]

class parts:
    @staticmethod
    def climb(blocks: Floats, R: Floats) -> float: ...
    @staticmethod
    def polar_rotation(A: Floats, R: Floats) -> bool: ...
    @staticmethod
    def scaled_coefficients(Q: Floats, h: Floats, a: Floats, x: Floats) -> None: ...

def code(
    *,
    gram: Floats,
    pulls: Floats,
    smallest_moves: Floats,
    coefficients: Floats,
    unsettled: Flags,
    threads: int,
) -> None: ...
def synchronise(*, transforms: Floats, rotation: Floats, threads: int) -> None: ...
