"""Landmarks of detectors of people beside the joints of a dictionary: y = A(theta) x.

Landmark y_j of a detector stands for joint j, and lies where A says; joints that no landmark stands
for are their own. The fit works on y, whose prior is that of x seen through A; its joints, and all
landmarks of the detector, are then rows of weights of what it found.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats, Integers
from shapefit.dictionary.model import WHERE_MARKED, Dictionary, mapped
from shapefit.errors import abbreviate, counted, input_error
from shapefit.io import LandmarkSet
from shapefit.io.layout import INPUT_CORRELATION, INPUT_NAMES, INPUT_SD, INPUT_SHAPES
from shapefit.io.names import match_landmarks, nearest_names
from shapefit.io.skeletons import PEOPLE, THETA, Part, people_joints, people_parts
from shapefit.lifting.derived_landmarks import as_joints, place_dependents, see_rows
from shapefit.lifting.lift import Lifting

MAP = "landmark_map"
"""Dataset of a result: A."""

MEANS: Mapping[str, float] = {name: parameter.mean for name, parameter in THETA.items()}


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
        used = {
            name for ls in self.markers.values() for each in ls for name in self.parts[each].along
        }
        return tuple(name for name in THETA if name in used)

    def rename(self, own: Sequence[str]) -> list[str]:
        """Return the names of landmarks with joints in the place of those that stand for them."""
        return [self.names.get(name, name) for name in own]

    def rows(self, landmarks: Sequence[str], theta: Mapping[str, float]) -> Floats:
        """Weights (m, p) of the joints that give the landmarks."""
        found = np.zeros((len(landmarks), len(self.known)))
        for row, name in enumerate(landmarks):
            for joint, weight in self.parts[name].weights(theta).items():
                found[row, self.known.index(joint)] = weight
        return found

    def matrix(self, theta: Mapping[str, float]) -> Floats:
        """A (p, p), the identity where no landmark stands for a joint."""
        A = np.eye(len(self.known))
        for joint, landmarks in self.markers.items():
            A[self.known.index(joint)] = self.rows(landmarks, theta).mean(axis=0)
        return A

    def apart(self) -> Floats:
        """Standard deviations (p,) of the landmarks from A x."""
        found = np.zeros(len(self.known))
        for joint, landmarks in self.markers.items():
            found[self.known.index(joint)] = self.parts[landmarks[0]].std
        return found


FEWEST_JOINTS = 6
"""Of people that landmarks are recognised by."""

PEOPLE_ALONE = {f"{side}{joint}" for side in "lr" for joint in ("wrist", "ankle")}
"""Joints that people have, and hardly any tracked animal."""


def is_of_people(names: Sequence[str]) -> bool:
    """Whether landmarks are joints of people, by their names."""
    known = set(names) & set(PEOPLE) | {*people_joints(names).values()}
    return len(known) >= FEWEST_JOINTS and bool(known & PEOPLE_ALONE)


def find_joints(own: Sequence[str], known: Sequence[str], *, in_place: bool = True) -> Joints:
    """Return the landmarks that stand for joints which the dictionary has and the files do not.

    Of several for one joint those stand for it that are least apart from it, such as the top of the
    head in place of ears, together if they are pairs, and none if they are alike. Without
    `in_place` landmarks are taken to lie where the joints do, each for itself.
    """
    unknown = [name for name in own if name not in set(known)]
    parts = {
        name: part
        for name, part in people_parts(unknown).items()
        if joints_of(part) <= set(known) and (in_place or part.alone)
    }
    if not in_place:
        at = {name: part.joint for name, part in parts.items() if part.joint is not None}
        parts = {name: Part(joint, {joint: 1.0}) for name, joint in at.items()}
    return Joints(tuple(known), parts, find_markers(parts, own, known))


def joints_of(part: Part) -> set[str]:
    """Return the joints of which a landmark is a sum."""
    return set(part.fixed).union(*part.along.values())


def find_markers(
    parts: Mapping[str, Part], own: Sequence[str], known: Sequence[str]
) -> dict[str, tuple[str, ...]]:
    """Return the landmarks that stand for each joint, where some do."""
    markers: dict[str, tuple[str, ...]] = {}
    for joint in known:
        meant = [name for name, part in parts.items() if part.joint == joint and joint not in own]
        least = min((parts[name].std for name in meant), default=0.0)
        nearest = tuple(name for name in meant if parts[name].std == least)
        if nearest and (len(nearest) == 1 or not any(parts[name].alone for name in nearest)):
            markers[joint] = nearest
    return markers


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
        return named.arrange(self.dictionary.landmark_names, place, leave_out=bool(self.unknown))

    def warnings(self, own: Sequence[str]) -> tuple[str, ...]:
        """Name landmarks that are left out; those of a known skeleton are expected."""
        if self.joints.names:
            return ()
        known = self.dictionary.landmark_names
        unknown = [name for name in own if name not in set(known)]
        return left_out_landmarks(unknown, [name for name in known if name not in set(own)])

    def describe(self, own: Sequence[str]) -> str:
        """Say how many landmarks stand for joints of the dictionary; nothing where none do."""
        taken = sum(map(len, self.joints.markers.values()))
        return f"matched {taken} of {counted(len(own), 'keypoint')}" if taken else ""


def match_names(
    own: Sequence[str], dictionary: Dictionary, place: str, *, in_place: bool = True
) -> Matched:
    """Match the landmarks of files to those of a dictionary by their names.

    Raises InputError as `check_enough`.
    """
    joints = find_joints(own, dictionary.landmark_names, in_place=in_place)
    if WHERE_MARKED in dictionary.provenance:
        dictionary = dictionary.marked({*own, *joints.markers})
        known = dictionary.landmark_names
        parts = {name: part for name, part in joints.parts.items() if joints_of(part) <= {*known}}
        joints = Joints(known, parts, find_markers(parts, own, known))
    renamed, known = joints.rename(own), dictionary.landmark_names
    unknown = [name for name in renamed if name not in set(known)]
    check_enough(renamed, known, place)
    return Matched(dictionary, joints, unknown)


def find_dependents(dictionary: Dictionary) -> Integers | None:
    """Return what each landmark (p,) hangs on, -1 for nothing; None where none does."""
    return dictionary.depends_on if dictionary.provenance.get(WHERE_MARKED) else None


def named_as_joints(images: LandmarkSet, joints: Joints, place: str) -> LandmarkSet:
    """Return the images with the landmarks that stand for joints named so, or their mean."""
    if not joints.names:
        return images
    landmarks, confidence = images.landmarks, images.confidence
    weights = images.weights()
    for several in joints.markers.values():
        if len(several) == 1:
            continue
        columns = [images.landmark_names.index(name) for name in several]
        seen: NDArray[np.bool_] = np.asarray(weights[:, columns] > 0)
        count = np.maximum(seen.sum(axis=1), 1)
        of_seen = np.where(seen[:, None], landmarks[..., columns], 0.0).sum(axis=2) / count[:, None]
        landmarks = landmarks.copy()
        landmarks[..., columns[0]] = np.where(seen.any(axis=1, keepdims=True), of_seen, np.nan)
        if confidence is not None:
            confidence = confidence.copy()
            confidence[:, columns[0]] = weights[:, columns].sum(axis=1) / count
    changed = images.replaced(landmarks=landmarks, confidence=confidence)
    return changed.renamed(joints.names, place)


@dataclass(frozen=True)
class LandmarkMap:
    """Landmarks y = A(theta) x of the joints x of a dictionary.

    active, whether they are not the joints themselves; keep_covariance: that of all joints is
    wanted in the result; depends_on, see `find_dependents`, and the misfit.
    """

    joints: Joints
    theta: Mapping[str, float]
    active: bool
    keep_covariance: bool = False
    depends_on: Integers | None = None
    residual_variance: float = 0.0

    def apply(self, dictionary: Dictionary) -> Dictionary:
        """Return the dictionary of the landmarks."""
        if not self.active:
            return dictionary
        return mapped(dictionary, self.joints.matrix(self.theta), self.joints.apart())

    def back(
        self, lifting: Lifting, landmarks: Floats, seen: NDArray[np.bool_]
    ) -> tuple[Lifting, dict[str, NDArray[Any]]]:
        """Return the lifting of the joints, and all landmarks of the files as datasets.

        landmarks (n, 2, p) as images show them, and which (n, p) are seen there.
        """
        if not self.active:
            return lifting, {}
        if self.depends_on is not None:
            lifting = place_dependents(
                lifting, landmarks, seen, self.depends_on, self.residual_variance
            )
        A, names = self.joints.matrix(self.theta), tuple(self.joints.parts)
        rows = self.joints.rows(names, self.theta) @ np.linalg.inv(A)
        markers = {name for several in self.joints.markers.values() for name in several}
        apart = [0.0 if name in markers else self.joints.parts[name].std for name in names]
        shown = see_rows(rows, lifting.shapes, lifting.estimate.covariance, np.array(apart))
        per_item: dict[str, NDArray[Any]] = {INPUT_SHAPES: shown.points.swapaxes(1, 2)}
        if shown.deviation is not None and shown.correlation is not None:
            sd = lifting.scale[:, None, None] * shown.deviation
            per_item[INPUT_SD] = sd.swapaxes(1, 2)
            per_item[INPUT_CORRELATION] = shown.correlation.swapaxes(1, 2).astype(np.float32)
        if not names:
            return as_joints(lifting, A, self.keep_covariance), {}
        per_item |= {INPUT_NAMES: np.array(names, dtype=object), MAP: A}
        return as_joints(lifting, A, self.keep_covariance), per_item


FEWEST_LANDMARKS = 3
"""Of a file that the dictionary must know, so that it can do without the others."""

LISTED, COMPARED = 80, 200
"""Names that a message lists, and that are compared with others for the likely pairs."""

_SIDE = re.compile(r"(?:^|[^a-z])(?:(l)(?:eft)?|(r)(?:ight)?)(?:$|[^a-z])|^(?:(l)|(r))")


def check_enough(own: Sequence[str], known: Sequence[str], place: str) -> None:
    """Raise InputError where fewer than three landmarks are the dictionary's, and others are not.

    The error has both lists of names, and the pairs that look alike where these are enough.
    """
    files, theirs = set(own), set(known)
    matching = [name for name in own if name in theirs]
    if len(matching) >= FEWEST_LANDMARKS or len(matching) == len(own):
        return
    if {name.strip() for name in own} & set(known) - set(matching):
        match_landmarks(known, own, place)  # which names spaces around names
    if twice := _same_joint(own):
        found = f"landmarks of several skeletons: {twice[0]} and {twice[1]} are one joint of people"
        raise input_error(place, found, "give the files of each skeleton in a separate call")
    found = (
        f"{len(matching)} of the {counted(len(own), 'landmark')} of the files are in the "
        f"dictionary, and {FEWEST_LANDMARKS} must be; the files have {abbreviate(own, LISTED)}; "
        f"the dictionary has {abbreviate(known, LISTED)}"
    )
    pairs = _likely_pairs(
        [name for name in own if name not in theirs][:COMPARED],
        [name for name in known if name not in files][:COMPARED],
    )
    if len(matching) + len(pairs) >= FEWEST_LANDMARKS:
        raise input_error(place, found, f"name them alike: {_as_rename(pairs)}")
    fix = "give a dictionary of such objects, or name landmarks alike: `rename: {FILE: DICTIONARY}`"
    raise input_error(place, found, fix)


def _same_joint(own: Sequence[str]) -> list[str]:
    """Return the first landmarks that stand for the same joint of people; none where none do."""
    names: dict[str, list[str]] = {}
    for name, joint in people_joints(own).items():
        names.setdefault(joint, []).append(name)
    return next((several for several in names.values() if len(several) > 1), [])


def left_out_landmarks(unknown: Sequence[str], known: Sequence[str]) -> tuple[str, ...]:
    """Warn of landmarks that the dictionary lacks, with the names that they may mean."""
    if not unknown:
        return ()
    pairs = _likely_pairs(unknown[:COMPARED], known)
    hint = f"; if they are the same: {_as_rename(pairs)}" if pairs else ""
    found = f"{counted(len(unknown), 'landmark')} left out, which the dictionary lacks"
    return (f"{found} ({abbreviate(unknown)}){hint}",)


def _likely_pairs(unknown: Sequence[str], known: Sequence[str]) -> dict[str, str]:
    """Return the names that look most alike, the file's to the dictionary's."""
    near = {
        name: [each for each in nearest_names(name, known) if not _opposite(name, each)]
        for name in unknown
    }
    return {name: close[0] for name, close in near.items() if close}


def _as_rename(pairs: Mapping[str, str]) -> str:
    """Return the first pairs as the key `rename`."""
    first = [f"{name}: {meant}" for name, meant in list(pairs.items())[:5]]
    return f"`rename: {{{', '.join(first)}}}`"


def _opposite(name: str, other: str) -> bool:
    """Whether one name is of a left landmark, and the other of a right one."""
    found = [_SIDE.search(each.lower()) for each in (name, other)]
    sides = {match[match.lastindex or 0] for match in found if match}
    return sides == {"l", "r"}
