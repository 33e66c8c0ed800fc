"""The landmarks by which something can be compared with the truth."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from shapefit.errors import abbreviate, input_error
from shapefit.evaluation.metrics import FEWEST_LANDMARKS


def common_landmarks(file: Path, own: Sequence[str], true: Sequence[str]) -> tuple[str, ...]:
    """Return the landmarks of a file that the truth has too, in the order of the file.

    Raises InputError where these are fewer than three.
    """
    common = tuple(name for name in own if name in set(true))
    if len(common) < FEWEST_LANDMARKS:
        found = f"the truth has {len(common)} of its landmarks ({abbreviate(own)})"
        fix = (
            f"at least {FEWEST_LANDMARKS} must have the names that they have in the truth "
            f"({abbreviate(true)})"
        )
        raise input_error(file, found, fix)
    return common
