"""What a fit says of its images: those without a shape, and what to look at."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from shapefit.arrays import Floats
from shapefit.convex.solver import Status
from shapefit.errors import counted, input_error
from shapefit.geometry.pinhole import Camera
from shapefit.io import LandmarkSet, ResultSet
from shapefit.io.skeletons import PEOPLE, people_joints
from shapefit.lifting.lift import Lifting
from shapefit.lifting.methods import METHODS
from shapefit.lifting.verdict import MIN_P_VALUE, NO_SHAPE, P_VALUE, REASONS
from shapefit.pipelines.fit.checks import FEWEST, MOSTLY, find_cause
from shapefit.pipelines.fit.lift import LEAVE_OUT, find_items
from shapefit.pipelines.fit.prepare import Setup
from shapefit.pipelines.outcome import Counted, Failure, Outcome

STEEP = 0.5
"""Cosine of the angle to the vertical within which a body stands, or is on its head: 60 degrees."""

FAR_ASIDE = np.tan(np.radians(15.0))
"""Distance from the optical axis, in focal lengths, where few cameras see all that they see."""


class Report:
    """Says of each batch what failed and what is doubtful, and counts for the end what adds up."""

    def __init__(self, setup: Setup, *, explained: bool = False) -> None:
        """Count for a fit; `explained` where it was said before what is wrong with its images."""
        self.done = 0
        self._explained = explained
        self._sample: LandmarkSet | None = None
        self._gross, self._seen = np.zeros((2, len(setup.dictionary.landmark_names)), np.int64)
        self._implausible = self._judged = 0
        self._setup = setup
        names = setup.dictionary.landmark_names
        joints = people_joints(names) | {name: name for name in names if name in PEOPLE}
        place = {joint: names.index(name) for name, joint in joints.items()}
        ends = [place.get(joint) for joint in ("head", "lankle", "rankle")]
        self._ends = [end for end in ends if end is not None]
        self._y_axis = "down"
        self._bodies = self._on_head = 0
        self._unknown_items = 0
        self._unknown_item = ""

    def add(
        self, images: LandmarkSet, lifting: Lifting, record: ResultSet, total: int | None = None
    ) -> Outcome:
        """Return the outcome of a batch, of `total` images."""
        config = self._setup.config
        self.done += len(images)
        self._count_upright(record)
        self._count_beliefs(images, record)
        if config.leave_one_out is not None:
            items, known = find_items(images, config, self._setup.dictionary)
            self._unknown_items += int((~known).sum())
            self._unknown_item = self._unknown_item or next(iter(items[~known].tolist()), "")
        return Outcome(
            done=len(images),
            total=total,
            failures=find_failures(images, lifting),
            warnings=find_warnings(images, lifting, self._setup),
            doubts=count_doubts(record),
        )

    def _count_upright(self, record: ResultSet) -> None:
        """Count bodies, and those on their heads, by shapes in the camera frame."""
        if len(self._ends) < 3:
            return
        head, *ankles = np.moveaxis(record.shapes[:, :, self._ends], 2, 0)
        body = head - sum(ankles) / 2
        body = body[np.isfinite(body).all(axis=1)]
        up = body[:, 1] * (1 if record.y_axis == "up" else -1)
        self._bodies += len(body)
        self._on_head += int((up < -STEEP * np.linalg.norm(body, axis=1)).sum())
        self._y_axis = record.y_axis

    def _count_beliefs(self, images: LandmarkSet, record: ResultSet) -> None:
        """Count the images in which each landmark is gross, and those that are implausible."""
        inlier_probability, p_value = (
            record.columns.get(name) for name in ("inlier_probability", P_VALUE)
        )
        if inlier_probability is None or p_value is None:
            return
        self._sample = self._sample or images
        self._gross += (inlier_probability < MOSTLY).sum(axis=0)
        self._seen += np.isfinite(inlier_probability).sum(axis=0)
        self._implausible += int((p_value < MIN_P_VALUE).sum())
        self._judged += int(np.isfinite(p_value).sum())

    def _warn_of_landmarks(self) -> Iterator[str | Counted]:
        """Name landmarks that are gross in most images; else say why most are implausible."""
        markers = self._setup.joints.markers
        seen = np.maximum(self._seen, FEWEST)
        for j in np.flatnonzero(self._gross > MOSTLY * seen):
            joint = self._setup.dictionary.landmark_names[j]
            name = " and ".join(markers.get(joint, (joint,)))
            text = (
                f"in which {name} is grossly wrong: rename it if it is another point of the body, "
                f"or leave it out with `rename={{{name}: unused}}`"
            )
            yield Counted(int(self._gross[j]), "image", text)
        if self._implausible > MOSTLY * max(self._judged, FEWEST) and not self._explained:
            assert self._sample is not None, "some were judged"
            yield find_cause(self._sample, self._setup.seen, self._setup.config)

    @property
    def warnings(self) -> tuple[str | Counted, ...]:
        """What is known at the end only, with shares of all images.

        Raises InputError where no image shows an item of the dictionary that is left out.
        """
        found: list[str | Counted] = []
        if self._on_head > self._bodies / 2:
            y, other = self._y_axis, "up" if self._y_axis == "down" else "down"
            taken = f"y was taken to point {y}; if it points {other}, set `y_axis: {other}`"
            text = f"with people on their heads: {taken}"
            found.append(Counted(self._on_head, "image", text))
        if self._judged:
            found += self._warn_of_landmarks()
        if self._unknown_items:
            found.append(self._warn_of_items())
        return tuple(found)

    def _warn_of_items(self) -> str:
        found = (
            f"{self._unknown_items} of {self.done} images show items that are not in the "
            f"dictionary, the first '{self._unknown_item}'"
        )
        if self._unknown_items == self.done:
            known = list(self._setup.dictionary.atom_items or ())[:3]
            items = ", ".join(f"'{item}'" for item in known)
            fix = f"name the dataset that holds items of the dictionary, such as {items}"
            raise input_error(LEAVE_OUT, found, fix)
        return f"{LEAVE_OUT}: {found}; they were fitted with all atoms"


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
