"""What a fit says of its images: those without a shape, and what to look at."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from shapefit.arrays import Floats
from shapefit.convex.solver import Status
from shapefit.errors import counted, input_error
from shapefit.geometry.pinhole import Camera
from shapefit.io import LandmarkSet, ResultSet
from shapefit.io.skeletons import joint_columns
from shapefit.lifting.lift import Lifting
from shapefit.lifting.methods import METHODS
from shapefit.lifting.verdict import NO_SHAPE, REASONS
from shapefit.pipelines.fit.lift import LEAVE_ONE_OUT, find_items
from shapefit.pipelines.fit.prepare import Setup
from shapefit.pipelines.fit.sample import FEWEST, MOSTLY, OUTLIER
from shapefit.pipelines.joints import is_of_people
from shapefit.pipelines.outcome import Counted, Failure, Outcome

STEEP = 0.5
"""Cosine of the angle in the image to the vertical within which a body stands, or is on its head:
60 degrees. A body that is seen along its axis, less than this share of it, is neither."""

FAR_ASIDE = np.tan(np.radians(15.0))
"""Distance from the optical axis, in focal lengths, where few cameras see all that they see."""

ENDS = (("head", "neck", "lshoulder", "rshoulder"), ("lankle", "rankle", "lhip", "rhip"))
"""Joints at the upper and the lower end of a body: the first that there are."""


def outcome_of(
    images: LandmarkSet,
    lifting: Lifting,
    record: ResultSet,
    setup: Setup,
    total: int | None = None,
) -> Outcome:
    """Return the outcome of a batch, of `total` images."""
    return Outcome(
        done=len(images),
        total=total,
        failures=find_failures(images, lifting),
        warnings=find_warnings(images, lifting, setup),
        doubts=count_doubts(record),
    )


class Counts:
    """What adds up over the batches of a fit, for what can be said at the end only.

    outliers and seen (p,), images in which a landmark is one; bodies, that lie and are on their
    heads; unknown items of `leave_one_out`.
    """

    def __init__(self, setup: Setup) -> None:
        """Begin to count."""
        self.setup = setup
        self.images = self.bodies = self.lying = self.on_head = self.unknown_items = 0
        self.outliers, self.seen = np.zeros((2, len(setup.dictionary.landmark_names)), np.int64)
        self.unknown_item, self.y_axis = "", "down"
        names = setup.dictionary.landmark_names
        columns = joint_columns(names) if is_of_people(names) else {}
        there = ([columns[joint] for joint in ends if joint in columns] for ends in ENDS)
        self.top, self.bottom = (columns[:2] if len(columns) > 1 else columns for columns in there)

    def add(self, images: LandmarkSet, record: ResultSet) -> None:
        """Count a batch."""
        self.images += len(images)
        self.y_axis = record.y_axis
        inlier_probability = record.per_item.get("inlier_probability")
        if inlier_probability is not None:
            self.outliers += (inlier_probability < OUTLIER).sum(axis=0)
            self.seen += np.isfinite(inlier_probability).sum(axis=0)
        if self.top and self.bottom:
            ends = (record.shapes[:, :, each].mean(axis=2) for each in (self.top, self.bottom))
            top, bottom = ends
            body = (top - bottom)[np.isfinite(top - bottom).all(axis=1)]
            up = body[:, 1] * (1 if record.y_axis == "up" else -1)
            in_image = np.hypot(body[:, 0], body[:, 1])
            across = in_image > STEEP * np.linalg.norm(body, axis=1)
            self.bodies += len(body)
            self.on_head += int((across & (up < -STEEP * in_image)).sum())
            self.lying += int((across & (abs(up) < STEEP * in_image)).sum())
        if self.setup.config.leave_one_out is not None:
            items, known = find_items(images, self.setup.lifter)
            self.unknown_items += int((~known).sum())
            self.unknown_item = self.unknown_item or next(iter(items[~known].tolist()), "")


def warn_of_all(counts: Counts) -> tuple[str | Counted, ...]:
    """Return what is known at the end only, with shares of all images.

    Raises InputError where no image shows an item of the dictionary that is to be left out.
    """
    return (*warn_of_axes(counts), *warn_of_landmarks(counts), *warn_of_items(counts))


def warn_of_axes(counts: Counts) -> Iterator[Counted]:
    """Warn where most bodies lie, or are on their heads."""
    y, other = counts.y_axis, "up" if counts.y_axis == "down" else "down"
    turned = "is the video turned by {0} degrees"
    if 2 * counts.on_head > counts.bodies:
        causes = f"y was taken to point {y}: if it points {other}, set `y_axis: {other}`; or "
        text = f"with people on their heads: {causes}{turned.format(180)}?"
        yield Counted(counts.on_head, "image", text)
    elif 2 * counts.lying > counts.bodies:
        text = f"with people who lie: if they stand, are x and y exchanged, or {turned.format(90)}?"
        yield Counted(counts.lying, "image", text)


def warn_of_landmarks(counts: Counts) -> Iterator[Counted]:
    """Name landmarks that are outliers in most images."""
    markers, names = counts.setup.matched.joints.markers, counts.setup.dictionary.landmark_names
    for j in np.flatnonzero(counts.outliers > MOSTLY * np.maximum(counts.seen, FEWEST)):
        name = " and ".join(markers.get(names[j], (names[j],)))
        text = (
            f"in which {name} contradicts the model: rename it if it is another point of the body, "
            f"or leave it out with `rename={{{name}: unused}}`"
        )
        yield Counted(int(counts.outliers[j]), "image", text)


def warn_of_items(counts: Counts) -> Iterator[str]:
    """Say how many images show items of which the dictionary has no atoms."""
    if not counts.unknown_items:
        return
    found = (
        f"{counts.unknown_items} of {counts.images} images show items that are not in the "
        f"dictionary, the first '{counts.unknown_item}'"
    )
    if counts.unknown_items == counts.images:
        known = list(counts.setup.dictionary.atom_items or ())[:3]
        items = ", ".join(f"'{item}'" for item in known)
        fix = f"name the dataset that holds items of the dictionary, such as {items}"
        raise input_error(LEAVE_ONE_OUT, found, fix)
    yield f"{LEAVE_ONE_OUT}: {found}; they were fitted with all atoms"


def find_failures(images: LandmarkSet, lifting: Lifting) -> tuple[Failure, ...]:
    """List the items without a shape."""
    reasons = lifting.failures
    return tuple(Failure(images.items[image], reasons[image]) for image in sorted(reasons))


def find_warnings(images: LandmarkSet, lifting: Lifting, setup: Setup) -> tuple[str | Counted, ...]:
    """Count images that are not optimal or empty; warn of confidences, and of the camera."""
    found: list[str | Counted] = []
    config, gap, states = setup.config, lifting.estimate.relative_gap, lifting.estimate.status
    if Status.ITERATION_LIMIT in states:
        limited = [image for image, one in enumerate(states) if one is Status.ITERATION_LIMIT]
        worst = limited[0] if gap is None else max(limited, key=lambda image: gap[image])
        severity = 0.0 if gap is None or np.isnan(gap[worst]) else float(gap[worst])
        told = describe(lifting, worst)
        found.append(Counted(len(limited), "image", "not optimal", worst=told, severity=severity))
    weighted = not METHODS[config.method].precisions
    if weighted and images.confidence is not None and (images.confidence > 1).any():
        what = "they are weights, and larger ones count more against `lambda`"
        fix = "divide them by their largest value if that is not intended"
        found.append(f"confidences above 1: {what}; {fix}")
    empty = ~lifting.estimate.shapes.any(axis=(1, 2)) & np.isfinite(lifting.scale)
    empty[list(lifting.failures)] = False
    if empty.any():
        text = (
            "with an empty shape, all landmarks at one point: lambda is at or above lambda_max of "
            "the image; lower `lambda`"
        )
        found.append(Counted(int(empty.sum()), "image", text))
    if lifting.perspective and all_aside(images.landmarks, lifting.perspective.camera):
        found.append(
            "all landmarks are far to one side of the optical axis; is "
            "`camera.principal_point` right?"
        )
    return tuple(found)


def all_aside(landmarks: Floats, camera: Camera) -> bool:
    """Whether all landmarks (n, 2, p) lie to one side of the optical axis, in x and in y, and far.

    So they do where the principal point is wrong, as 0, 0 is for pixels counted from a corner.
    """
    seen = np.isfinite(landmarks).all(axis=1)
    if not seen.any():
        return False
    tangents = (landmarks - camera.centre[..., None]) / camera.focal[..., None]
    of_seen = np.moveaxis(tangents, 1, 0)[:, seen]  # (2, landmarks)
    one_sided = (of_seen > 0).all(axis=1) | (of_seen < 0).all(axis=1)
    far = np.hypot(*of_seen) > FAR_ASIDE
    return bool(one_sided.all() and far.all())


def count_doubts(record: ResultSet) -> tuple[Counted, ...]:
    """Count the images with a shape that is not to be trusted, by reason."""
    of_reason: dict[str, list[str]] = {}
    for item, reason in zip(record.items, record.columns.get(REASONS, ()), strict=False):
        if reason not in ("", NO_SHAPE):  # which has failed
            of_reason.setdefault(reason, []).append(item)
    return tuple(
        Counted(len(items), "image", reason, items=tuple(items))
        for reason, items in of_reason.items()
    )


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
