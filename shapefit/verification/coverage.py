"""What was checked of a result, and what was not, in the words that `verify` ends with.

One table of what becomes of each statement: a dataset or attribute that a fit can write has a row
there. Proved is what follows, image by image, from landmarks, dictionary and lambda; compared is
what stands in a file that is given as well; all else is stated by the result alone, and `verify`
names it.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, field

import numpy as np

from shapefit.io import ResultSet
from shapefit.verification.check import Check, Tally
from shapefit.verification.folder import STATED
from shapefit.verification.proofs.rotation_tree import HOLD_ALL
from shapefit.verification.terms import CONVEX, GLOBAL, LOOKING, ROBUST, STARTED, Terms

Fits = Callable[[Terms], bool]
"""Those fits of which something is so."""

CONFIG, DICTIONARY, LANDMARKS = "config", "dictionary", "landmarks"


def _always(_: Terms) -> bool:
    return True


def _never(_: Terms) -> bool:
    return False


def _follows(terms: Terms) -> bool:
    """Whether the shapes follow from coefficients or transforms that are stored."""
    return terms.is_program or terms.has_one_rotation


@dataclass(frozen=True)
class Statement:
    """A dataset or attribute: the fits that write it, and those that prove it.

    by: what it is compared with, '' for nothing. What is neither is stated only.
    """

    of: Fits = _always
    proved: Fits = _never
    by: str = ""


def _each(
    names: str, of: Fits = _always, proved: Fits = _never, by: str = ""
) -> dict[str, Statement]:
    return dict.fromkeys(names.split(), Statement(of, proved, by))


ATTRIBUTES: dict[str, Statement] = {
    **_each("unit y_axis frame_rate", by=LANDMARKS),
    **_each("config config_digest method", by=CONFIG),
    **_each("inputs metres_from", by=DICTIONARY),
    **_each("version solve_seconds images_per_second"),
}
"""What a fit states of all its images, by the name of the attribute."""

DATASETS: dict[str, Statement] = {
    **_each("item sequence landmarks confidence", by=LANDMARKS),
    **_each("landmark_names metres_per_unit", by=DICTIONARY),
    **_each("left_out", of=lambda t: bool(t.left_out), by=CONFIG),
    **_each("lambda", proved=lambda t: t.lam is None and not t.left_out, by=CONFIG),
    **_each("shapes rotation", proved=_follows),
    **_each("landmarks_fitted translation scale", proved=lambda t: _follows(t) or t.perspective),
    **_each("coefficients active_atoms", of=lambda t: t.weighs_atoms, proved=_follows),
    **_each("transforms", of=lambda t: t.transforms and _follows(t), proved=_follows),
    **_each("objective residual", proved=lambda t: _follows(t) and not t.perspective),
    **_each("relative_gap", of=lambda t: t.has_gap, proved=lambda t: t.method != GLOBAL),
    **_each("status", proved=lambda t: t.is_program),
    **_each("iterations"),
    **_each("tight", of=lambda t: t.method == CONVEX, proved=_follows),
    **_each(
        "outliers",
        of=lambda t: t.searched or t.loss in ROBUST,
        proved=lambda t: t.is_program and not t.searched,
    ),
    **_each(
        "dual convex_translation transform_count transform_atom active_transforms",
        of=lambda t: t.has_program,
        proved=lambda t: t.has_program,
    ),
    **_each(
        "convex_objective convex_relative_gap",
        of=lambda t: t.has_program and not t.is_program,
        proved=lambda t: t.has_program,
    ),
    **_each(
        "tree_cells tree_splits tree_vertices tree_rotations tree_multipliers",
        of=lambda t: t.method == GLOBAL and t.trees,
        proved=lambda t: t.is_global,
    ),
    **_each(
        "modes mode_objective mode_rotation mode_shapes",
        of=lambda t: t.method == GLOBAL and t.modes,
        proved=lambda t: t.is_global,
    ),
    **_each("modes_complete", of=lambda t: t.method == GLOBAL and t.modes),
    **_each(
        "camera_translation focal principal_point",
        of=lambda t: t.perspective,
        proved=lambda t: t.perspective,
    ),
    **_each("position", of=lambda t: t.perspective and t.weighs_atoms, by=DICTIONARY),
    **_each(
        "shape_sd shape_correlation log_evidence plausibility belief trusted doubt",
        of=lambda t: t.method in LOOKING,
    ),
    **_each(
        "input_shapes input_shape_sd input_shape_correlation input_landmark_names landmark_map",
        of=lambda t: t.method in LOOKING,
    ),
    **_each("shape_covariance", of=lambda t: t.method in LOOKING and t.covariance),
    **_each("sequence_noise", of=lambda t: t.method == "sequences"),
    **_each("mesh_vertices", of=_never),
}
"""What a fit states of each image, by the name of the dataset."""

CARRIED, FOREIGN = Statement(by=LANDMARKS), Statement()
"""A dataset that came with the landmarks, and one that is neither theirs nor of a fit."""


@dataclass
class Fates:
    """Names of datasets and attributes: proved, compared (with what), and stated only.

    uncompared are those that could be compared if the landmarks were given.
    """

    proved: set[str] = field(default_factory=set)
    compared: dict[str, set[str]] = field(default_factory=dict)
    uncompared: set[str] = field(default_factory=set)
    stated: set[str] = field(default_factory=set)

    def add(self, name: str, known: Statement, terms: Terms, *, landmarks: bool) -> bool:
        """Sort a name in; `landmarks` were given or not. Returns whether such a fit writes it."""
        if not known.of(terms):
            return False
        if known.proved(terms):
            self.proved.add(name)
        elif not known.by:
            self.stated.add(name)
        elif known.by == LANDMARKS and not landmarks:
            self.uncompared.add(name)
        else:
            self.compared.setdefault(known.by, set()).add(name)
        return True

    def lines(self) -> list[str]:
        """Say in a few lines what was checked, and name what was not."""
        compared = [f"{len(names)} compared with the {by}" for by, names in self.compared.items()]
        lines = [f"Datasets and attributes: {len(self.proved)} proved, {', '.join(compared)}."]
        if self.uncompared:
            lines.append(f"Not compared without `--landmarks`: {_listed(self.uncompared)}.")
        return [*lines, f"Not checked, stated only: {_listed(self.stated)}."]


def _listed(names: Iterable[str]) -> str:
    return ", ".join(f"`{name}`" for name in sorted(names)) or "nothing"


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
        self.unknown.update(terms.unknown_inputs)
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
