"""What a fit reports: images without a shape, what to look at, and a summary in a few rows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from shapefit.convex.solver import Status
from shapefit.errors import abbreviate, counted, input_error
from shapefit.io import LandmarkSet, LandmarkSource, ResultSet
from shapefit.io.layout import METRES_PER_UNIT, free_names
from shapefit.io.options import Summary
from shapefit.io.skeletons import joint_columns
from shapefit.lifting.lift import Lifting
from shapefit.lifting.methods import METHODS
from shapefit.lifting.verdict import EXPECTED_ERROR, NO_SHAPE, REASONS, TRUSTED
from shapefit.pipelines.fit.camera import warn_of_lens
from shapefit.pipelines.fit.lift import LEAVE_ONE_OUT, find_items
from shapefit.pipelines.fit.prepare import Setup, output_format, warn_of_dictionary
from shapefit.pipelines.fit.record import OF_A_RESULT
from shapefit.pipelines.fit.sample import FEWEST, MOSTLY, OUTLIER
from shapefit.pipelines.joints import is_of_people
from shapefit.pipelines.outcome import Counted, Failure, Outcome, nothing_in

if TYPE_CHECKING:
    from shapefit.pipelines.meshes import MeshWriter

STEEP = 0.5
"""Cosine of the angle in the image to the vertical within which a body stands, or is on its head:
60 degrees. A body that is seen along its axis, less than this share of it, is neither."""

ENDS = (("head", "neck", "lshoulder", "rshoulder"), ("lankle", "rankle", "lhip", "rhip"))
"""Joints at the upper and the lower end of a body: the first two that there are."""

VIEWED = (".h5", ".hdf5", ".hdf", ".he5", ".csv", ".trc")
"""Endings of results that `shapefit view` shows."""


def outcome_of(
    images: LandmarkSet,
    lifting: Lifting,
    record: ResultSet,
    setup: Setup,
    total: int | None = None,
) -> Outcome:
    """Return the outcome of a batch, of `total` images."""
    reasons = lifting.failures
    return Outcome(
        done=len(images),
        total=total,
        failures=tuple(Failure(images.items[image], reasons[image]) for image in sorted(reasons)),
        warnings=tuple(warn_of_batch(images, lifting, setup)),
        reasons=count_reasons(record),
    )


def warn_of_batch(images: LandmarkSet, lifting: Lifting, setup: Setup) -> Iterator[str | Counted]:
    """Count images that are not optimal or empty; warn of confidences."""
    estimate = lifting.estimate
    limited = [i for i, status in enumerate(estimate.status) if status is Status.ITERATION_LIMIT]
    if limited:
        gap = np.zeros(len(images)) if estimate.relative_gap is None else estimate.relative_gap
        worst = max(limited, key=lambda image: np.nan_to_num(gap[image]))
        severity = float(np.nan_to_num(gap[worst]))
        text, example = "not optimal", describe(lifting, worst)
        yield Counted(len(limited), "image", text, worst=example, severity=severity)
    confidence, precisions = images.confidence, METHODS[setup.config.method].precisions
    if not precisions and confidence is not None and (confidence > 1).any():
        yield (
            "confidences above 1: they are weights, and larger ones count more against `lambda`; "
            "divide them by their largest value if that is not intended"
        )
    empty = ~estimate.shapes.any(axis=(1, 2)) & np.isfinite(lifting.scale)
    empty[list(lifting.failures)] = False
    if empty.any():
        text = (
            "with an empty shape, all landmarks at one point: lambda is at or above lambda_max of "
            "the image; lower `lambda`"
        )
        yield Counted(int(empty.sum()), "image", text)


def describe(lifting: Lifting, image: int) -> str:
    """Say how far the solver got with an image."""
    estimate = lifting.estimate
    iterations = counted(estimate.iterations[image], "iteration")
    reached = f"{estimate.status[image].value} after {iterations}"
    if estimate.relative_gap is None:
        return reached
    gap = estimate.relative_gap[image]
    if np.isnan(gap):  # the exact loss, where nothing is proved
        return f"{reached}, the landmarks are off by {estimate.residual[image]:.2g} of their spread"
    return f"{reached}, relative gap {gap:.2g}"


def count_reasons(record: ResultSet) -> tuple[Counted, ...]:
    """Count the images with a shape that is not to be trusted, by reason."""
    items: dict[str, list[str]] = {}
    for item, reason in zip(record.items, record.columns.get(REASONS, ()), strict=False):
        if reason not in ("", NO_SHAPE):  # which has failed
            items.setdefault(reason, []).append(item)
    return tuple(
        Counted(len(of_reason), "image", reason, items=tuple(of_reason))
        for reason, of_reason in items.items()
    )


@dataclass
class Counts:
    """What adds up over the batches of a fit, for its end.

    judged and trusted images, and the expected errors in metres of these; images in which each
    landmark (p,) is an outlier, and seen; bodies, those that lie and those that are on their heads;
    images of unknown items of `leave_one_out`, and the first.
    """

    images: int = 0
    sequences: set[str] = field(default_factory=set)
    judged: int = 0
    trusted: int = 0
    errors: list[float] = field(default_factory=list)
    outliers: np.ndarray | int = 0  # type: ignore[type-arg]
    visible: np.ndarray | int = 0  # type: ignore[type-arg]
    bodies: int = 0
    lying: int = 0
    on_head: int = 0
    unknown: int = 0
    unknown_item: str = ""

    def add(self, images: LandmarkSet, record: ResultSet, setup: Setup) -> None:
        """Count a batch."""
        columns = record.columns
        self.images += len(images)
        self.sequences.update(images.sequences or ())
        if TRUSTED in columns:
            trusted = columns[TRUSTED].astype(bool)
            self.judged += len(images)
            self.trusted += int(trusted.sum())
            errors, metres = columns.get(EXPECTED_ERROR), columns.get(METRES_PER_UNIT)
            if errors is not None and metres is not None:
                in_metres = (errors * metres)[trusted]
                self.errors += in_metres[np.isfinite(in_metres)].tolist()
        if "inlier_probability" in columns:
            self.outliers = self.outliers + (columns["inlier_probability"] < OUTLIER).sum(axis=0)
            self.visible = self.visible + np.isfinite(columns["inlier_probability"]).sum(axis=0)
        bodies, lying, on_head = count_bodies(record)
        self.bodies, self.lying, self.on_head = (
            self.bodies + bodies,
            self.lying + lying,
            self.on_head + on_head,
        )
        if setup.config.leave_one_out is not None:
            items, known = find_items(images, setup.lifter)
            self.unknown += int((~known).sum())
            self.unknown_item = self.unknown_item or next(iter(items[~known].tolist()), "")


def count_bodies(record: ResultSet) -> tuple[int, int, int]:
    """Count bodies of people with both ends, those that lie, and those that are on their heads."""
    names = record.landmark_names
    columns = joint_columns(names) if is_of_people(names) else {}
    ends = [[columns[joint] for joint in joints if joint in columns][:2] for joints in ENDS]
    if not all(ends):
        return 0, 0, 0
    top, bottom = (record.shapes[:, :, end].mean(axis=2) for end in ends)
    body = (top - bottom)[np.isfinite(top - bottom).all(axis=1)]
    up = body[:, 1] * (1 if record.y_axis == "up" else -1)
    in_image = np.hypot(body[:, 0], body[:, 1])
    across = in_image > STEEP * np.linalg.norm(body, axis=1)
    on_head = across & (up < -STEEP * in_image)
    return len(body), int((across & (abs(up) < STEEP * in_image)).sum()), int(on_head.sum())


def warn_of_all(counts: Counts, setup: Setup, y_axis: str | None) -> tuple[str | Counted, ...]:
    """Return what is known at the end only, with shares of all images.

    Raises InputError where no image shows an item of the dictionary that is to be left out.
    """
    return (
        *warn_of_axes(counts, y_axis),
        *warn_of_landmarks(counts, setup),
        *warn_of_items(counts, setup),
    )


def warn_of_axes(counts: Counts, y_axis: str | None) -> Iterator[Counted]:
    """Warn where most bodies lie, or are on their heads."""
    turned = "is the video turned by {0} degrees"
    if 2 * counts.on_head > counts.bodies:
        other = "up" if y_axis == "down" else "down"
        causes = f"y was taken to point {y_axis}: if it points {other}, set `y_axis: {other}`; or "
        text = f"with people on their heads: {causes}{turned.format(180)}?"
        yield Counted(counts.on_head, "image", text)
    elif 2 * counts.lying > counts.bodies:
        text = f"with people who lie: if they stand, are x and y exchanged, or {turned.format(90)}?"
        yield Counted(counts.lying, "image", text)


def warn_of_landmarks(counts: Counts, setup: Setup) -> Iterator[Counted]:
    """Name landmarks that are outliers in most images."""
    markers, names = setup.matched.joints.markers, setup.dictionary.landmark_names
    for j in np.flatnonzero(counts.outliers > MOSTLY * np.maximum(counts.visible, FEWEST)):
        name = " and ".join(markers.get(names[j], (names[j],)))
        text = (
            f"in which {name} contradicts the model: rename it if it is another point of the body, "
            f"or leave it out with `rename={{{name}: unused}}`"
        )
        yield Counted(int(np.asarray(counts.outliers)[j]), "image", text)


def warn_of_items(counts: Counts, setup: Setup) -> Iterator[str]:
    """Say how many images show items of which the dictionary has no atoms."""
    if not counts.unknown:
        return
    found = (
        f"{counts.unknown} of {counts.images} images show items that are not in the "
        f"dictionary, the first '{counts.unknown_item}'"
    )
    if counts.unknown == counts.images:
        items = ", ".join(f"'{item}'" for item in (setup.dictionary.atom_items or ())[:3])
        fix = f"name the dataset that holds items of the dictionary, such as {items}"
        raise input_error(LEAVE_ONE_OUT, found, fix)
    yield f"{LEAVE_ONE_OUT}: {found}; they were fitted with all atoms"


def final_outcome(
    source: LandmarkSource,
    setup: Setup,
    counts: Counts,
    chosen: str,
    of_images: Sequence[str | Counted],
    writer: Summary,
    meshes: MeshWriter | None = None,
) -> Outcome:
    """Return the end of a fit: warnings about all images, a note, and the rows of the summary.

    chosen, a line about the method if nobody named one; of_images, see `warn_of_all`; writer, the
    summary of the writer.
    """
    config, head = setup.config, source.head
    warnings: list[str | Counted] = [*setup.estimates.warnings]
    warnings += [*nothing_in(source.count, "images"), *source.notes]
    warnings += setup.matched.warnings()
    warnings += warn_of_lens(head.further, setup.camera)
    warnings += warn_of_dictionary(config, setup.dictionary)
    if not output_format(config).points_only:
        names = free_names(head.further, OF_A_RESULT)
        stored = [f"{name} is stored as {new}" for name, new in names.items() if new != name]
        reason = "datasets of the landmarks have names that a result uses"
        warnings += [f"{reason}: {', '.join(stored)}"] if stored else []
    warnings += of_images
    warnings += meshes.warnings if meshes else ()
    of_writer = writer.warnings
    if METHODS[config.method].sequences and not (config.frame_rate or head.frame_rate):
        from shapefit.io.writers.motion import NO_RATE

        and_times = ", and times are numbers of frames" if NO_RATE in of_writer else ""
        warnings.append(
            "the frame rate is unknown, so the motion from image to image is taken for that of the "
            f"training shapes{and_times}; set `frame_rate`"
        )
        of_writer = tuple(text for text in of_writer if text != NO_RATE)
    taken = "" if source.states_y_axis else ", as no file says otherwise"
    matched = setup.matched.describe(head.landmark_names)
    lines = (chosen, f"y {head.y_axis} in the images{taken}", *setup.estimates.lines, matched)
    lines += (meshes.note,) if meshes else ()
    return Outcome(
        total=source.count,
        warnings=(*warnings, *of_writer),
        note="; ".join(filter(None, (*lines, writer.note))),
        rows=tuple(rows_of(setup, counts, chosen, matched, writer.note)),
        written=(
            *(writer.written or (Path(str(config.output)),)),
            *(meshes.written if meshes else ()),
        ),
    )


def rows_of(
    setup: Setup, counts: Counts, chosen: str, matched: str, metres: str
) -> Iterator[tuple[str, str]]:
    """Yield the rows of the summary, label and text."""
    config, output = setup.config, Path(str(setup.config.output))
    names = abbreviate([path.name or str(path) for path in config.landmarks], 1)
    sequences = f" of {counted(len(counts.sequences), 'sequence')}" if counts.sequences else ""
    read = f"{names}: {counted(counts.images, 'image')}{sequences}"
    yield "Read", f"{read}; {matched}" if matched else read
    yield "Method", chosen or config.method
    lines = setup.estimates.lines
    yield "Camera", lines[0].removeprefix("camera: ") if lines else "as given"
    if metres:
        yield "Metres", metres
    size = 100 * np.median(counts.errors) if counts.errors else np.nan
    about = f", expected error about {size:.0f} cm" if counts.errors else ""
    images = counted(counts.images, "image")
    no_bars = "no error bars by this method"
    if setup.dictionary.prior is None:
        no_bars = "no error bars: `learn-dict --prior` learns what they need"
    yield (
        "Result",
        (
            f"{counts.trusted} of {images} trusted{about}"
            if counts.judged
            else f"{images} ({no_bars})"
        ),
    )
    if output.suffix.lower() in VIEWED:
        name = output.name if output.parent == Path.cwd() else str(output)
        yield "Next", f"shapefit view {output.stem + '*.trc' if output.suffix == '.trc' else name}"
