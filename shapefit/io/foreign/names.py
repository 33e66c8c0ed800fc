"""The names of landmarks in files that do not name them: `keypoints`, a skeleton known by name."""

from __future__ import annotations

from shapefit.errors import input_error, listed
from shapefit.io.foreign.recording import Recording
from shapefit.io.landmark_names import nearest_names
from shapefit.io.options import InputOptions
from shapefit.io.skeletons import SKELETONS

KEY = "keypoints"
NUMBERED = "numbered"
"""In place of a skeleton: landmarks are called 0, 1 and so on."""


def fitting_skeletons(count: int) -> list[str]:
    """Return the known skeletons of so many landmarks."""
    return [name for name, one in SKELETONS.items() if len(one.landmark_names) == count]


def landmark_names(recording: Recording, options: InputOptions) -> tuple[str, ...]:
    """Return the names of the landmarks of a recording.

    They are those of the file. Where it has none, they are those of the skeleton `keypoints`, of
    the one that its format implies, or their numbers where no known skeleton has as many, or
    `keypoints` is `numbered`. Raises InputError for an unknown skeleton, one of another number of
    landmarks, and where some have as many as the file and `keypoints` names none.
    """
    wanted = options.keypoints
    if wanted is not None and wanted not in (*SKELETONS, NUMBERED):
        near = nearest_names(wanted, tuple(SKELETONS))
        fix = f"did you mean {near[0]}?" if near else f"use {listed(SKELETONS)}"
        raise input_error(KEY, f"there is no skeleton {wanted!r}", fix)
    if recording.landmark_names is not None:
        return recording.landmark_names
    count = recording.landmark_count
    chosen = wanted or recording.default_keypoints
    if chosen is None:
        fitting = fitting_skeletons(count)
        if fitting:
            found = f"{count} landmarks without names, as {listed(fitting, 'and')} have"
            ways = [f"`--set {KEY}={name}`" for name in (*fitting, NUMBERED)]
            raise input_error(recording.name, found, f"say which: {listed(ways)}")
    if chosen in (None, NUMBERED):
        return tuple(map(str, range(count)))
    names = SKELETONS[chosen].landmark_names
    if len(names) != count:
        fitting = fitting_skeletons(count)
        known = f"; {listed(fitting)} have as many" if fitting else ""
        found = f"{count} landmarks, and {chosen} has {len(names)}"
        raise input_error(recording.name, found, f"set another `{KEY}`{known}")
    return names
