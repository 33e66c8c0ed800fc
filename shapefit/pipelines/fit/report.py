"""What a fit reports: images without a shape, what to look at, and a summary in a few rows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from shapefit.convex.solver import Status
from shapefit.errors import abbreviate, counted
from shapefit.io import LandmarkSet, LandmarkSource, ResultSet
from shapefit.io.layout import METRES_PER_UNIT
from shapefit.io.options import Summary
from shapefit.io.skeletons import joint_columns
from shapefit.lifting.lift import Lifting
from shapefit.lifting.trust import EXPECTED_ERROR, NO_SHAPE, REASONS, TRUSTED
from shapefit.pipelines.fit.prepare import Setup, warn_of_dictionary
from shapefit.pipelines.fit.sample import FEWEST, MOSTLY, OUTLIER
from shapefit.pipelines.joints import is_of_people
from shapefit.pipelines.result import Counted, Failure, Result, nothing_in

STEEP = 0.5
"""Cosine of the angle to the vertical of the image within which a body is on its head."""

ENDS = (("head", "neck", "lshoulder", "rshoulder"), ("lankle", "rankle", "lhip", "rhip"))
"""Joints at the upper and the lower end of a body: the first two that it has."""

VIEWED = (".h5", ".hdf5", ".hdf", ".he5", ".csv", ".trc")
"""Endings of results that `shapefit view` shows."""


class Batch(NamedTuple):
    """Images with their lifting and record."""

    images: LandmarkSet
    lifting: Lifting
    record: ResultSet


def result_of(batch: Batch, setup: Setup, total: int | None = None) -> Result:
    """Return the result of a batch, of `total` images."""
    items, failures = batch.images.items, sorted(batch.lifting.failures.items())
    by_reason: dict[str, list[str]] = {}
    for item, reason in zip(items, batch.record.columns.get(REASONS, ()), strict=False):
        if reason not in ("", NO_SHAPE):  # which has failed
            by_reason.setdefault(reason, []).append(item)
    return Result(
        done=len(items),
        total=total,
        failures=tuple(Failure(items[image], reason) for image, reason in failures),
        warnings=tuple(warn_of_batch(batch, setup)),
        reasons=tuple(Counted(len(of), "image", why, tuple(of)) for why, of in by_reason.items()),
    )


def warn_of_batch(batch: Batch, setup: Setup) -> Iterator[str | Counted]:
    """Count images that are not optimal or empty; warn of confidences that are no shares."""
    images, lifting = batch.images, batch.lifting
    limited = lifting.estimate.status.count(Status.ITERATION_LIMIT)
    if limited:
        yield Counted(limited, "image", "not optimal")
    if not setup.lifter.row.precisions and np.any(images.weights() > 1):
        yield "confidences above 1 count more against `lambda`: divide them by their largest value"
    empty = ~lifting.estimate.shapes.any(axis=(1, 2)) & np.isfinite(lifting.scale)
    empty[list(lifting.failures)] = False
    if empty.any():
        text = "with an empty shape: lambda is at or above lambda_max of the image; lower `lambda`"
        yield Counted(int(empty.sum()), "image", text)


@dataclass
class Counts:
    """What adds up over the batches of a fit, for its end.

    errors are those expected, in metres; outliers and visible (p,) count images.
    """

    images: int = 0
    sequences: set[str] = field(default_factory=set)
    evaluated: int = 0
    trusted: int = 0
    errors: list[float] = field(default_factory=list)
    outliers: Any = 0
    visible: Any = 0
    bodies: int = 0
    on_head: int = 0

    def add(self, record: ResultSet) -> None:
        """Count a batch."""
        columns = record.columns
        self.images += len(record)
        self.sequences.update(record.sequences or ())
        if TRUSTED in columns:
            trusted = columns[TRUSTED].astype(bool)
            self.evaluated += len(record)
            self.trusted += int(trusted.sum())
            errors = columns[EXPECTED_ERROR] * columns.get(METRES_PER_UNIT, np.nan)
            self.errors += errors[trusted & np.isfinite(errors)].tolist()
        if "inlier_probability" in columns:
            self.outliers = self.outliers + (columns["inlier_probability"] < OUTLIER).sum(axis=0)
            self.visible = self.visible + np.isfinite(columns["inlier_probability"]).sum(axis=0)
        names = record.landmark_names
        joints = joint_columns(names) if is_of_people(names) else {}
        ends = [[joints[joint] for joint in end if joint in joints][:2] for end in ENDS]
        if all(ends):
            top, bottom = (record.shapes[:, :, end].mean(axis=2) for end in ends)
            body = (top - bottom)[np.isfinite(top - bottom).all(axis=1)]
            down = body[:, 1] * (-1 if record.y_axis == "up" else 1)
            self.bodies += len(body)
            self.on_head += int((down > STEEP * np.linalg.norm(body, axis=1)).sum())


def warn_of_all(counts: Counts, setup: Setup, y_axis: str | None) -> Iterator[str | Counted]:
    """Yield what is known at the end only, by shares of all images."""
    if 2 * counts.on_head > counts.bodies:
        other = "up" if y_axis == "down" else "down"
        text = f"with people on their heads: y was taken to point {y_axis}: if it points {other}, "
        text += f"set `y_axis: {other}`; or is the video turned by 180 degrees?"
        yield Counted(counts.on_head, "image", text)
    markers, names = setup.matched.joints.markers, setup.dictionary.landmark_names
    for j in np.flatnonzero(counts.outliers > MOSTLY * np.maximum(counts.visible, FEWEST)):
        name = " and ".join(markers.get(names[j], (names[j],)))
        text = f"in which {name} contradicts the model: rename it if it is another point of the "
        text += f"body, or leave it out with `rename={{{name}: unused}}`"
        yield Counted(int(counts.outliers[j]), "image", text)


def summary_of(
    source: LandmarkSource, setup: Setup, counts: Counts, method: str, writer: Summary
) -> Result:
    """Return the end of a fit: warnings about all images, a note, and the rows of the summary."""
    config, head = setup.config, source.head
    warnings: list[str | Counted] = [*setup.estimates.warnings]
    warnings += [*nothing_in(source.count, "images"), *source.notes, *setup.matched.warnings()]
    warnings += [*warn_of_dictionary(config, setup.dictionary)]
    warnings += warn_of_all(counts, setup, head.y_axis)
    if setup.lifter.row.sequences and not (config.frame_rate or head.frame_rate):
        warnings.append(
            "the frame rate is unknown, so the motion from image to image is taken for that of the "
            "training shapes; set `frame_rate`"
        )
    return Result(
        total=source.count,
        warnings=(*warnings, *writer.warnings),
        note="; ".join([f"y {head.y_axis} in the images", *setup.estimates.lines]),
        rows=tuple(rows_of(source, setup, counts, method or config.method, writer.note)),
        written=writer.written or (Path(str(config.output)),),
    )


def rows_of(
    source: LandmarkSource, setup: Setup, counts: Counts, method: str, metres: str
) -> Iterator[tuple[str, str]]:
    """Yield the rows of the summary, label and text."""
    config, output = setup.config, Path(str(setup.config.output))
    images = counted(counts.images, "image")
    read = f"{abbreviate([path.name or str(path) for path in config.landmarks], 1)}: {images}"
    read += f" of {counted(len(counts.sequences), 'sequence')}" if counts.sequences else ""
    if matched := sum(map(len, setup.matched.joints.markers.values())):
        read += f"; matched {matched} of {len(source.head.landmark_names)} keypoints"
    yield "Read", read
    yield "Method", method
    yield "Camera", setup.estimates.lines[0].removeprefix("camera: ")
    if metres:
        yield "Metres", metres
    result = f"{images} (no error bars by this method)"
    if counts.evaluated:
        size = f"{100 * np.median(counts.errors):.0f} cm" if counts.errors else ""
        about = f", expected error about {size}" if size else ""
        result = f"{counts.trusted} of {images} trusted{about}"
    elif setup.dictionary.prior is None:
        result = f"{images} (no error bars: `learn-dict --prior` learns what they need)"
    yield "Result", result
    if output.suffix.lower() in VIEWED:
        name = output.name if output.parent == Path.cwd() else str(output)
        yield "Next", f"shapefit view {output.stem + '*.trc' if output.suffix == '.trc' else name}"
