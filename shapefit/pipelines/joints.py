"""Landmarks of detectors of people beside the joints of a dictionary: y = A(theta) x.

Landmark y_j of a detector stands for joint j, and lies where A says; joints that no
landmark stands for are their own. The fit works on y, whose prior is that of x seen
through A; its joints, and all landmarks of the detector, are then rows of weights of
its result.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from shapefit.arrays import Flags, Floats
from shapefit.dictionary.model import WHERE_MARKED, Dictionary, map_landmarks
from shapefit.errors import abbreviate, counted, input_error
from shapefit.io.arrange import arrange
from shapefit.io.names import check_numbering, numbers_of, rename_landmarks
from shapefit.io.skeletons import PEOPLE, THETA, BodyPart, people_joints, people_parts
from shapefit.lifting.derived_landmarks import (
    as_joints,
    combine_landmarks,
    place_dependents,
)
from shapefit.lifting.estimate import PosteriorEstimate
from shapefit.lifting.lift import Lifting
from shapefit.records import Landmarks
from shapefit.records.columns import Singles

MEANS: Mapping[str, float] = {name: parameter.mean for name, parameter in THETA.items()}
"""Usual parameters of a detector's skeleton."""

MIN_SHARED_LANDMARKS = 3
"""That a file must have in common with a dictionary."""

MIN_JOINTS_OF_PEOPLE = 6
"""By which people are recognised."""

PEOPLE_ALONE = {f"{side}{joint}" for side in "lr" for joint in ("wrist", "ankle")}
"""Joints that people have, and hardly any tracked animal."""


def match_names(
    names: Sequence[str], dictionary: Dictionary, place: str, *, in_place: bool = True
) -> LandmarkMatch:
    """Match the landmarks of files to those of a dictionary, by their names.

    Raises InputError at `place` where fewer than three are in both, unless all are.
    in_place as in `LandmarkMatch`.
    """
    whole = dictionary
    doubts = check_numbering(names, dictionary.landmark_names, place, "the dictionary")
    joints = find_joints(names, dictionary.landmark_names, in_place=in_place)
    if WHERE_MARKED in dictionary.provenance:
        dictionary = dictionary.drop_unmarked({*names, *joints.markers})
        joints = joints.restrict_to(dictionary.landmark_names)
    listed = dictionary.landmark_names
    unknown = [name for name in names if joints.names.get(name, name) not in listed]
    matching = len(names) - len(unknown)
    if unknown and matching < MIN_SHARED_LANDMARKS:
        verb = "are" if matching > 1 else "is"
        fault = (
            f"{matching or 'none'} of the {counted(len(names), 'landmark')} {verb} in"
            f" the dictionary, at least {MIN_SHARED_LANDMARKS} must be (files:"
            f" {abbreviate(names, 10)}; dictionary: {abbreviate(listed, 10)})"
        )
        fix = (
            "give a dictionary of such objects, which `shapefit learn-dict` learns, or"
            " name landmarks alike: `rename: {FILE: DICTIONARY}`"
        )
        if numbers_of(names):
            fix += ", or numbered ones by `--keypoints`"
        raise input_error(place, fault, fix)
    return LandmarkMatch(dictionary, joints, unknown, in_place, whole, doubts)


class DetectorShapes(NamedTuple):
    """The landmarks of a detector in 3D, for n images.

    names (i,), shapes and standard deviations sd (n, i, 3) in the unit of the
    landmarks, correlation (n, i, 3) of x with y, x with z, y with z.
    """

    names: tuple[str, ...]
    shapes: Floats
    sd: Floats | None = None
    correlation: Singles | None = None


