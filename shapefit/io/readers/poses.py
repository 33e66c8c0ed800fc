"""Poses from files of other tools: every reader hands its arrays to `Poses`, which
checks them.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path, PureWindowsPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.errors import InputError, input_error, printable
from shapefit.io.layout import UNKNOWN_UNIT
from shapefit.io.options import Direction

FRACTION = "fraction of the image"
"""Unit of coordinates that are divided by the width and the height of the image."""

Edges = tuple[tuple[int, int], ...]

PER_POSE = ("points", "confidence", "frame", "label", "individual", "video")


@dataclass(frozen=True, kw_only=True)
class Poses:
    """N poses of p landmarks in d dimensions, each of one individual in one frame.

    name        the path, for messages
    points      (N, p, 2) or (N, p, 3), NaN where a landmark is missing
    confidence  (N, p), NaN where a landmark has none (then 1); None where the format
                has none
    frame       (N,), the position of the frame in its video, from 0, never falling in a
                video
    label       (N,), what the file calls the frame: a number, a time, an image
    individual  (N,), "" for a pose without identity over frames; None for one body, one
                sequence
    video       what items begin with: one text, or (N,) where a file holds several
                videos
    landmark_names  None where the file has none: `keypoints` or the usual `skeleton`
                    names them
    frame_rate  in Hz
    edges       pairs of landmarks, by position
    size_needed of fractions of the image: whether they are useless without `image_size`
    unordered   whether the images are, as far as names say, no frames of a video
    named       whether labels name images, and are the items as they stand
    y_axis      where y of 2D points points, where the format says it: else down
    or_else     of fractions of the image: what else the numbers may be, for the message
    notes       warnings: what was left out or replaced, what is uncertain
    """

    name: str
    points: Floats
    confidence: Floats | None = None
    frame: NDArray[Any]
    label: Sequence[str]
    individual: Sequence[str] | None = None
    video: str | Sequence[str]
    landmark_names: tuple[str, ...] | None = None
    skeleton: str | None = None
    frame_rate: float | None = None
    unit: str = UNKNOWN_UNIT
    edges: Edges = ()
    size_needed: bool = False
    unordered: bool = False
    named: bool = False
    y_axis: Direction | None = None
    or_else: str = ""
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Raise ValueError for names that are empty or repeat, and fields that do not
        agree.

        In 2D what tools write for a missing landmark becomes NaN: (-1, -1) without a
        confidence or with 0, and (0, 0) with a confidence of 0.
        """
        n, p, d = self.points.shape
        require(d in (2, 3), f"points of {d} coordinates")
        check_names(self.landmark_names or (), "landmark")
        names = p if self.landmark_names is None else len(self.landmark_names)
        require(names == p or not n, f"{names} names of {p} landmarks")
        scores = self.confidence
        require(
            scores is None or scores.shape == (n, p), "other confidences than landmarks"
        )
        for field in PER_POSE[2:]:
            values = getattr(self, field)
            fits = values is None or isinstance(values, str) or len(values) == n
            require(fits, f"another number of {field}s than of poses")
        if d == 2:
            missing = (self.points == -1).all(axis=2)
            if scores is not None:
                missing &= ~(scores > 0)
                missing |= (self.points == 0).all(axis=2) & (scores == 0)
            points = np.where(missing[..., None], np.nan, self.points)
            object.__setattr__(self, "points", points)

    def __len__(self) -> int:
        return len(self.points)

    @property
    def individuals(self) -> tuple[str, ...]:
        """The names of the individuals, in order of their first poses."""
        return tuple(filter(None, dict.fromkeys(self.individual or ())))

    @property
    def videos(self) -> Sequence[str]:
        """The video of each pose (N,)."""
        return [self.video] * len(self) if isinstance(self.video, str) else self.video

    def take(self, rows: NDArray[Any]) -> Poses:
        """Return some of the poses, by a mask or by numbers."""
        rows = np.arange(len(self))[rows]
        changes: dict[str, Any] = {}
        for field in PER_POSE:
            values = getattr(self, field)
            if values is not None and not isinstance(values, str):
                array = isinstance(values, np.ndarray)
                changes[field] = (
                    values[rows] if array else [values[row] for row in rows.tolist()]
                )
        return replace(self, **changes)


def of_frames(
    path: Path,
    points: Floats,
    confidence: Floats | None = None,
    labels: Sequence[str] | None = None,
    *,
    individuals: Sequence[str] | None = None,
    present: NDArray[np.bool_] | None = None,
    **fields: Any,
) -> Poses:
    """Return the poses of points (n, [i,] p, d), of i individuals in each of n frames.

    confidence (n, [i,] p); labels (n), by default numbers; names of individuals (i);
    `present` (n, i), the poses that count; `fields` of `Poses`. Raises ValueError for
    sizes that differ.
    """
    n, p, d = len(points), *points.shape[-2:]
    many = points.shape[1] if points.ndim == 4 else 1
    labels = [*map(str, range(n))] if labels is None else labels
    if confidence is not None:
        require(
            confidence.shape == points.shape[:-1], "other confidences than landmarks"
        )
        confidence = confidence.reshape(n * many, p)
    if individuals is not None:
        check_names(individuals, "individual")
        individuals = [*individuals] * n
    defaults: dict[str, Any] = {
        "name": str(path),
        "video": video_name(path),
        "points": points.reshape(n * many, p, d),
        "confidence": confidence,
        "frame": np.repeat(np.arange(n), many),
        "label": [label for label in labels for _ in range(many)],
        "individual": individuals,
        "unit": "px" if d == 2 else UNKNOWN_UNIT,
    }
    poses = Poses(**defaults | fields)
    return poses if present is None else poses.take(present.ravel())


