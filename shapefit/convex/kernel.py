"""How every compiled kernel of the room is compiled."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba

Function = TypeVar("Function", bound=Callable[..., Any])


def kernel(function: Function) -> Function:
    """Compile for the user's processor, keep the machine code on disk, release the GIL.

    Sums may be reordered so that inner loops vectorise; nan and inf keep their meaning.
    """
    return numba.njit(
        cache=True,
        nogil=True,
        error_model="numpy",
        fastmath={"nsz", "arcp", "contract", "reassoc"},
    )(function)
