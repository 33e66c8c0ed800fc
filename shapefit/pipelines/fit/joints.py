"""Landmarks of detectors of people, taken for the joints of a dictionary that has those."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from shapefit.errors import abbreviate, counted
from shapefit.io import LandmarkSet
from shapefit.io.skeletons import people_joints, people_weights


class Joints(NamedTuple):
    """Landmarks of the files -> joints of the dictionary, and -> factors of their confidence."""

    names: Mapping[str, str]
    weights: Mapping[str, float]

    def rename(self, own: Sequence[str]) -> list[str]:
        """Return the names of landmarks with joints in the place of those that stand for them."""
        return [self.names.get(name, name) for name in own]

    @property
    def notes(self) -> tuple[str, ...]:
        """Say which landmarks were taken for joints."""
        if not self.names:
            return ()
        pairs = abbreviate([f"{name} for {joint}" for name, joint in self.names.items()])
        return (f"{counted(len(self.names), 'landmark')} taken for joints of people ({pairs})",)


def find_joints(own: Sequence[str], known: Sequence[str]) -> Joints:
    """Return the landmarks that stand for joints which the dictionary has and the files do not."""
    missing = set(known) - set(own)
    strange = [name for name in own if name not in set(known)]
    meant = {name: joint for name, joint in people_joints(strange).items() if joint in missing}
    count = Counter(meant.values())
    names = {name: joint for name, joint in meant.items() if count[joint] == 1}
    return Joints(names, people_weights(names))


def as_joints(images: LandmarkSet, joints: Joints, place: str) -> LandmarkSet:
    """Return the images with those landmarks named and weighed as joints."""
    if not joints.names:
        return images
    weights = np.array([joints.weights.get(name, 1.0) for name in images.landmark_names])
    if (weights != 1.0).any():
        given = 1.0 if images.confidence is None else images.confidence
        images = replace(images, confidence=given * weights * np.ones((len(images), 1)))
    return images.renamed(joints.names, place)
