"""Whether pictures and plots can be drawn here: only they need matplotlib."""

from __future__ import annotations

import sys
from importlib.util import find_spec
from typing import Literal

from shapefit.errors import input_error

MISSING = "matplotlib is not installed"
INSTALL = "install it with `pip install matplotlib`"


def check_can_draw(key: str) -> None:
    """Raise InputError where matplotlib is not installed; does not import it."""
    if not _can_draw():
        raise input_error(key, MISSING, f"{INSTALL}, or leave `{key}` out")


def draws_plots(wanted: bool | Literal["auto"]) -> bool:
    """Whether plots are drawn; `auto` draws them where that is possible.

    Raises InputError where they are wanted and cannot be drawn.
    """
    if wanted is True:
        check_can_draw("plots")
    return _can_draw() if wanted == "auto" else wanted


def plots_left_out(wanted: bool | Literal["auto"]) -> tuple[str, ...]:
    """Warn where `auto` draws no plots."""
    if wanted != "auto" or _can_draw():
        return ()
    return (f"no plots: {MISSING}; {INSTALL}, or set `plots: false`",)


def _can_draw() -> bool:
    name = "matplotlib"
    return sys.modules[name] is not None if name in sys.modules else find_spec(name) is not None
