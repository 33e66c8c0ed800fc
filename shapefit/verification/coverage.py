"""What was checked of a result, and what was not, in the words that `verify` ends with."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass, field

import numpy as np

from shapefit.io import ResultSet
from shapefit.verification.check import Check, Tally
from shapefit.verification.fates import ATTRIBUTES, CARRIED, DATASETS, FOREIGN, Fates
from shapefit.verification.folder import STATED
from shapefit.verification.inputs import unknown_inputs
from shapefit.verification.proofs.rotation_tree import HOLD_ALL
from shapefit.verification.terms import LOOKING, STARTED, Terms


@dataclass
class Coverage:
    """Claims counted over images, and the fates of all that is stated, over all files of a result.

    good: images with a shape that miss no claim; empty: those without a shape; refuted: those
    without a shape that miss a claim; in_folder: whether a manifest lists the files; unknown:
    inputs whose digests are not stated.
    """

    in_folder: bool = False
    landmarks: bool = False
    tally: Tally = field(default_factory=Tally)
    fates: Fates = field(default_factory=Fates)
    unknown: set[str] = field(default_factory=set)
    images: int = 0
    good: int = 0
    empty: int = 0
    refuted: int = 0
    terms: Terms | None = None

    def begin(
        self, datasets: Iterable[str], head: ResultSet, terms: Terms, carried: Collection[str]
    ) -> list[tuple[str, str]]:
        """Sort what a file states; `carried` are the datasets that came with the landmarks given.

        Returns what no fit of these terms writes, and why that is false.
        """
        self.terms = terms
        self.unknown.update(unknown_inputs(terms))
        attributes = {"unit", "y_axis", *head.attributes}
        attributes |= {"frame_rate"} if head.frame_rate is not None else set()
        strange: list[tuple[str, str]] = []
        for table, names in ((ATTRIBUTES, attributes), (DATASETS, datasets)):
            unlisted = {name: CARRIED if name in carried else FOREIGN for name in names}
            for name in names:
                known = (unlisted | table)[name]
                if not self.fates.add(name, known, terms, landmarks=self.landmarks):
                    strange.append((name, f"is nothing that a fit by {terms.method} writes"))
        return strange

    def add(self, result: ResultSet, checks: list[Check]) -> None:
        """Take in the checks of some more images."""
        self.tally.add(checks)
        missed = np.any([one.missed for one in checks], axis=0)
        empty = np.isnan(result.scale) if result.scale is not None else np.zeros(len(result), bool)
        self.images += len(result)
        self.good += int((~missed & ~empty).sum())
        self.empty += int(empty.sum())
        self.refuted += int((missed & empty).sum())

    def lines(self) -> list[str]:
        """Return the table of claims, and below what was checked, what was not, what it proves."""
        lines = [*self.tally.lines(), "", *self.fates.lines()]
        if self.in_folder:
            names = [f"`{name}`" for names in STATED.values() for name in names]
            names += [] if self.landmarks else ["`sizes`", "whether the last part is there"]
            lines.append(f"Of the manifest, not checked: {', '.join(names)}.")
        if self.unknown:
            lines.append(
                f"Inputs of which the digest is not stated: {', '.join(sorted(self.unknown))}."
            )
        return [*lines, "", *self.conclusion()]

    def conclusion(self) -> list[str]:
        """State in sentences what is proved, of how many images, and what is not."""
        if self.terms is None:
            return ["No image was checked."]
        said = explain(self.terms)
        trees = self.tally.counts.get(HOLD_ALL)
        if self.terms.is_global:
            said[0] = f"Of {trees.made if trees else 0} of {self.images} images {said[0]}"
        elif self.terms.has_program and self.good < self.images:
            said[0] = f"Of {self.good} of {self.images} images: {said[0][0].lower()}{said[0][1:]}"
        if self.empty:
            why = "their landmarks, which were compared, are degenerate"
            if not self.landmarks:
                why = "that is not checked without `--landmarks`"
            elif self.refuted:
                why = f"a claim above does not hold for {self.refuted} of them"
            said.append(f"{self.empty} of {self.images} images have no shape: {why}.")
        return said


def explain(terms: Terms) -> list[str]:
    """State in sentences what the claims about such a fit prove, and what they do not."""
    if terms.is_program:
        said = ["The optimum of the convex program is proved to the gap stated."]
    elif terms.has_program and terms.perspective and terms.method not in LOOKING:
        said = [
            "The optimum of the convex program from which the refinement under perspective starts "
            "is proved; no bound is known for the result of the refinement."
        ]
    elif terms.method in STARTED:
        said = [
            "The optimum of the convex program that gives the view to start from is proved; the "
            "posterior itself has no proof."
        ]
    elif terms.has_program and terms.loss == "squared":
        said = [
            f"The objective of {terms.method} is bounded by the dual of the convex program: no "
            "shape with one rotation is better by more than the gap stated."
        ]
    elif terms.has_program:
        said = [
            "The optimum of the robust program that finds the outliers is proved; no bound is "
            "known for the refinement."
        ]
    elif terms.is_global:
        said = [
            "a tree is stored (`search.proof_every`) that proves that no rotation has an objective "
            "below `objective * (1 - relative_gap)`; of the others the gap is stated, not proved."
        ]
    else:
        said = [f"The method {terms.method} has no proof of an optimum."]
    if not (terms.is_program or terms.has_one_rotation):
        said.append("How its shapes are computed is not covered.")
    return said
