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
from typing import NamedTuple, TypedDict, Unpack

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Flags, Floats, Indices, Integers, Numbers
from shapefit.errors import InputError, input_error, printable
from shapefit.io.layout import UNKNOWN_UNIT
from shapefit.io.options import Direction
from shapefit.timeline import UNKNOWN_RATE

FRACTION = "fraction of the image"
"""Unit of coordinates that are divided by the width and the height of the image."""

Edges = tuple[tuple[int, int], ...]

PER_POSE = ("points", "confidence", "frame", "time", "label", "individual", "video")


@dataclass(frozen=True, kw_only=True, eq=False)
class Poses:
    """N poses of p landmarks in d dimensions, each of one individual in one frame.

    A pose is the landmarks of one body, as a reader finds them in a file.

    name        the path, for messages
    points      (N, p, 2) or (N, p, 3), NaN where a landmark is missing
    confidence  (N, p), NaN where a landmark has none (then 1); None where the format
                has none
    frame       (N,), whole numbers, in any order: the place of the frame in its video,
                from 0 for the first that the file has there; a missing frame leaves a
                gap
    time        (N,) in seconds, as the file states it, nan where it does not; None
                where the format has none
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
    flat        whether the file's points are in 3D, their z 0 everywhere
    or_else     of fractions of the image: what else the numbers may be, for the message
    notes       warnings: what was left out or replaced, what is uncertain
    """

    name: str
    points: Floats
    confidence: Floats | None = None
    frame: Integers
    time: Floats | None = None
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
    flat: bool = False
    or_else: str = ""
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Check the fields, or raise FormatError; set missing 2D landmarks to NaN.

        Their sizes must agree, names be filled and unique, and a frame rate positive.

        In 2D what tools write for a missing landmark becomes NaN: (-1, -1) without a
        confidence or with 0, and (0, 0) with a confidence of 0.
        """
        n, p, d = self.points.shape
        require(d in (2, 3), f"points of {d} coordinates")
        check_names(self.landmark_names or (), "landmark")
        names = p if self.landmark_names is None else len(self.landmark_names)
        require(names == p or not n, f"{names} names of {p} landmarks")
        rate = self.frame_rate
        require(rate is None or 0 < rate < np.inf, f"a frame rate of {rate} Hz")
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
        """The name of the video of each pose (N,)."""
        return [self.video] * len(self) if isinstance(self.video, str) else self.video

    def take(self, rows: Flags | Integers | Indices) -> Poses:
        """Return the poses at `rows`, a mask (N,) or indices."""
        rows = np.arange(len(self))[rows]
        changes: dict[str, object] = {}
        for field in PER_POSE:
            values = getattr(self, field)
            if values is not None and not isinstance(values, str):
                array = isinstance(values, np.ndarray)
                changes[field] = (
                    values[rows] if array else [values[row] for row in rows.tolist()]
                )
        return replace(self, **changes)  # type: ignore[arg-type]


class PoseFields(TypedDict, total=False):
    """Fields of Poses beside points and confidences."""

    landmark_names: tuple[str, ...] | None
    skeleton: str | None
    frame_rate: float | None
    edges: Edges
    size_needed: bool
    unordered: bool
    named: bool
    y_axis: Direction | None
    flat: bool
    or_else: str
    unit: str
    notes: tuple[str, ...]
    video: str | Sequence[str]
    individual: Sequence[str]
    frame: Integers
    time: Floats | None


class UnitFields(TypedDict):
    """The unit of points, and whether they are useless without `image_size`."""

    unit: str
    size_needed: bool


class FrameFields(PoseFields, total=False):
    """What `poses_from_frames` takes beside points and confidences."""

    labels: Sequence[str]
    frames: Sequence[int] | Integers | None
    times: Floats | None
    individuals: Sequence[str] | None
    present: NDArray[np.bool_] | None


def poses_from_frames(
    path: Path,
    points: Floats,
    confidence: Floats | None = None,
    labels: Sequence[str] | None = None,
    *,
    frames: Sequence[int] | Integers | None = None,
    times: Floats | None = None,
    individuals: Sequence[str] | None = None,
    present: NDArray[np.bool_] | None = None,
    **fields: Unpack[PoseFields],
) -> Poses:
    """Make Poses of points (n, p, d) or (n, i, p, d), of i individuals in n frames.

    confidence (n, [i,] p); labels (n), by default numbers; frames (n), by default one
    after the other, and times (n); names of individuals (i); `present` (n, i), the
    poses that count; `fields` of `Poses`. Raises FormatError for sizes that differ.
    """
    n, p, d = len(points), *points.shape[-2:]
    many = points.shape[1] if points.ndim == 4 else 1
    labels = [*map(str, range(n))] if labels is None else labels
    if isinstance(video := fields.get("video"), list):
        fields["video"] = [name for name in video for _ in range(many)]
    if confidence is not None:
        require(
            confidence.shape == points.shape[:-1], "other confidences than landmarks"
        )
        confidence = confidence.reshape(n * many, p)
    if individuals is not None:
        check_names(individuals, "individual")
        individuals = [*individuals] * n
    defaults: PoseFields = {
        "video": video_name(path),
        "frame": np.repeat(np.arange(n) if frames is None else frames, many),
        "time": None if times is None else np.repeat(times, many),
        "unit": "px" if d == 2 else UNKNOWN_UNIT,
    }
    if individuals is not None:
        defaults["individual"] = individuals
    defaults.update(fields)
    poses = Poses(
        name=str(path),
        points=points.reshape(n * many, p, d),
        confidence=confidence,
        label=[label for label in labels for _ in range(many)],
        **defaults,
    )
    return poses if present is None else poses.take(present.ravel())


def guess_unit(points: Floats) -> UnitFields:
    """Guess the unit of points whose file states none: fractions of the image, or none.

    Points (n, p, 2) are fractions where all lie within -0.5 and 1.5.
    """
    finite = points[np.isfinite(points)]
    inside = finite.size > 0 and bool(finite.min() >= -0.5 and finite.max() <= 1.5)
    fraction = inside and points.shape[2] == 2
    return {"unit": FRACTION if fraction else UNKNOWN_UNIT, "size_needed": fraction}


class FormatError(Exception):
    """What a reader finds wrong with a file, in words of its format, and what to do.

    Whoever opened the file turns it into an InputError that names the file; see
    `parsing`.
    """

    def __init__(self, problem: str, fix: str = "") -> None:
        super().__init__(problem)
        self.problem, self.fix = problem, fix


@contextmanager
def parsing(
    place: str | Path, title: str, fix: str = "export it again"
) -> Iterator[None]:
    """Turn a FormatError into an InputError that names the place and the format.

    All else that a reader raises is an error of its own, and passes.
    """
    try:
        yield
    except FormatError as error:
        problem = f"cannot be read as {title} ({printable(error.problem)})"
        raise input_error(place, problem, error.fix or fix) from error


@contextmanager
def library_reads(problem: str, fix: str = "") -> Iterator[None]:
    """Turn any exception of a library for a damaged file into a FormatError.

    For the call of a library alone: what damage leads to there is not ours to check.
    """
    try:
        yield
    except (InputError, FormatError, MemoryError):
        raise
    except Exception as error:
        raise FormatError(problem, fix) from error


def as_numbers(values: object, subject: str) -> Floats:
    """Convert nested lists of numbers to an array, null to NaN; FormatError otherwise.

    The subject names the values in the message.
    """
    try:
        return np.array(values, np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise FormatError(f"{subject} are not all numbers, or of one length") from error


def require(condition: object, problem: str, fix: str = "") -> None:
    """Raise FormatError(problem, fix) unless the condition is true."""
    if not condition:
        raise FormatError(problem, fix)


def check_names(names: Sequence[str], noun: str) -> None:
    """Raise FormatError for names that are empty or occur twice.

    The noun says in the message what they name, such as "landmark".
    """
    require(
        all(isinstance(name, str) and name for name in names),
        f"a {noun} without a name",
    )
    twice = next((name for name, number in Counter(names).items() if number > 1), "")
    require(not twice, f"the {noun} {twice!r} twice")


# Names.

ENDINGS = re.compile(
    r"(?:\.(?:analysis|predictions|pkg|pose)|_pose_est(?:_v\d+)?)$", re.IGNORECASE
)
IMAGES = re.compile(r"\.(?:png|jpe?g|tiff?|bmp)$", re.IGNORECASE)


def video_name(path: Path) -> str:
    """Return a file's name without suffixes such as .analysis.h5, as a video's name."""
    return ENDINGS.sub("", Path(path.name.removesuffix(".gz")).stem) or path.name


def image_labels(paths: Sequence[str]) -> list[str]:
    """Return paths of images without folder and suffix, if the names then are unique.

    Else without suffix. They may be those of any system.
    """
    stems = [IMAGES.sub("", PureWindowsPath(path).name) for path in paths]
    return (
        stems
        if len({*stems}) == len(stems)
        else [IMAGES.sub("", path) for path in paths]
    )


NUMBER_IN_NAME = re.compile("([0-9]{1,18})")

SPARSEST = 100
"""How many numbers of names there are at most for each frame that is there."""


def series_numbers(names: Sequence[str], sparsest: int = SPARSEST) -> list[int] | None:
    """Return the number in each name if names differ in one number alone, else None.

    Of one name it is the last number. It is None, too, where there is less than one
    name for every `sparsest` numbers of their range.
    """
    parts = [NUMBER_IN_NAME.split(name) for name in names]  # text, number, text, ...
    if len({len(part) for part in parts}) > 1:
        return None
    columns = [*zip(*parts, strict=True)]
    if any(len({*texts}) > 1 for texts in columns[::2]):
        return None
    runs = [[*map(int, column)] for column in columns[1::2]]
    differing = [run for run in runs if len({*run}) > 1] or runs[-1:]
    if len(differing) != 1 or len({*differing[0]}) < len(names):
        return None if names else []
    numbers = differing[0]
    spread = max(numbers) - min(numbers)
    return numbers if spread < sparsest * len(numbers) else None


def are_series(names: Sequence[str]) -> bool:
    """Whether names differ in one number alone, so that they may be frames."""
    return series_numbers(names) is not None


class Images(NamedTuple):
    """Images with detections: the path of the file or folder, for messages, and of each
    image (n,) its video, its frame in the video, and its label in the file.

    They are `unordered` where their names have no numbers of frames.
    """

    name: str
    videos: Sequence[str]
    frames: Sequence[int]
    labels: Sequence[str]
    unordered: bool = False


def place_images(
    path: Path,
    files: Sequence[str],
    videos: Sequence[str] | None = None,
    sparsest: int = SPARSEST,
    stated: Sequence[int | None] | None = None,
) -> Images:
    """Find the video, frame and label of images by their file names, as Images.

    Videos are those given, or the folders in which images are numbered, or one.

    Frames are those `stated`, where each image of a video has one of its own. Names
    that differ in a number alone are frames, too; else the order is that of the file.
    """
    if videos is None:
        videos = _folders_of_series(files)
    base = video_name(path)
    rows_of: dict[str, list[int]] = {}
    for row in range(len(files)):
        rows_of.setdefault("" if videos is None else videos[row], []).append(row)
    names = [base] * len(files)
    frames = [0] * len(files)
    labels = [""] * len(files)
    unordered = False
    for video, rows in rows_of.items():
        inside = image_labels([files[row] for row in rows])
        numbers = frame_numbers(inside, sparsest)
        frame_of = {row: stated[row] for row in rows} if stated else {}
        known = {frame for frame in frame_of.values() if frame is not None}
        if known and len(known) == len(rows):
            numbers = [(frame_of[row] or 0) - min(known) for row in rows]
        unordered |= numbers is None
        places = range(len(rows)) if numbers is None else numbers
        for row, label, place in zip(rows, inside, places, strict=True):
            names[row] = base if videos is None else f"{base}/{video}"
            frames[row] = place
            labels[row] = label
    return Images(str(path), names, frames, labels, unordered)


def _folders_of_series(files: Sequence[str]) -> list[str] | None:
    """Return each image's folder if several folders have numbered images, else None."""
    folders = [PureWindowsPath(file).parent for file in files]
    names_in: dict[PureWindowsPath, list[str]] = {}
    for folder, file in zip(folders, files, strict=True):
        names_in.setdefault(folder, []).append(
            IMAGES.sub("", PureWindowsPath(file).name)
        )
    several = len(names_in) > 1 and max(map(len, names_in.values())) > 1
    bare = PureWindowsPath() in names_in
    if not several or bare or not all(map(are_series, names_in.values())):
        return None
    unique = len({folder.name for folder in names_in}) == len(names_in)
    return [folder.name if unique else folder.as_posix() for folder in folders]