class LandmarkMatch(NamedTuple):
    """Landmarks of files, matched to the joints of a dictionary.

    dictionary is without landmarks that the files do not mark. unknown landmarks are
    left out. in_place: they lie where A says, else at their joints. whole is the
    dictionary as it was read. doubts are warnings about their numbers.
    """

    dictionary: Dictionary
    joints: Joints
    unknown: Sequence[str]
    in_place: bool
    whole: Dictionary
    doubts: tuple[str, ...] = ()

    @property
    def has_displaced(self) -> bool:
        """Whether a landmark of the files stands for a joint but lies elsewhere."""
        return self.in_place and bool(self.joints.markers)

    @property
    def has_dependents(self) -> bool:
        """Whether landmarks depend on others, as heels do on ankles."""
        return self.in_place and bool(self.dictionary.provenance.get(WHERE_MARKED))

    def arrange(self, images: Landmarks, place: str) -> Landmarks:
        """Return images with the landmarks of the dictionary, in its order.

        Raises InputError at `place`, the file of the images, as `rename_to_joints`.
        """
        named = rename_to_joints(images, self.joints, place)
        names = self.dictionary.landmark_names
        return arrange(named, names, place, omit=bool(self.unknown))

    def warnings(self) -> tuple[str, ...]:
        """Return warnings about doubtful numbers of landmarks, and those left out.

        The few of a known skeleton that are no joints, such as eyes, are expected.
        """
        expected = len(self.unknown) <= len(self.joints.names)
        if expected or not self.unknown:
            return self.doubts
        fault = (
            f"{counted(len(self.unknown), 'landmark')} left out, which the dictionary"
            " lacks"
        )
        return (*self.doubts, f"{fault} ({abbreviate(self.unknown)})")

    def detector_dictionary(self, theta: Mapping[str, float]) -> Dictionary:
        """Return the dictionary of detector landmarks y, at body proportions theta."""
        if not (self.has_displaced or self.has_dependents):
            return self.dictionary
        return map_landmarks(
            self.dictionary, self.joints.to_landmarks(theta), self.joints.deviations()
        )

    def to_joints(
        self,
        lifting: Lifting[PosteriorEstimate],
        theta: Mapping[str, float],
        landmarks: Floats,
        visible: Flags,
        residual_variance: float,
    ) -> tuple[Lifting[PosteriorEstimate], DetectorShapes | None]:
        """Convert a lifting of landmarks to one of joints; return it and the landmarks.

        These are all landmarks of the files in 3D, None where they are the joints.
        landmarks (n, 2, p), visible (n, p).
        """
        if self.has_dependents:
            on = self.dictionary.depends_on
            lifting = place_dependents(
                lifting, landmarks, visible, on, residual_variance
            )
        elif not self.has_displaced:
            return lifting, None
        A = self.joints.to_landmarks(theta)
        joints = as_joints(lifting, A)
        names = tuple(self.joints.parts)
        if not names:
            return joints, None
        rows = self.joints.weights(names, theta) @ np.linalg.inv(A)
        std = np.array([self.joints.deviation_of(name) for name in names])
        points = combine_landmarks(
            rows, lifting.shapes, lifting.estimate.covariance, std
        )
        detected = DetectorShapes(names, points.points.swapaxes(1, 2))
        if points.deviation is not None and points.correlation is not None:
            sd = lifting.scale[:, None, None] * points.deviation
            correlation = points.correlation.swapaxes(1, 2).astype(np.float32)
            detected = detected._replace(sd=sd.swapaxes(1, 2), correlation=correlation)
        return joints, detected


