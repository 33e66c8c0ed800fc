"""Signatures of the extension module."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

LEVEL: str
LEVELS: tuple[str, ...]

class parts:
    @staticmethod
    def climb(blocks: Floats, R: Floats) -> float: ...
    @staticmethod
    def polar_rotation(A: Floats, R: Floats) -> bool: ...

def synchronise(*, transforms: Floats, rotation: Floats, threads: int) -> None: ...