def frame_numbers(names: Sequence[str], sparsest: int = SPARSEST) -> list[int] | None:
    """Return the frame of each name, from 0 for the least number; None for no series.

    The number is that of `series_numbers`.
    """
    numbers = series_numbers(names, sparsest)
    if numbers is None:
        return None
    first = min(numbers, default=0)
    return [number - first for number in numbers]


def frames_of_labels(labels: Sequence[str]) -> list[int] | None:
    """Convert labels to frames, from 0 for the least; None if not all are numbers.

    Raises FormatError for a number that is there twice.
    """
    if not all(label.isascii() and label.isdecimal() for label in labels):
        return None
    numbers = [int(label[:MAX_FRAME_DIGITS]) for label in labels]
    twice = next((n for n, times in Counter(numbers).items() if times > 1), None)
    require(twice is None, f"frame {twice} twice")
    first = min(numbers, default=0)
    return [number - first for number in numbers]


MAX_FRAME_DIGITS = 18
"""Digits of a number of a frame, which fit in 64 bits."""

OFF_STEP = 0.2
"""How far times lie from whole steps at most, in steps, that are those of frames."""


RATES = (0.5, 2000.0)
"""Frame rates, in Hz, that times can state: others are no seconds, or no video."""


RATE_UNKNOWN = (
    "1 Hz stands for an unknown frame rate, and its times for frames: set `frame_rate`"
)
"""Note on a file that states this rate, as programs do that know none."""


