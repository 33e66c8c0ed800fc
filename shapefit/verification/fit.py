"""What the config of a fit states, and its landmarks weighted and normalised as the fit did it."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from shapefit.arrays import Flags, Floats
from shapefit.errors import input_error
from shapefit.geometry.normalisation import normalise
from shapefit.verification.checks import FLOOR, ROUNDING, Checks, Columns, largest

OPTIMAL, LIMITED, CONVERGED = "optimal", "iteration limit", "converged"
WITHOUT_SHAPE = ("degenerate input", "numerical failure")
ROBUST = ("l1", "sparse-error")
DEFAULT_THRESHOLD = 0.1
"""Of a robust loss whose config gives none."""

PROOF = "dual convex_translation transform_count transform_atom active_transforms"
"""What proves the optimum of the convex program."""
TREE = "tree_cells tree_splits tree_vertices tree_rotations tree_multipliers"
"""What proves the optimum over all rotations, of the images that have it."""

REQUIRED = {
    "method": "shapes landmarks landmarks_fitted lambda scale translation status rotation "
    "objective",
    "has_gap": "relative_gap",
    "has_one_rotation": "coefficients active_atoms",
    "is_program": "coefficients active_atoms tight residual",
    "has_proof": PROOF,
    "perspective": "camera_translation focal principal_point",
    "left_out": "left_out",
    "has_posterior": "shape_sd shape_correlation p_value inlier_probability log_evidence",
}
"""What a fit is like -> datasets that every such fit writes."""


@dataclass(frozen=True)
class Fit:
    """A fit by the resolved config that its result stores; `inputs` are digests of its files.

    loss, beta, the threshold of a robust one, and the tolerance of the gap; searched: outliers were
    looked for before the fit; left_out: the dataset that names the atoms left out, "" for none.
    has_posterior: shapes have error bars and a verdict, and no proof; solves_program: the convex
    program is solved, be it as a start; has_proof: what proves its optimum is stored; is_program,
    is_global: objective and shapes are those of the convex program, or of the optimum over all
    rotations; has_one_rotation: shapes are R sum_i c_i B_i with what is stored; has_gap: every
    shape has a gap to a bound of its objective.
    """

    config: Mapping[str, Any]
    inputs: Mapping[str, str]
    method: str
    loss: str
    beta: float
    tolerance: float
    searched: bool
    perspective: bool
    left_out: str
    has_posterior: bool
    solves_program: bool
    has_proof: bool
    is_program: bool
    is_global: bool
    has_one_rotation: bool
    has_gap: bool

    def key(self, path: str, default: Any = None) -> Any:
        """Return the value of a key, `section.key`; the default where an older config lacks it."""
        return find_key(self.config, path, default)

    def missing(self, head: Collection[str]) -> list[str]:
        """Return datasets that every such fit writes, of those without which nothing is checked."""
        names = " ".join(names for like, names in REQUIRED.items() if getattr(self, like))
        names += " convex_objective convex_relative_gap" * (self.has_proof and not self.is_program)
        names += f" {TREE}" * ("tree_cells" in head)
        return [name for name in dict.fromkeys(names.split()) if name not in head]


def find_key(config: Any, path: str, default: Any = None) -> Any:
    """Return the value of a key, `section.key`, of a config, and the default where it lacks it."""
    for part in path.split("."):
        config = config.get(part) if isinstance(config, Mapping) else None
    return default if config is None else config


def read_fit(attributes: Mapping[str, Any], file: Path) -> Fit:
    """Return the fit of the attributes `config` and `inputs` of a result.

    Raises InputError where they are not those of a fit.
    """
    try:
        config = json.loads(str(attributes["config"]))
        inputs = dict(json.loads(str(attributes.get("inputs", "{}"))))
        key, method = partial(find_key, config), str(config["method"])
        if config["lambda"] != "auto":
            float(config["lambda"])
        str(config["dictionary"])
        outliers = key("outliers.method", "none")
        loss = str(outliers if outliers in ROBUST else key("loss", "squared"))
        weak = key("camera.model") != "perspective"
        has_posterior = method in ("posterior", "sequences")
        solves = has_posterior or method in ("convex", "convex+refine")
        of_program, of_all = weak and method == "convex", weak and method == "global"
        refined = method in ("convex+refine", "alternate", "global")
        return Fit(
            config=config,
            inputs=inputs,
            method=method,
            loss=loss,
            beta=float(key("outliers.threshold", key("beta", DEFAULT_THRESHOLD))),
            tolerance=float(key("solver.tolerance", 1e-6)),
            searched=outliers not in ("none", *ROBUST),
            perspective=not weak,
            left_out=str(key("leave_out", "")),
            has_posterior=has_posterior,
            solves_program=solves,
            has_proof=solves and bool(key("proof", True)),
            is_program=of_program,
            is_global=of_all,
            has_one_rotation=refined or not (weak or has_posterior),
            has_gap=of_program
            or of_all
            or (weak and method == "convex+refine" and loss == "squared"),
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        wrong = f"{type(error).__name__}: {error}"
        found = f"its attributes `config` and `inputs` are not those of a fit ({wrong})"
        raise input_error(file, found, "give a result that `shapefit fit` wrote") from None


@dataclass(frozen=True)
class Images:
    """n images of a result: landmarks = size x points + centroid.

    columns, what the result states; fitted (n,), which have a shape; points V (n, 2, p), 0 where
    hidden; weights omega (n, p) of the convex program, inliers (n, p) those of what refines it;
    centroid (n, 2); size, lam (n,); rounding (n,), the share of its terms' magnitudes by which a
    sum of normalised numbers may be off: C u (p + 3 m), times the condition of normalisation.
    """

    fit: Fit
    columns: Columns
    fitted: Flags
    points: Floats
    weights: Floats
    inliers: Floats
    centroid: Floats
    size: Floats
    lam: Floats
    rounding: Floats

    def allow(self, terms: Floats, number: Floats | float) -> Floats:
        """Rounding (n,) of sums of terms of these magnitudes (n,) that add up to such numbers."""
        allowed: Floats = np.maximum(self.rounding * terms, FLOOR * np.abs(number))
        return allowed


def read_images(columns: Columns, dependent: Flags, fit: Fit) -> Images:
    """Weigh and normalise the landmarks of n images of a result.

    omega is the confidence, 1 without one, if the loss is `exact` or where scores are but a limit,
    and 0 where a landmark is unseen or was set aside (p,). The points have their centroid, over
    visible ones, at 0 and a mean over coordinates of 1 of the standard deviations.
    """
    landmarks = columns["landmarks"]
    weights = np.where(seen_in(columns) & ~dependent, confidence(columns), 0.0)
    least = fit.key("posterior.least_score") if fit.has_posterior else None
    if least is not None and "landmark_covariance" not in columns:
        weights = ((weights > 0) & (weights >= least)).astype(np.float64)
    labelled = columns.get("outliers", np.zeros_like(weights)) != 0
    if fit.searched:
        weights = np.where(labelled, 0.0, weights)
    if fit.loss == "exact":
        weights = (weights > 0).astype(np.float64)
    normalised = normalise(landmarks, weights > 0)
    sums = landmarks.shape[2] + 3.0 * columns.get("transform_count", np.zeros(len(landmarks)))
    extent = largest(np.where(weights[:, None] > 0, np.abs(landmarks), 0.0))
    return Images(
        fit=fit,
        columns=columns,
        fitted=np.isfinite(columns["scale"]),
        points=normalised.points,
        weights=weights,
        inliers=np.where(labelled, 0.0, weights),
        centroid=normalised.centroid,
        size=normalised.scale,
        lam=columns["lambda"],
        rounding=ROUNDING * sums * (1 + extent / normalised.scale),
    )


def confidence(columns: Columns) -> Floats:
    """Return the confidence (n, p) of the landmarks, 1 where the result has none."""
    n, _, p = columns["landmarks"].shape
    given = columns.get("confidence")
    return np.ones((n, p)) if given is None else given.astype(np.float64)


def seen_in(columns: Columns) -> Flags:
    """The landmarks (n, p) that have a place and confidence."""
    return np.asarray(np.isfinite(columns["landmarks"]).all(axis=1) & (confidence(columns) > 0))


def check_statement(images: Images, checks: Checks) -> None:
    """Check status and gap, that a shape is whole or absent, its scale, and lambda."""
    columns, fit, fitted = images.columns, images.fit, images.fitted
    words, everyone = columns["status"].astype(str), np.ones_like(fitted)
    good = [LIMITED, OPTIMAL if fit.is_program or fit.is_global else CONVERGED]
    right = np.where(fitted, np.isin(words, good), np.isin(words, WITHOUT_SHAPE))
    checks.hold("status is one of the method", right, of=everyone)
    if fit.is_program or fit.is_global:
        gap = columns["relative_gap"]
        if fit.loss == "exact":
            gap = np.maximum(np.abs(gap), columns.get("residual", 0.0))
        claim = "an optimal image is within the tolerance"
        checks.add(claim, gap - fit.tolerance, FLOOR, of=words == OPTIMAL)
        if fit.is_program:
            checks.settled.add("status")
            claim = "an image at the iteration limit is not optimal"
            checks.hold(claim, ~(gap <= fit.tolerance), of=words == LIMITED)
    whole = np.isfinite(columns["shapes"]).all(axis=(1, 2))
    empty = np.isnan(columns["shapes"]).all(axis=(1, 2))
    empty &= columns.get("transform_count", np.zeros(len(words))) == 0
    checks.hold("a shape is whole or absent", np.where(fitted, whole, empty), of=everyone)
    scale = columns["scale"]
    checks.hold("scale is above 0", (scale > 0) & (scale < np.inf), of=~np.isnan(scale))
    stated = 1.0 if fit.loss == "exact" else fit.key("lambda")
    if stated != "auto":
        checks.equal("lambda", "the config", float(stated) + 0 * images.lam, 0.0)
    elif fit.left_out:
        checks.hold("lambda is above 0", images.lam > 0)
