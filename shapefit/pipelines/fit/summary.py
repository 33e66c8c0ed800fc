"""What is told of a fit: of each batch while it runs, and of all images at its end."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from shapefit.arrays import Flags, Floats, Integers, median
from shapefit.convex.solver import Status
from shapefit.errors import abbreviate, as_typed, counted
from shapefit.io import LandmarkSource
from shapefit.io.options import Summary
from shapefit.io.skeletons import joint_columns
from shapefit.lifting import trust
from shapefit.lifting.estimate import Estimate
from shapefit.lifting.lift import Lifting
from shapefit.lifting.methods import METHODS
from shapefit.pipelines.fit.choices import warn_of_dictionary
from shapefit.pipelines.joints import is_of_people
from shapefit.pipelines.result import (
    CameraNumbers,
    Counted,
    Failure,
    Numbers,
    Result,
    warn_of_empty,
)
from shapefit.records import Fit, Landmarks

if TYPE_CHECKING:
    from shapefit.config.commands.fit import CameraConfig, FitConfig
    from shapefit.pipelines.fit.fit import FitPlan

ON_HEAD_COSINE = 0.5
"""Of the angle to the vertical of the image, within which a body is on its head."""

UPPER_END = ("head", "neck", "lshoulder", "rshoulder")
"""Joints of a body, of which the first two that it has are its upper end."""

LOWER_END = ("lankle", "rankle", "lhip", "rhip")
"""Likewise of its lower end."""

MISNAMED_SHARE = 0.5
"""Of the images that show a landmark, in which it is an outlier, to doubt its name."""

MIN_IMAGES_OF_NAME = 10
"""Images that show a landmark, to doubt its name."""

VIEWED_ENDINGS = (".h5", ".hdf5", ".hdf", ".he5", ".csv", ".trc")
"""Of results that `shapefit view` shows."""

MAX_NAMED_FILES = 4
"""Files of a fit that the command to go on with names one by one."""


class InputsRead(NamedTuple):
    """What was read of landmarks: their head, without images, and how many images.

    left_out, how many others the options leave out; notes, warnings about the files.
    """

    head: Landmarks
    images: int
    left_out: int = 0
    notes: tuple[str, ...] = ()

    @classmethod
    def of(cls, source: LandmarkSource) -> InputsRead:
        """Return what was read of an open source."""
        return cls(source.head, source.count, source.left_out, source.notes)


class Ends(NamedTuple):
    """How the work on each of n images ended, as far as it is reported.

    status, one of each image; limit, the text that names what those of an iteration
    limit have reached, "" for no text; is_empty (n,), whether the shape is 0 where
    there is one; failures, image -> reason.
    """

    status: tuple[Status, ...]
    limit: str
    is_empty: Flags
    failures: Mapping[int, str]

    @classmethod
    def of(cls, lifting: Lifting[Estimate]) -> Ends:
        """Return how the images of a lifting ended."""
        estimate = lifting.estimate
        is_empty = ~estimate.shapes.any(axis=(1, 2)) & np.isfinite(lifting.scale)
        is_empty[list(lifting.failures)] = False
        return cls(estimate.status, estimate.limit, is_empty, lifting.failures)

    def take(self, rows: slice) -> Ends:
        """Return how the images `rows`, first to before the last, ended."""
        failures = {
            row - rows.start: self.failures[row]
            for row in range(rows.start, rows.stop)
            if row in self.failures
        }
        return Ends(self.status[rows], self.limit, self.is_empty[rows], failures)


def describe_batch(record: Fit, ends: Ends) -> Result:
    """Return the event of a lifted batch: failures, warnings, reasons not to trust."""
    items = record.items
    failed = sorted(ends.failures.items())
    return Result(
        done=len(items),
        failures=tuple(Failure(items[row], why) for row, why in failed),
        warnings=tuple(warn_of_batch(ends)),
        reasons=tuple(count_reasons(record)),
    )


def warn_of_batch(ends: Ends) -> Iterator[Counted]:
    """Yield warnings, with counts, of images that are not optimal or have no shape."""
    limited = ends.status.count(Status.ITERATION_LIMIT)
    if limited:
        text = f"not optimal: {ends.limit}" if ends.limit else "not optimal"
        yield Counted(limited, "image", text)
    if ends.is_empty.any():
        text = (
            "with an empty shape: lambda is at or above lambda_max of the image; lower"
            " `lambda`"
        )
        yield Counted(int(ends.is_empty.sum()), "image", text)


def count_reasons(record: Fit) -> Iterator[Counted]:
    """Count the images that have a shape not to be trusted, by their reasons."""
    items: dict[str, list[str]] = {}
    if record.reasons is None:
        return
    for item, reason in zip(record.items, record.reasons.tolist(), strict=True):
        if reason not in ("", trust.NO_SHAPE):  # which has failed
            items.setdefault(reason, []).append(item)
    for reason, names in items.items():
        yield Counted(len(names), "image", reason, tuple(names))


@dataclass(eq=False, repr=False)
class Tally:
    """What adds up over the batches of a fit, for its end.

    judged images have a verdict; errors are those expected of trusted ones, in metres;
    outliers and visible (p,) count images by landmark, None without a prior. bodies
    have both ends. solved images have a gap; largest_gap is that of them all, and
    largest_convex_gap that of convex programs that were refined in perspective.
    """

    images: int = 0
    sequences: set[str] = field(default_factory=set)
    judged: int = 0
    trusted: int = 0
    errors: list[float] = field(default_factory=list)
    outliers: Integers | None = None
    visible: Integers | None = None
    bodies: int = 0
    on_head: int = 0
    solved: int = 0
    optimal: int = 0
    largest_gap: float | None = None
    largest_convex_gap: float | None = None

    def add(self, record: Fit) -> None:
        """Add the images, sequences, verdicts, gaps and bodies of a batch."""
        self.images += len(record)
        self.sequences.update(record.sequences or ())
        self.add_verdicts(record)
        self.add_gaps(record)
        self.add_bodies(record)

    def add_verdicts(self, record: Fit) -> None:
        """Add trusted images, their expected errors, and outliers by landmark."""
        if record.trusted is None or record.expected_error is None:
            return
        self.judged += len(record)
        self.trusted += int(record.trusted.sum())
        metres = find_metres(record)
        if metres is not None:
            errors = record.expected_error * metres
            self.errors += errors[record.trusted & np.isfinite(errors)].tolist()
        probability = record.inlier_probability
        assert probability is not None, "it comes with every verdict"
        outliers = (probability < trust.MIN_INLIER_PROBABILITY).sum(axis=0)
        visible = np.isfinite(probability).sum(axis=0)
        self.outliers = outliers if self.outliers is None else self.outliers + outliers
        self.visible = visible if self.visible is None else self.visible + visible

    def add_gaps(self, record: Fit) -> None:
        """Add solved and optimal images, and keep the largest gap.

        A fit that was refined in perspective has no gap but that of the convex program
        from which it started.
        """
        if record.relative_gap is None:
            self.largest_convex_gap = largest_of(
                self.largest_convex_gap, record.convex_relative_gap
            )
            return
        self.largest_gap = largest_of(self.largest_gap, record.relative_gap)
        gaps = record.relative_gap[np.isfinite(record.relative_gap)]
        self.solved += len(gaps)
        if record.status is not None:
            self.optimal += int((record.status == Status.OPTIMAL.value).sum())

    def add_bodies(self, record: Fit) -> None:
        """Add shapes of people to the counts of bodies, and of those upside down."""
        names = record.landmark_names
        if not is_of_people(names):
            return
        columns = joint_columns(names)
        upper = [columns[joint] for joint in UPPER_END if joint in columns][:2]
        lower = [columns[joint] for joint in LOWER_END if joint in columns][:2]
        if not upper or not lower:
            return
        body = middle_of(record.shapes, upper) - middle_of(record.shapes, lower)
        body = body[np.isfinite(body).all(axis=1)]
        down = -body[:, 1] if record.y_axis == "up" else body[:, 1]
        length = np.linalg.norm(body, axis=1)
        self.bodies += len(body)
        self.on_head += int((down > ON_HEAD_COSINE * length).sum())


def find_metres(record: Fit) -> Floats | None:
    """Return the metres per unit of each image (n,), by its stated height if any."""
    if record.stated_height is None:
        return record.metres_per_unit
    from shapefit.io.writers.metres import with_stated_height

    return with_stated_height(record, "fit").metres_per_unit


def largest_of(before: float | None, gaps: Floats | None) -> float | None:
    """Return the largest of the finite gaps (n,) and the one before; None for none.

    Of a gap that rounding leaves below 0 the size counts, as for its status.
    """
    known = [] if gaps is None else np.abs(gaps[np.isfinite(gaps)]).tolist()
    if before is not None:
        known.append(before)
    return max(known, default=None)


def middle_of(shapes: Floats, landmarks: Sequence[int]) -> Floats:
    """Return the mean (n, 3) of some landmarks of shapes (n, p, 3)."""
    middle: Floats = shapes[:, landmarks].mean(axis=1)
    return middle


def summarise_fit(
    read: InputsRead, plan: FitPlan, tally: Tally, chosen: str, written: Summary
) -> Result:
    """Return the last Result of a fit: warnings about all images, and the summary.

    chosen says what chose the method, "" where the config did.
    """
    head = read.head
    calibration = plan.calibration
    warnings = [
        *calibration.warnings,
        *warn_of_empty(read.images, "images"),
        *note_left_out(read.left_out, plan.config),
        *read.notes,
        *plan.match.warnings(),
        *warn_of_dictionary(plan.config, plan.match.dictionary),
        *warn_of_all(tally, plan, head),
        *written.warnings,
    ]
    return Result(
        total=read.images,
        warnings=tuple(warnings),
        note="; ".join([f"y {head.y_axis} in the images", *calibration.lines]),
        rows=tuple(summary_rows(read, plan, tally, chosen, written)),
        numbers=result_numbers(plan, tally),
        written=written.written or (output_of(plan),),
        digest=written.digest,
    )


def note_left_out(left_out: int, config: FitConfig) -> Iterator[Counted]:
    """Yield a note of how many images the config leaves out, if any."""
    if not left_out:
        return
    keys = []
    if config.frames is not None:
        keys.append(f"`frames: {config.frames}`")
    if config.every > 1:
        keys.append(f"`every: {config.every}`")
    text = f"left out by {' and '.join(keys)}"
    yield Counted(left_out, "image", text, is_note=True)


def warn_of_all(
    tally: Tally, plan: FitPlan, head: Landmarks
) -> Iterator[str | Counted]:
    """Yield warnings that need all images: people on their heads, wrong names, no rate.

    head, as the files state it.
    """
    if 2 * tally.on_head > tally.bodies:
        other = "up" if head.y_axis == "down" else "down"
        text = (
            f"with people on their heads: y was taken to point {head.y_axis}: if it"
            f" points {other}, set `y_axis: {other}`; or is the video turned by 180"
            " degrees?"
        )
        yield Counted(tally.on_head, "image", text)
    yield from warn_of_names(tally, plan)
    has_rate = plan.config.frame_rate or head.frame_rate
    if METHODS[plan.config.method].takes_sequences and not has_rate:
        yield (
            "the frame rate is unknown, so the motion from image to image is taken for"
            " that of the training shapes; set `frame_rate`"
        )


def warn_of_names(tally: Tally, plan: FitPlan) -> Iterator[Counted]:
    """Yield a warning for each landmark that is an outlier in most images with it."""
    if tally.outliers is None or tally.visible is None:
        return
    names = plan.match.dictionary.landmark_names
    shown = np.maximum(tally.visible, MIN_IMAGES_OF_NAME)
    for j in np.flatnonzero(tally.outliers > MISNAMED_SHARE * shown):
        in_file = plan.match.joints.markers.get(names[j], (names[j],))
        yield Counted(int(tally.outliers[j]), "image", describe_misnamed(in_file))


def describe_misnamed(names: Sequence[str]) -> str:
    """Say that landmarks of the files, which make one joint, contradict the model."""
    if len(names) == 1:
        (name,) = names
        return (
            f"in which {name} contradicts the model: rename it if it is another point"
            f" of the body, or leave it out with `rename={{{name}: unused}}`"
        )
    unused = ", ".join(
        f"{name}: unused_{number}" for number, name in enumerate(names, 1)
    )
    return (
        f"in which {' and '.join(names)} contradict the model: rename them if they are"
        f" other points of the body, or leave them out with `rename={{{unused}}}`"
    )


def summary_rows(
    read: InputsRead, plan: FitPlan, tally: Tally, chosen: str, written: Summary
) -> Iterator[tuple[str, str]]:
    """Yield the rows of the summary, label and text."""
    yield "Read", describe_inputs(read, plan, tally)
    yield "Method", chosen or plan.config.method
    yield "Camera", plan.calibration.lines[0].removeprefix("camera: ")
    if written.note:
        yield "Metres", written.note
    result = describe_result(plan, tally)
    yield "Result", "; ".join(filter(None, [result, written.angles]))
    output = output_of(plan)
    files = find_viewed(written.written or (output,), output)
    if files:
        yield "Next", f"shapefit view {' '.join(map(as_typed, files))}"


def describe_inputs(read: InputsRead, plan: FitPlan, tally: Tally) -> str:
    """Return a text: which files were read, how many images, what was matched."""
    names = [path.name or str(path) for path in plan.config.landmarks]
    text = f"{abbreviate(names, 1)}: {counted(tally.images, 'image')}"
    if tally.sequences:
        text += f" of {counted(len(tally.sequences), 'sequence')}"
    matched = sum(map(len, plan.match.joints.markers.values()))
    if matched:
        keypoints = len(read.head.landmark_names)
        text += f"; matched {matched} of {keypoints} keypoints"
    return text


def describe_result(plan: FitPlan, tally: Tally) -> str:
    """Return a text: how many images are trusted, or how far from the optimum."""
    images = counted(tally.images, "image")
    if tally.judged:
        text = f"{tally.trusted} of {images} trusted"
        if tally.errors:
            centimetres = 100 * median(np.array(tally.errors))
            of_seen = describe_seen_landmarks(plan)
            text += f", expected error about {centimetres:.0f} cm{of_seen}"
        return text
    bars = "no error bars by this method"
    if plan.match.dictionary.prior is None:
        bars = "no error bars: `learn-dict --prior` learns what they need"
    return f"{images}{describe_gap(plan, tally)} ({bars})"


def describe_gap(plan: FitPlan, tally: Tally) -> str:
    """Return the end of a line: how far images are from the optimum, "" if unknown."""
    if tally.largest_gap is None and tally.largest_convex_gap is not None:
        return f", convex programs within {tally.largest_convex_gap:.1e}"
    is_bound = METHODS[plan.config.method].proves == "bound"
    missed = None if is_bound else tally.solved - tally.optimal
    return format_gap(tally.largest_gap, missed)


def format_gap(largest_gap: float | None, missed: int | None) -> str:
    """Return the end of a line that states the largest gap, "" without one.

    missed, how many images are not optimal, None where the gap is one to a bound.
    """
    if largest_gap is None:
        return ""
    if missed is None:
        return f", within {largest_gap:.1e} of the convex bound"
    solved = f"{missed:,} not optimal" if missed else "all optimal"
    return f", {solved}, largest gap {largest_gap:.1e}"


def describe_seen_landmarks(plan: FitPlan) -> str:
    """Return " of the 12 landmarks that are seen", to end a line; "" if all are."""
    shown = plan.calibration.shown
    independent = plan.match.dictionary.depends_on < 0
    if not shown or sum(shown) == independent.sum():
        return ""
    return f" of the {sum(shown)} landmarks that are seen"


def result_numbers(plan: FitPlan, tally: Tally) -> Numbers:
    """Return the numbers of a fit for programs: images, trust, gaps and camera."""
    error = float(median(np.array(tally.errors))) if tally.errors else None
    certifies = METHODS[plan.config.method].proves in ("optimum", "global")
    has_gaps = certifies and tally.largest_gap is not None
    return Numbers(
        images=tally.images,
        trusted=tally.trusted if tally.judged else None,
        expected_error_metres=error,
        optimal=tally.optimal if has_gaps else None,
        not_optimal=tally.solved - tally.optimal if has_gaps else None,
        largest_gap=tally.largest_gap,
        camera=camera_numbers(plan.config.camera),
    )


def camera_numbers(camera: CameraConfig) -> CameraNumbers:
    """Return the camera's numbers of a config that leaves none of them open."""
    focal = camera.focal
    return CameraNumbers(
        perspective=focal != "none",
        focal=None if isinstance(focal, str) else focal,
        principal_point=camera.principal_point,
    )


def find_viewed(written: Sequence[Path], output: Path) -> Sequence[Path]:
    """Return the written files that `shapefit view` can show, for the next command.

    Many are named by one glob. `output` is the name that was asked for, of which
    several files may have been made.
    """
    files = [path for path in written if is_viewed(path)]
    if len(files) <= MAX_NAMED_FILES:
        return files
    ending = ".metres.csv" if output.match("*.metres.csv") else output.suffix
    return [output.with_name(f"{output.name.removesuffix(ending)}_*{ending}")]


def is_viewed(path: Path) -> bool:
    """Whether `shapefit view` shows a file."""
    of_angles = path.name.lower().endswith(("_angles.csv", ".angles.csv"))
    return path.suffix.lower() in VIEWED_ENDINGS and not of_angles


def output_of(plan: FitPlan) -> Path:
    """Return the file of the result."""
    return Path(str(plan.config.output))