class Joints(NamedTuple):
    """Landmarks of files that stand for joints of a dictionary, and where they lie.

    joint_names (p), of the dictionary; parts maps a landmark of the files to its place
    among the joints; markers maps a joint to the landmarks that stand for it.
    """

    joint_names: tuple[str, ...]
    parts: Mapping[str, BodyPart]
    markers: Mapping[str, tuple[str, ...]]

    @property
    def names(self) -> dict[str, str]:
        """Return landmark of the files -> joint of the dictionary that replaces it."""
        return {landmarks[0]: joint for joint, landmarks in self.markers.items()}

    @property
    def parameters(self) -> tuple[str, ...]:
        """Return the names of the body proportions that move landmarks of the files."""
        markers = (name for several in self.markers.values() for name in several)
        used = {name for marker in markers for name in self.parts[marker].along}
        return tuple(name for name in THETA if name in used)

    def restrict_to(self, joints: Sequence[str]) -> Joints:
        """Keep only these joints, and the landmarks that follow from them alone."""
        parts = {n: p for n, p in self.parts.items() if p.joints <= set(joints)}
        return Joints(tuple(joints), parts, self.markers)

    def weights(self, landmarks: Sequence[str], theta: Mapping[str, float]) -> Floats:
        """Return the weights (m, p) of the p joints in each of m landmarks."""
        weights = np.zeros((len(landmarks), len(self.joint_names)))
        for row, name in enumerate(landmarks):
            for joint, weight in self.parts[name].weights(theta).items():
                weights[row, self.joint_names.index(joint)] = weight
        return weights

    def to_landmarks(self, theta: Mapping[str, float]) -> Floats:
        """Return A (p, p) in y = A x: landmarks y from joints x, at proportions theta.

        Its row is that of the identity where no landmark stands for a joint.
        """
        A = np.eye(len(self.joint_names))
        for joint, landmarks in self.markers.items():
            A[self.joint_names.index(joint)] = self.weights(landmarks, theta).mean(
                axis=0
            )
        return A

    def deviation_of(self, landmark: str) -> float:
        """Return the standard deviation of a landmark from its weighted sum of joints.

        It is 0 where the landmark stands for a joint, and so is lifted itself.
        """
        for several in self.markers.values():
            if landmark in several:
                return 0.0
        return self.parts[landmark].std

    def deviations(self) -> Floats:
        """Return the standard deviations (p,) of y from A x, see `to_landmarks`.

        They are 0 for joints for which no landmark stands.
        """
        std = {
            joint: self.parts[landmarks[0]].std
            for joint, landmarks in self.markers.items()
        }
        return np.array([std.get(joint, 0.0) for joint in self.joint_names])


def find_joints(
    names: Sequence[str], joints: Sequence[str], *, in_place: bool = True
) -> Joints:
    """Return which landmarks of files stand for joints that the files lack.

    Without `in_place` they lie at the joints. Of several those stand for a joint that
    deviate least, such as the top of the head in place of ears, together if they are
    pairs, and none if they are alike.
    """
    parts = {}
    for name, part in people_parts(
        [name for name in names if name not in joints]
    ).items():
        if part.joints <= set(joints) and (in_place or (part.alone and part.joint)):
            at_joint = {part.joint: 1.0} if part.joint else {}
            parts[name] = part if in_place else BodyPart(part.joint, at_joint)
    markers: dict[str, tuple[str, ...]] = {}
    for joint in joints:
        meant = [
            name
            for name, part in parts.items()
            if part.joint == joint and joint not in names
        ]
        least = min((parts[name].std for name in meant), default=0.0)
        nearest = tuple(name for name in meant if parts[name].std == least)
        if nearest and (
            len(nearest) == 1 or not any(parts[name].alone for name in nearest)
        ):
            markers[joint] = nearest
    return Joints(tuple(joints), parts, markers)


def rename_to_joints(images: Landmarks, joints: Joints, place: str) -> Landmarks:
    """Rename landmarks to the joints they stand for; average several of one joint.

    Raises InputError at `place` as `rename_landmarks`.
    """
    landmarks = images.landmarks
    confidence = images.confidence
    weights = images.weights()
    for several in (several for several in joints.markers.values() if len(several) > 1):
        columns = [images.landmark_names.index(name) for name in several]
        visible: Flags = np.asarray(weights[:, columns] > 0)
        count = np.maximum(visible.sum(axis=1), 1)
        shown = np.where(visible[..., None], landmarks[:, columns], 0.0)
        mean = shown.sum(axis=1) / count[:, None]
        landmarks = landmarks.copy()
        landmarks[:, columns[0]] = np.where(
            visible.any(axis=1, keepdims=True), mean, np.nan
        )
        if confidence is not None:
            confidence = confidence.copy()
            confidence[:, columns[0]] = weights[:, columns].sum(axis=1) / count
    names = rename_landmarks(images.landmark_names, joints.names, place)
    return replace(
        images, landmarks=landmarks, confidence=confidence, landmark_names=names
    )


def is_of_people(names: Sequence[str]) -> bool:
    """Whether landmarks are joints of people, by their names."""
    joints = set(names) & set(PEOPLE) | {*people_joints(names).values()}
    return len(joints) >= MIN_JOINTS_OF_PEOPLE and bool(joints & PEOPLE_ALONE)
