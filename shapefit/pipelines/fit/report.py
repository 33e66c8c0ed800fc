"""What a fit reports: images without a shape, what to look at, and a summary in a few rows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from shapefit.convex.solver import Status
from shapefit.errors import abbreviate, counted, input_error
from shapefit.io import LandmarkSet, LandmarkSource, ResultSet
from shapefit.io.layout import METRES_PER_UNIT, free_names
from shapefit.io.options import Summary
from shapefit.io.skeletons import joint_columns
from shapefit.lifting.lift import Lifting
from shapefit.lifting.methods import METHODS
from shapefit.lifting.trust import EXPECTED_ERROR, NO_SHAPE, REASONS, TRUSTED
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
    by_reason: dict[str, list[str]] = {}
    for item, reason in zip(record.items, record.columns.get(REASONS, ()), strict=False):
        if reason not in ("", NO_SHAPE):  # which has failed
            by_reason.setdefault(reason, []).append(item)
    failures = lifting.failures
    return Outcome(
        done=len(images),
        total=total,
        failures=tuple(Failure(images.items[image], failures[image]) for image in sorted(failures)),
        warnings=tuple(warn_of_batch(images, lifting, setup)),
        reasons=tuple(
            Counted(len(items), "image", reason, items=tuple(items))
            for reason, items in by_reason.items()
        ),
    )


def warn_of_batch(images: LandmarkSet, lifting: Lifting, setup: Setup) -> Iterator[str | Counted]:
    """Count images that are not optimal or empty; warn of confidences."""
    estimate, gap = lifting.estimate, lifting.estimate.relative_gap
    limited = [i for i, status in enumerate(estimate.status) if status is Status.ITERATION_LIMIT]
    if limited:
        gaps = np.nan_to_num(np.zeros(len(images)) if gap is None else gap)
        worst = max(limited, key=lambda image: gaps[image])
        example = f"{estimate.status[worst].value} after "
        example += counted(estimate.iterations[worst], "iteration")
        if gap is not None and np.isfinite(gap[worst]):  # not with the exact loss
            example += f", relative gap {gap[worst]:.2g}"
        severity = float(gaps[worst])
        yield Counted(len(limited), "image", "not optimal", worst=example, severity=severity)
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


@dataclass
class Counts:
    """What adds up over the batches of a fit, for its end.

    evaluated and trusted images, and the expected errors in metres of these; images in which each
    landmark (p,) is an outlier, and visible; bodies (3,): all with both ends, those that lie, those
    on their heads; images of unknown items of `leave_one_out`, and the first.
    """

    images: int = 0
    sequences: set[str] = field(default_factory=set)
    evaluated: int = 0
    trusted: int = 0
    errors: list[float] = field(default_factory=list)
    outliers: Any = 0
    visible: Any = 0
    bodies: Any = 0
    unknown: int = 0
    unknown_item: str = ""

    def add(self, images: LandmarkSet, record: ResultSet, setup: Setup) -> None:
        """Count a batch."""
        columns = record.columns
        self.images += len(images)
        self.sequences.update(images.sequences or ())
        if TRUSTED in columns:
            trusted = columns[TRUSTED].astype(bool)
            self.evaluated += len(images)
            self.trusted += int(trusted.sum())
            errors, metres = columns.get(EXPECTED_ERROR), columns.get(METRES_PER_UNIT)
            if errors is not None and metres is not None:
                in_metres = (errors * metres)[trusted]
                self.errors += in_metres[np.isfinite(in_metres)].tolist()
        if "inlier_probability" in columns:
            self.outliers = self.outliers + (columns["inlier_probability"] < OUTLIER).sum(axis=0)
            self.visible = self.visible + np.isfinite(columns["inlier_probability"]).sum(axis=0)
        self.bodies = self.bodies + count_bodies(record)
        if setup.config.leave_one_out is not None:
            items, known = find_items(images, setup.lifter)
            self.unknown += int((~known).sum())
            self.unknown_item = self.unknown_item or next(iter(items[~known].tolist()), "")


def count_bodies(record: ResultSet) -> np.ndarray[Any, np.dtype[np.intp]]:
    """Count (3,) bodies of people with both ends, those that lie, and those on their heads."""
    names = record.landmark_names
    columns = joint_columns(names) if is_of_people(names) else {}
    ends = [[columns[joint] for joint in joints if joint in columns][:2] for joints in ENDS]
    if not all(ends):
        return np.zeros(3, np.intp)
    top, bottom = (record.shapes[:, :, end].mean(axis=2) for end in ends)
    body = (top - bottom)[np.isfinite(top - bottom).all(axis=1)]
    up = body[:, 1] * (1 if record.y_axis == "up" else -1)
    in_image = np.hypot(body[:, 0], body[:, 1])
    across = in_image > STEEP * np.linalg.norm(body, axis=1)
    lying = across & (abs(up) < STEEP * in_image)
    return np.array([len(body), lying.sum(), (across & (up < -STEEP * in_image)).sum()])


def warn_of_all(counts: Counts, setup: Setup, y_axis: str | None) -> Iterator[str | Counted]:
    """Yield what is known at the end only, by shares of all images.

    Raises InputError where no image shows an item of the dictionary that is to be left out.
    """
    bodies, lying, on_head = np.broadcast_to(counts.bodies, 3).tolist()
    turned = "is the video turned by {0} degrees"
    if 2 * on_head > bodies:
        other = "up" if y_axis == "down" else "down"
        causes = f"y was taken to point {y_axis}: if it points {other}, set `y_axis: {other}`; or "
        text = f"with people on their heads: {causes}{turned.format(180)}?"
        yield Counted(on_head, "image", text)
    elif 2 * lying > bodies:
        text = f"with people who lie: if they stand, are x and y exchanged, or {turned.format(90)}?"
        yield Counted(lying, "image", text)
    markers, names = setup.matched.joints.markers, setup.dictionary.landmark_names
    for j in np.flatnonzero(counts.outliers > MOSTLY * np.maximum(counts.visible, FEWEST)):
        name = " and ".join(markers.get(names[j], (names[j],)))
        text = (
            f"in which {name} contradicts the model: rename it if it is another point of the body, "
            f"or leave it out with `rename={{{name}: unused}}`"
        )
        yield Counted(int(counts.outliers[j]), "image", text)
    if counts.unknown:
        found = f"{counts.unknown} of {counts.images} images show items that are not in the "
        found += f"dictionary, the first '{counts.unknown_item}'"
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
    warnings += [*nothing_in(source.count, "images"), *source.notes, *setup.matched.warnings()]
    warnings += warn_of_lens(head.further, setup.camera)
    warnings += warn_of_dictionary(config, setup.dictionary)
    if not output_format(config).points_only:
        names = free_names(head.further, OF_A_RESULT)
        stored = [f"{name} is stored as {new}" for name, new in names.items() if new != name]
        reason = "datasets of the landmarks have names that a result uses"
        warnings += [f"{reason}: {', '.join(stored)}"] if stored else []
    warnings += of_images
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
    written, note = writer.written or (Path(str(config.output)),), writer.note
    if meshes is not None:
        warnings += meshes.warnings
        lines, written = (*lines, meshes.note), (*written, *meshes.written)
    return Outcome(
        total=source.count,
        warnings=(*warnings, *of_writer),
        note="; ".join(filter(None, (*lines, note))),
        rows=tuple(rows_of(setup, counts, chosen or config.method, matched, note)),
        written=written,
    )


def rows_of(
    setup: Setup, counts: Counts, method: str, matched: str, metres: str
) -> Iterator[tuple[str, str]]:
    """Yield the rows of the summary, label and text."""
    config, output = setup.config, Path(str(setup.config.output))
    names = abbreviate([path.name or str(path) for path in config.landmarks], 1)
    sequences = f" of {counted(len(counts.sequences), 'sequence')}" if counts.sequences else ""
    images = counted(counts.images, "image")
    yield "Read", f"{names}: {images}{sequences}" + (f"; {matched}" if matched else "")
    yield "Method", method
    lines: Sequence[str] = setup.estimates.lines or ("as given",)
    yield "Camera", lines[0].removeprefix("camera: ")
    if metres:
        yield "Metres", metres
    if counts.evaluated:
        size = 100 * np.median(counts.errors) if counts.errors else np.nan
        about = f", expected error about {size:.0f} cm" if counts.errors else ""
        yield "Result", f"{counts.trusted} of {images} trusted{about}"
    elif setup.dictionary.prior is None:
        yield (
            "Result",
            f"{images} (no error bars: `learn-dict --prior` learns what they need)",
        )
    else:
        yield "Result", f"{images} (no error bars by this method)"
    if output.suffix.lower() in VIEWED:
        name = output.name if output.parent == Path.cwd() else str(output)
        yield "Next", f"shapefit view {output.stem + '*.trc' if output.suffix == '.trc' else name}"
