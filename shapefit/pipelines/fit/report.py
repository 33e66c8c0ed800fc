"""What a fit says of its images: those without a shape, and what to look at."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from shapefit.convex.solution import Status
from shapefit.dictionary.model import Dictionary
from shapefit.errors import counted
from shapefit.io import LandmarkSet, LandmarkSource, ResultSet
from shapefit.io.skeletons import PEOPLE, people_joints
from shapefit.lifting.lift import Lifting
from shapefit.lifting.verdict import DOUBT, NO_SHAPE
from shapefit.pipelines.outcome import Counted, Failure, Outcome

if TYPE_CHECKING:
    from shapefit.pipelines.fit.left_out import UnknownItems


STEEP = 0.5
"""Cosine of the angle to the vertical within which a body stands, or is on its head: 60 degrees."""


@dataclass(frozen=True, kw_only=True)
class ReportOptions:
    """What counts as a failure, and what is worth a warning.

    strict        an image whose tolerance was not reached is a failure
    precisions    confidences divide standard deviations; else they are weights
    scores        or only say what was seen
    within        readings this share above the least objective were searched
    leave_out     dataset that names the item whose atoms are left out of an image
    """

    strict: bool = False
    precisions: bool = False
    scores: bool = False
    within: float = 0.0
    leave_out: str | None = None


class Standing:
    """Counts the images of a run whose bodies stand, and those whose bodies are on their heads."""

    def __init__(self, landmark_names: Sequence[str]) -> None:
        joints = people_joints(landmark_names) | {n: n for n in landmark_names if n in PEOPLE}
        place = {joint: landmark_names.index(name) for name, joint in joints.items()}
        ends = [place.get(joint) for joint in ("head", "lankle", "rankle")]
        self._ends = [end for end in ends if end is not None]
        self._images = self._on_head = 0
        self._y_axis = "down"

    def add(self, record: ResultSet) -> None:
        """Take the shapes of a chunk, in the camera frame."""
        if len(self._ends) < 3:
            return
        head, *ankles = np.moveaxis(record.shapes[:, :, self._ends], 2, 0)
        body = head - sum(ankles) / 2
        body = body[np.isfinite(body).all(axis=1)]
        up = body[:, 1] * (1 if record.y_axis == "up" else -1)
        self._images += len(body)
        self._on_head += int((up < -STEEP * np.linalg.norm(body, axis=1)).sum())
        self._y_axis = record.y_axis

    @property
    def warnings(self) -> tuple[Counted, ...]:
        """A warning where most bodies are on their heads."""
        if self._on_head <= self._images / 2:
            return ()
        other = "up" if self._y_axis == "down" else "down"
        taken = f"y was taken to point {self._y_axis}; if it points {other}, set `y_axis: {other}`"
        return (Counted(self._on_head, "image", f"with people on their heads: {taken}"),)


class Batch(NamedTuple):
    """Images with what was found, and the seconds that it took to lift them."""

    images: LandmarkSet
    lifting: Lifting
    record: ResultSet
    seconds: float


class Report:
    """Tells of each batch what failed and what is doubtful, and of all at the end."""

    def __init__(self, options: ReportOptions, dictionary: Dictionary) -> None:
        self._options = options
        self._standing = Standing(dictionary.landmark_names)
        self._unknown: UnknownItems | None = None
        if options.leave_out is not None:
            from shapefit.pipelines.fit.left_out import UnknownItems

            self._unknown = UnknownItems(options.leave_out, dictionary)
        self._images = self._several = self._unsure = 0

    def of(self, batch: Batch, total: int | None = None) -> Outcome:
        """Return the outcome of a batch, of `total` images."""
        images, lifting = batch.images, batch.lifting
        self._standing.add(batch.record)
        if self._unknown:
            self._unknown.add(images)
        readings = lifting.estimate.readings or ()
        self._images += sum(len(one) > 0 for one in readings)
        self._several += sum(len(one) > 1 for one in readings)
        self._unsure += sum(not one.complete and len(one) > 0 for one in readings)
        return Outcome(
            done=len(images),
            total=total,
            failures=find_failures(images, lifting, strict=self._options.strict),
            items=images.items,
            warnings=find_warnings(images, lifting, self._options),
            doubts=count_doubts(batch.record),
        )

    @property
    def warnings(self) -> tuple[str | Counted, ...]:
        """What is known at the end only, with shares of all images."""
        found: list[str | Counted] = [*self._standing.warnings]
        found += self._unknown.warnings if self._unknown else ()
        if self._several:
            share = self._several / self._images
            found.append(
                f"{counted(self._several, 'image')} ({share:.1%}) can be read in more than one "
                f"way: another rotation comes within {self._options.within:.0%} of the optimum; "
                "see `modes` in the result"
            )
        if self._unsure:
            found.append(
                f"{counted(self._unsure, 'image')} may have further readings: raise "
                "`search.max_cells` or `search.max_seconds`"
            )
        return tuple(found)


def said_of_y(source: LandmarkSource) -> str:
    """Say which way y was taken to point in the images."""
    taken = "" if source.states_y_axis else ", as no file says otherwise"
    return f"y {source.head.y_axis} in the images{taken}"


def find_failures(images: LandmarkSet, lifting: Lifting, *, strict: bool) -> tuple[Failure, ...]:
    """List the items without a shape and, where `strict`, those that are not optimal."""
    reasons = dict(lifting.failures)
    if strict:
        for image, status in enumerate(lifting.estimate.status):
            if status not in (Status.OPTIMAL, Status.CONVERGED):
                reasons.setdefault(image, describe(lifting, image))
    return tuple(Failure(images.items[image], reasons[image]) for image in sorted(reasons))


def find_warnings(
    images: LandmarkSet, lifting: Lifting, options: ReportOptions
) -> tuple[str | Counted, ...]:
    """Count images that stopped at the iteration limit, and warn where the camera looks wrong."""
    found: list[str | Counted] = []
    states = lifting.estimate.status
    if Status.ITERATION_LIMIT in states and not options.strict:
        limited = [image for image, one in enumerate(states) if one is Status.ITERATION_LIMIT]
        gap = lifting.estimate.relative_gap
        worst = limited[0] if gap is None else max(limited, key=lambda image: gap[image])
        found.append(
            Counted(
                len(limited),
                "image",
                "not optimal",
                worst=describe(lifting, worst),
                severity=0.0 if gap is None or np.isnan(gap[worst]) else float(gap[worst]),
            )
        )
    above = images.confidence is not None and bool((images.confidence > 1).any())
    if above and not options.scores:
        what = (
            "they make a landmark more precise than the model otherwise believes, whose standard "
            "deviations they divide"
            if options.precisions
            else "they are weights, and larger ones count more against `lambda`"
        )
        fix = "divide them by their largest value if that is not intended"
        found.append(f"confidences above 1: {what}; {fix}")
    empty = find_empty(lifting)
    if empty:
        text = (
            "with an empty shape, all landmarks at one point: lambda is at or above lambda_max of "
            "the image; lower `lambda`"
        )
        found.append(Counted(len(empty), "image", text))
    if lifting.perspective:
        from shapefit.pipelines.fit.camera import all_aside

        if all_aside(images.landmarks, lifting.perspective.camera):
            found.append(
                "all landmarks are far to one side of the optical axis; is "
                "`camera.principal_point` right?"
            )
    return tuple(found)


def count_doubts(record: ResultSet) -> tuple[Counted, ...]:
    """Count the images with a shape that is not to be trusted, by reason."""
    of_reason: dict[str, list[str]] = {}
    for item, reason in zip(record.items, record.columns.get(DOUBT, ()), strict=False):
        if reason not in ("", NO_SHAPE):  # which has failed
            of_reason.setdefault(reason, []).append(item)
    return tuple(
        Counted(len(items), "image", reason, items=tuple(items))
        for reason, items in of_reason.items()
    )


def find_empty(lifting: Lifting) -> list[int]:
    """List the images whose fitted shape is zero, and so has no rotation."""
    shapes = lifting.estimate.shapes
    zero = ~shapes.any(axis=(1, 2)) & np.isfinite(lifting.scale)
    return [image for image in np.flatnonzero(zero).tolist() if image not in lifting.failures]


def describe(lifting: Lifting, image: int) -> str:
    """Say how far an image got."""
    found = lifting.estimate
    reached = f"{found.status[image].value} after {counted(found.iterations[image], 'iteration')}"
    if found.relative_gap is None:
        return reached
    gap = found.relative_gap[image]
    if np.isnan(gap):  # the exact loss, where nothing is proved
        return f"{reached}, the landmarks are off by {found.residual[image]:.2g} of their spread"
    return f"{reached}, relative gap {gap:.2g}"