def unit_of(points: Floats) -> dict[str, Any]:
    """Return the fields `unit` and `size_needed` of points (n, p, d) whose file states
    no unit.
    """
    finite = points[np.isfinite(points)]
    inside = finite.size > 0 and bool(finite.min() >= -0.5 and finite.max() <= 1.5)
    fraction = inside and points.shape[2] == 2
    return {"unit": FRACTION if fraction else UNKNOWN_UNIT, "size_needed": fraction}


@contextmanager
def parsing(
    place: str | Path, title: str, fix: str = "export it again"
) -> Iterator[None]:
    """Turn whatever a file leads to here into the InputError that names it and its
    format.
    """
    try:
        yield
    except (InputError, MemoryError):
        raise
    except Exception as error:  # damage leads anywhere
        reason = (
            printable(str(error).strip().partition("\n")[0][:160])
            or type(error).__name__
        )
        reason = f"it has no {reason}" if isinstance(error, KeyError) else reason
        raise input_error(
            place, f"cannot be read as {title} ({reason})", fix
        ) from error


def require(condition: object, problem: str) -> None:
    """Raise ValueError with the problem, unless a condition holds."""
    if not condition:
        raise ValueError(problem)


def check_names(names: Sequence[str], what: str) -> None:
    """Raise ValueError for names that are empty or repeat."""
    require(
        all(isinstance(name, str) and name for name in names),
        f"a {what} without a name",
    )
    twice = next((name for name, number in Counter(names).items() if number > 1), "")
    require(not twice, f"the {what} {twice!r} twice")


# Names.

ENDINGS = re.compile(
    r"(?:\.(?:analysis|predictions|pkg|pose)|_pose_est(?:_v\d+)?)$", re.IGNORECASE
)
IMAGES = re.compile(r"\.(?:png|jpe?g|tiff?|bmp)$", re.IGNORECASE)


def video_name(path: Path) -> str:
    """Return the name of a file without its endings, which is what its items begin
    with.
    """
    return ENDINGS.sub("", Path(path.name.removesuffix(".gz")).stem) or path.name


def image_labels(paths: Sequence[str]) -> list[str]:
    """Return names of images, of any system: without folder and suffix if that tells
    them apart.
    """
    stems = [IMAGES.sub("", PureWindowsPath(path).name) for path in paths]
    return (
        stems
        if len({*stems}) == len(stems)
        else [IMAGES.sub("", path) for path in paths]
    )


LAST_NUMBER = re.compile(r"^(.*?)([0-9]{1,18})([^0-9]*)$", re.DOTALL)


def are_series(names: Sequence[str]) -> bool:
    """Whether names differ in one number alone, and may be frames: there is one in 100
    at least.
    """
    matches = [match for name in names if (match := LAST_NUMBER.match(name))]
    numbers = {int(match[2]) for match in matches}
    alike = len({(m[1], m[3]) for m in matches}) <= 1 and len(numbers) == len(names)
    return alike and (not numbers or max(numbers) - min(numbers) < 100 * len(numbers))


def number_labels(values: NDArray[Any]) -> list[str]:
    """Return frames or seconds as text, to the microsecond. Raises ValueError for no
    number.
    """
    require(np.isfinite(values).all(), "a frame without a number")
    return [f"{value:.6f}".rstrip("0").rstrip(".") for value in values.tolist()]


def make_unique(labels: Sequence[str]) -> tuple[str, ...]:
    """Return labels, numbered where they repeat an earlier one; the eighth, if empty,
    is `*7`.
    """
    times = Counter[str]()
    names: dict[str, None] = {}
    for place, label in enumerate(labels):
        name = first = label.strip() or f"*{place}"
        while name in names:
            times[first] += 1
            name = f"{first}_{times[first] + 1}"
        names[name] = None
    return tuple(names)


def name_individual(who: Any) -> str:
    """Return an identity, or [it], as text: `id 3` for 3; "" for what is below 0, or of
    no kind.
    """
    while isinstance(who, list) and len(who) == 1:
        who = who[0]
    if isinstance(who, str):
        return who
    number = isinstance(who, int | float) and not isinstance(who, bool)
    return f"id {who:g}" if number and who >= 0 else ""


def edges_of(lines: Sequence[tuple[int, int]] | None, landmarks: int) -> Edges:
    """Return those of a list of lines that join two of so many landmarks."""
    return tuple(
        (a, b) for a, b in lines or () if min(a, b) >= 0 and max(a, b) < landmarks
    )
