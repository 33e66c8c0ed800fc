"""How files are read, what the section `input` of every command says, and how they are written."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from shapefit.errors import input_error
from shapefit.io.skeletons import installed_skeletons

if TYPE_CHECKING:
    from shapefit.config.commands.input import FilesInput
    from shapefit.geometry.cameras import Up


Track = Literal["nearest", "none", "motion"]
Direction = Literal["down", "up"]
Markers = Literal["joints", "input"]


@dataclass(frozen=True, kw_only=True)
class InputOptions:
    """How files are read; the defaults take them as they are.

    format            a name in the table of formats, auto by their content
    keypoints         the skeleton whose names landmarks have in files that do not name them
    individual        the one individual that is read, by its name; None for all
    track             nearest joins detections without identity over frames; none leaves each
                      an item of its own; motion joins them, and refuses images that follow no
                      order (the default where sequences are asked for)
    likelihood_below  landmarks whose confidence is below this are hidden
    rename            landmarks, as files have them -> the names that they are given out under
    image_size        width and height of the images in pixels, by which fractions are multiplied
    y_axis            where y points in landmarks, against what a format of others has by
                      convention; None as files say it, and down where they do not
    landmarks         those that are kept, in this order, by their new names; None for all
    """

    format: str = "auto"
    keypoints: str | None = None
    individual: str | None = None
    track: Track = "none"
    likelihood_below: float = 0.0
    rename: Mapping[str, str] = field(default_factory=dict)
    image_size: tuple[float, float] | None = None
    y_axis: Direction | None = None
    landmarks: tuple[str, ...] | None = None


AS_THEY_ARE = InputOptions()


@dataclass(frozen=True, kw_only=True)
class OutputOptions:
    """How shapes get into files in metres.

    height      of the body or the object in metres; by default results are as large as the training
                shapes of their dictionary
    unit        of shapes whose files do not say it
    up          axis of the shapes, or of the world that the extrinsics know, that points up
    markers     input: the landmarks of the files that were lifted, in place of the joints
    """

    height: float | None = None
    unit: str | None = None
    up: Up | None = None
    markers: Markers | None = None

    @property
    def given(self) -> tuple[str, ...]:
        """Return the names of the keys of a config that are set."""
        return tuple(name for name, value in vars(self).items() if value is not None)


AS_KNOWN = OutputOptions()


@dataclass(frozen=True, kw_only=True)
class Summary:
    """What was written: the unit and axes, what to beware of, and the files if not the target."""

    note: str = ""
    warnings: tuple[str, ...] = ()
    written: tuple[Path, ...] = ()


def input_options(config: FilesInput, track: Track = "none") -> InputOptions:
    """Return what the section says; `track` where it leaves that open."""
    said = dict(config)
    return InputOptions(**{**said, "track": said.get("track") or track})


class Opened(NamedTuple):
    """The head of a file that was opened, and its kind; `foreign` where it is of another tool."""

    foreign: bool
    kind: str
    head: Any


def _names_landmarks(file: Opened, options: InputOptions) -> bool:
    names = file.head.landmark_names
    skeleton = installed_skeletons().get(options.keypoints or "")
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
        lambda file, _: file.head.columns.get("confidence") is not None,
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
