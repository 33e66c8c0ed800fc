"""Which keys of `input` count for which files: one that counts for none of them is an error.

This goes by what was read: a file that names its landmarks has not those of `keypoints`.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from typing import Any, Literal, NamedTuple

from shapefit.errors import input_error
from shapefit.io.options import AS_THEY_ARE, InputOptions
from shapefit.io.skeletons import SKELETONS

Kind = Literal["landmarks", "shapes"]


class Opened(NamedTuple):
    """A file that was opened; `foreign` where it is of another tool."""

    foreign: bool
    kind: Kind
    landmark_names: Sequence[str]
    has_confidence: bool


def _names_landmarks(file: Opened, options: InputOptions) -> bool:
    names = tuple(file.landmark_names)
    skeleton = SKELETONS.get(options.keypoints or "")
    by_number = all(name.isdigit() for name in names)
    return file.foreign and (
        not names or (by_number if skeleton is None else names == skeleton.landmark_names)
    )


EFFECTS: dict[str, tuple[Callable[[Opened, InputOptions], bool], str]] = {
    "keypoints": (_names_landmarks, "only for landmarks without names, and these have names"),
    "individual": (
        lambda file, _: file.foreign,
        "only for files of other tools, and with `convert`",
    ),
    "track": (
        lambda file, options: file.foreign or options.track != "nearest",
        "only for files of detectors; these name the sequence of each item",
    ),
    "likelihood_below": (
        lambda file, _: file.has_confidence,
        "only where landmarks have a confidence, and these have none",
    ),
    "image_size": (lambda file, _: file.kind == "landmarks", "only for 2D landmarks"),
    "y_axis": (lambda file, _: file.kind == "landmarks", "only for 2D landmarks"),
}
"""Key -> whether it counts for a file, and where it does in words."""


def check_effects(
    files: Sequence[tuple[str, Opened]], options: InputOptions, obeyed: Collection[str] = ()
) -> None:
    """Raise InputError for a key that is given and counts for none of these files (with names).

    Those that are `obeyed` by the caller count.
    """
    for key, (counts, condition) in EFFECTS.items():
        value: Any = getattr(options, key)
        given = value != getattr(AS_THEY_ARE, key) and (key, value) != ("track", "motion")
        if given and key not in obeyed and not any(counts(file, options) for _, file in files):
            found = f"`{key}` has no effect here, {condition}"
            raise input_error(files[0][0], found, "leave it out")
