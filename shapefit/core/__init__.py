"""The compiled kernels: C++ from this folder, in the best instruction set of the
processor.

There is a module for each instruction set that was built. `LEVEL` names the one in use,
`LEVELS` all that this build has and this processor can run, the best first. The
environment variable SHAPEFIT_LEVEL forces one; InputError where there is none of that
name. Functions take C-contiguous float64 arrays, write their outputs in place and
release the GIL; the rooms that call them allocate. Arrays of another shape raise
ValueError, of another type TypeError. Threads take the images of a batch
IMAGES_PER_BLOCK at a time, and so many at most start from one another's solutions.
"""

from __future__ import annotations

import os
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from shapefit.errors import InputError, input_error

BEST_FIRST = {"x86_64_v4": 4, "x86_64_v3": 3, "x86_64_v2": 2, "plain": 0}
"""Instruction sets, and the level that a processor needs for each."""


def list_levels() -> tuple[str, ...]:
    """Return the instruction sets that this build has and this processor can run.

    The best first. Raises InputError where the kernels are not compiled.
    """
    try:
        processor: int = import_module("shapefit.core._processor").LEVEL
    except ModuleNotFoundError:
        # Python looks in the working directory first: a clone there hides what pip
        # installed.
        raise input_error(
            Path(__file__).resolve().parents[1],
            "Python imports the sources of shapefit from here, and they are not"
            " compiled here",
            "start Python in another folder, or install the clone in place: "
            "pip install -e '.[plots]'",
        ) from None
    return tuple(
        name
        for name, needed in BEST_FIRST.items()
        if needed <= processor and find_spec(f"shapefit.core._core_{name}")
    )


def choose_level() -> str:
    """Return the best instruction set, or the one that SHAPEFIT_LEVEL names.

    Raises InputError where that is none of `LEVELS`.
    """
    wanted = os.environ.get("SHAPEFIT_LEVEL") or LEVELS[0]
    if wanted not in LEVELS:
        raise InputError(
            f"SHAPEFIT_LEVEL is {wanted}; this build and processor have"
            f" {', '.join(LEVELS)}; set it to one of these, or unset it"
        )
    return wanted


LEVELS = list_levels()
LEVEL = choose_level()

if TYPE_CHECKING:
    from shapefit.core._core import *  # noqa: F403
else:
    _core = import_module(f"shapefit.core._core_{LEVEL}")
    globals().update(
        {name: it for name, it in vars(_core).items() if not name.startswith("__")}
    )
