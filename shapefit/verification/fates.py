"""What becomes of each statement of a result: proved, compared with something else, or stated only.

One table: a dataset or attribute that a fit can write has a row here. Proved is what follows, image
by image, from landmarks, dictionary and lambda; compared is what stands in a file that is given as
well; all else is stated by the result alone, and `verify` names it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

from shapefit.verification.terms import CONVEX, GLOBAL, LOOKING, ROBUST, Terms

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
    **_each("version solve_seconds images_per_second training_inputs"),
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
