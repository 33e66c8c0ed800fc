"""Landmarks of detectors of people beside the joints of a dictionary: y = A(theta) x.

Landmark y_j of a detector stands for joint j, and lies where A says; joints that no landmark stands
for are their own. The fit works on y, whose prior is that of x seen through A; its joints, and all
landmarks of the detector, are then rows of weights of its result.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Flags, Floats, Integers
from shapefit.dictionary.model import WHERE_MARKED, Dictionary, mapped
from shapefit.errors import abbreviate, counted, input_error
from shapefit.io import LandmarkSet
from shapefit.io.layout import INPUT_CORRELATION, INPUT_NAMES, INPUT_SD, INPUT_SHAPES
from shapefit.io.skeletons import PEOPLE, THETA, Part, people_joints, people_parts
from shapefit.lifting.derived_landmarks import as_joints, place_dependents, see_rows
from shapefit.lifting.lift import Lifting

MAP = "landmark_map"
"""Dataset of a result: A."""

MEANS: Mapping[str, float] = {name: parameter.mean for name, parameter in THETA.items()}

FEWEST_JOINTS = 6
"""Of people that landmarks are recognised by."""

PEOPLE_ALONE = {f"{side}{joint}" for side in "lr" for joint in ("wrist", "ankle")}
"""Joints that people have, and hardly any tracked animal."""

FEWEST_LANDMARKS = 3
"""Of a file that the dictionary must have, so that it can do without the others."""


@dataclass(frozen=True)
class Matched:
    """Landmarks of files beside those of a dictionary.

    dictionary  without what it has only where files mark it, and these do not
    joints      the landmarks that stand for its joints
    unknown     landmarks that a fit can do without
    """

    dictionary: Dictionary
    joints: Joints
    unknown: Sequence[str]

    def arrange(self, images: LandmarkSet, place: str) -> LandmarkSet:
        """Return images of these landmarks with those of the dictionary."""
        named = named_as_joints(images, self.joints, place)
        return named.arrange(self.dictionary.landmark_names, place, omit=bool(self.unknown))

    def warnings(self) -> tuple[str, ...]:
        """Name landmarks that are left out; those of a known skeleton are expected."""
        if self.joints.names or not self.unknown:
            return ()
        found = f"{counted(len(self.unknown), 'landmark')} left out, which the dictionary lacks"
        return (f"{found} ({abbreviate(self.unknown)})",)

    def describe(self, names: Sequence[str]) -> str:
        """Say how many landmarks stand for joints of the dictionary; nothing where none do."""
        taken = sum(map(len, self.joints.markers.values()))
        return f"matched {taken} of {counted(len(names), 'keypoint')}" if taken else ""


def match_names(
    names: Sequence[str], dictionary: Dictionary, place: str, *, in_place: bool = True
) -> Matched:
    """Match the landmarks of files to those of a dictionary by their names.

    Raises InputError where fewer than three landmarks are the dictionary's, and others are not.
    """
    joints = find_joints(names, dictionary.landmark_names, in_place=in_place)
    if WHERE_MARKED in dictionary.provenance:
        dictionary = dictionary.marked({*names, *joints.markers})
        known = dictionary.landmark_names
        parts = {name: part for name, part in joints.parts.items() if joints_of(part) <= {*known}}
        joints = Joints(known, parts, find_markers(parts, names, known))
    known = dictionary.landmark_names
    unknown = [name for name in names if joints.names.get(name, name) not in set(known)]
    matching = len(names) - len(unknown)
    if unknown and matching < FEWEST_LANDMARKS:
        found = (
            f"{matching or 'none'} of the {counted(len(names), 'landmark')} "
            f"{'are' if matching > 1 else 'is'} in the dictionary, at least {FEWEST_LANDMARKS} "
            f"must be (files: {abbreviate(names, 10)}; dictionary: {abbreviate(known, 10)})"
        )
        fix = "give a dictionary of such objects, or name landmarks alike: "
        raise input_error(place, found, fix + "`rename: {FILE: DICTIONARY}`")
    return Matched(dictionary, joints, unknown)


@dataclass(frozen=True)
class Joints:
    """known, the joints of the dictionary; parts by the landmarks of the files that mark one.

    markers: the landmarks that stand for a joint, one or the mean of some.
    """

    known: tuple[str, ...]
    parts: Mapping[str, Part]
    markers: Mapping[str, tuple[str, ...]]

    @property
    def names(self) -> dict[str, str]:
        """The landmark in whose column the images have each joint -> that joint."""
        return {landmarks[0]: joint for joint, landmarks in self.markers.items()}

    @property
    def parameters(self) -> tuple[str, ...]:
        """The parameters that move a landmark of the files."""
        markers = (name for several in self.markers.values() for name in several)
        used = {name for marker in markers for name in self.parts[marker].along}
        return tuple(name for name in THETA if name in used)

    def rows(self, landmarks: Sequence[str], theta: Mapping[str, float]) -> Floats:
        """Weights (m, p) of the joints that give the landmarks."""
        weights = np.zeros((len(landmarks), len(self.known)))
        for row, name in enumerate(landmarks):
            for joint, weight in self.parts[name].weights(theta).items():
                weights[row, self.known.index(joint)] = weight
        return weights

    def matrix(self, theta: Mapping[str, float]) -> Floats:
        """A (p, p), the identity where no landmark stands for a joint."""
        A = np.eye(len(self.known))
        for joint, landmarks in self.markers.items():
            A[self.known.index(joint)] = self.rows(landmarks, theta).mean(axis=0)
        return A

    def deviations(self) -> Floats:
        """Standard deviations (p,) of the landmarks from A x."""
        std = {joint: self.parts[landmarks[0]].std for joint, landmarks in self.markers.items()}
        return np.array([std.get(joint, 0.0) for joint in self.known])


def find_joints(names: Sequence[str], known: Sequence[str], *, in_place: bool = True) -> Joints:
    """Return the landmarks that stand for joints which the dictionary has and the files do not.

    Without `in_place` landmarks are taken to lie where the joints do, each for itself.
    """
    unknown = [name for name in names if name not in set(known)]
    parts = {
        name: part if in_place else Part(part.joint, {part.joint: 1.0} if part.joint else {})
        for name, part in people_parts(unknown).items()
        if joints_of(part) <= set(known) and (in_place or (part.alone and part.joint))
    }
    return Joints(tuple(known), parts, find_markers(parts, names, known))


def joints_of(part: Part) -> set[str]:
    """Return the joints of which a landmark is a sum."""
    return set(part.fixed).union(*part.along.values())


def find_markers(
    parts: Mapping[str, Part], names: Sequence[str], known: Sequence[str]
) -> dict[str, tuple[str, ...]]:
    """Return the landmarks that stand for each joint, where some do.

    Of several for one joint those stand for it that deviate least from it, such as the top of the
    head in place of ears, together if they are pairs, and none if they are alike.
    """
    markers: dict[str, tuple[str, ...]] = {}
    for joint in known:
        meant = [name for name, part in parts.items() if part.joint == joint and joint not in names]
        least = min((parts[name].std for name in meant), default=0.0)
        nearest = tuple(name for name in meant if parts[name].std == least)
        if nearest and (len(nearest) == 1 or not any(parts[name].alone for name in nearest)):
            markers[joint] = nearest
    return markers


def is_of_people(names: Sequence[str]) -> bool:
    """Whether landmarks are joints of people, by their names."""
    joints = set(names) & set(PEOPLE) | {*people_joints(names).values()}
    return len(joints) >= FEWEST_JOINTS and bool(joints & PEOPLE_ALONE)


def named_as_joints(images: LandmarkSet, joints: Joints, place: str) -> LandmarkSet:
    """Return the images with the landmarks that stand for joints named so, or their mean."""
    if not joints.names:
        return images
    landmarks, confidence, weights = images.landmarks, images.confidence, images.weights()
    for several in (several for several in joints.markers.values() if len(several) > 1):
        columns = [images.landmark_names.index(name) for name in several]
        visible: Flags = np.asarray(weights[:, columns] > 0)
        count = np.maximum(visible.sum(axis=1), 1)
        mean = np.where(visible[:, None], landmarks[..., columns], 0.0).sum(axis=2) / count[:, None]
        landmarks = landmarks.copy()
        landmarks[..., columns[0]] = np.where(visible.any(axis=1, keepdims=True), mean, np.nan)
        if confidence is not None:
            confidence = confidence.copy()
            confidence[:, columns[0]] = weights[:, columns].sum(axis=1) / count
    changed = images.replaced(landmarks=landmarks, confidence=confidence)
    return changed.renamed(joints.names, place)


@dataclass(frozen=True)
class LandmarkMap:
    """Landmarks y = A(theta) x of the joints x of a dictionary.

    active, whether they may differ from the joints; depends_on, the landmark that each (p,) depends
    on, -1 for none, None where none does; residual_variance of those.
    """

    joints: Joints
    theta: Mapping[str, float]
    active: bool
    depends_on: Integers | None = None
    residual_variance: float = 0.0

    @classmethod
    def of(cls, matched: Matched, skeleton: Mapping[str, float] | None, *, prior: bool) -> Self:
        """Return the map of files; landmarks differ from joints for methods with a prior only."""
        dictionary, joints = matched.dictionary, matched.joints
        dependents = dictionary.depends_on if dictionary.provenance.get(WHERE_MARKED) else None
        active = prior and bool(joints.markers or dependents is not None)
        return cls(joints, {**MEANS, **(skeleton or {})}, active, dependents)

    @property
    def moves(self) -> bool:
        """Whether a landmark stands for a joint and lies elsewhere."""
        return self.active and bool(self.joints.markers)

    def apply(self, dictionary: Dictionary) -> Dictionary:
        """Return the dictionary of the landmarks."""
        if not self.active:
            return dictionary
        return mapped(dictionary, self.joints.matrix(self.theta), self.joints.deviations())

    def back(
        self, lifting: Lifting, landmarks: Floats, visible: Flags
    ) -> tuple[Lifting, dict[str, NDArray[Any]]]:
        """Return the lifting of the joints, and all landmarks of the files as datasets.

        landmarks (n, 2, p) as images show them, and which (n, p) are seen there.
        """
        if not self.active:
            return lifting, {}
        if self.depends_on is not None:
            variance = self.residual_variance
            lifting = place_dependents(lifting, landmarks, visible, self.depends_on, variance)
        A, names = self.joints.matrix(self.theta), tuple(self.joints.parts)
        joints = as_joints(lifting, A)
        if not names:
            return joints, {}
        rows = self.joints.rows(names, self.theta) @ np.linalg.inv(A)
        markers = {name for several in self.joints.markers.values() for name in several}
        std = [0.0 if name in markers else self.joints.parts[name].std for name in names]
        shown = see_rows(rows, lifting.shapes, lifting.estimate.covariance, np.array(std))
        datasets = {INPUT_NAMES: np.array(names, dtype=object), MAP: A}
        datasets[INPUT_SHAPES] = shown.points.swapaxes(1, 2)
        if shown.deviation is not None and shown.correlation is not None:
            sd = lifting.scale[:, None, None] * shown.deviation
            datasets[INPUT_SD] = sd.swapaxes(1, 2)
            datasets[INPUT_CORRELATION] = shown.correlation.swapaxes(1, 2).astype(np.float32)
        return joints, datasets