def check_rate(rate: float | None) -> tuple[bool, tuple[str, ...]]:
    """Return whether a frame rate (Hz) that a file states is known, and a note if not.

    Formats may demand a rate: shapefit, as other programs, then writes UNKNOWN_RATE.
    """
    if rate is None or not 0 < rate < np.inf:
        return False, ()
    if rate == UNKNOWN_RATE:
        return False, (RATE_UNKNOWN,)
    return True, ()


def frames_of_times(times: Floats, rate: float | None) -> list[int] | None:
    """Convert times (n,) in seconds to frames, from 0; None if not on a regular grid.

    Steps count from the first time, and last 1 / rate, or else as long as the usual or
    the least step.
    """
    if not len(times) or not np.isfinite(times).all():
        return None
    if rate:
        return _frames_at(times, rate)
    steps = np.diff(np.unique(times))
    if not len(steps):
        return None
    usual = np.sort(steps)[(len(steps) - 1) // 2]
    for step in (usual, steps.min()):  # the least where most frames are missing
        counts = np.rint(steps / step)
        found = float(counts.sum() / steps.sum())
        if RATES[0] <= found <= RATES[1]:
            frames = _frames_at(times, found)
            if frames is not None:
                return frames
    return None


def _frames_at(times: Floats, rate: float) -> list[int] | None:
    """Convert times (n,) in s to frames at `rate` in Hz; None if any lies between."""
    places = (times - times.min()) * rate
    whole = np.rint(places)
    small = np.abs(places).max() < 10.0**MAX_FRAME_DIGITS
    alone = len(np.unique(whole)) == len(whole)
    if not small or not alone or (np.abs(places - whole) > OFF_STEP).any():
        return None
    return [int(place) for place in whole.tolist()]


def number_labels(values: Numbers) -> list[str]:
    """Format frames or seconds as texts, to the microsecond; FormatError for NaN."""
    require(np.isfinite(values).all(), "a frame without a number")
    return [f"{value:.6f}".rstrip("0").rstrip(".") for value in values.tolist()]


def number_repeats(labels: Sequence[str]) -> tuple[str, ...]:
    """Make labels unique: one that repeats an earlier one gets a number, `a_2`.

    An empty one is `*7` if it is the eighth.
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


def name_individual(who: object) -> str:
    """Return the name for an identity in a file: a text itself, `id 3` for 3, or "".

    It is "" for numbers below 0, and values of other types. A list of one value is
    taken for the value.
    """
    while isinstance(who, list) and len(who) == 1:
        who = who[0]
    if isinstance(who, str):
        return who
    if isinstance(who, bool) or not isinstance(who, int | float):
        return ""
    return f"id {who:g}" if who >= 0 else ""


def skeleton_edges(content: object, landmark_count: int, *, first: int = 0) -> Edges:
    """Return index pairs of a list of edges in JSON, those of two existing landmarks.

    The file counts landmarks from `first`. Edges of another kind are left out.
    """
    pairs: list[tuple[int, int]] = []
    for edge in content if isinstance(content, list) else []:
        ends = edge if isinstance(edge, list) else []
        whole = [end - first for end in ends if isinstance(end, int)]
        if not len(ends) == len(whole) == 2:
            continue
        if 0 <= min(whole) <= max(whole) < landmark_count:
            pairs.append((whole[0], whole[1]))
    return tuple(pairs)
