"""What the config of a fit states, and its landmarks weighted and normalised as the fit did it."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Flags, Floats
from shapefit.errors import input_error
from shapefit.geometry.normalisation import LARGEST, SMALLEST
from shapefit.verification.checks import FLOOR, Checks, largest, rounding

Columns = Mapping[str, NDArray[Any]]
"""Datasets of n images of a result by name; points one a column, (n, 3, p) or (n, 2, p)."""

PROOF = ("dual", "convex_translation", "transform_count", "transform_atom", "active_transforms")
"""What proves the optimum of the convex program."""

OPTIMAL, LIMITED, CONVERGED = "optimal", "iteration limit", "converged"
WITHOUT_SHAPE = ("degenerate input", "numerical failure")
ROBUST = ("l1", "sparse-error")
DEFAULT_THRESHOLD = 0.1
"""Of a robust loss whose config gives none."""

DRAWS, SEED = 512, 1504_01507
LEAST, MOST = 1e-3, 1e30
"""Of `lambda: auto`: draws of noise, their seed, and the bounds (docs/lambda.md)."""

FEWEST, FLAT = 3, 1e-9
"""Visible landmarks that a shape needs, and singular values whose ratio makes them a line."""


@dataclass(frozen=True)
class Fit:
    """A fit by the resolved config that its result stores; `inputs` are digests of its files.

    depth_is_open, whether the dictionary may be its own mirror image in depth.
    """

    config: Mapping[str, Any]
    inputs: Mapping[str, str]
    depth_is_open: bool = False

    def key(self, path: str, default: Any = None) -> Any:
        """Return the value of a key, `section.key`; the default where an older config lacks it."""
        value: Any = self.config
        for part in path.split("."):
            value = value.get(part) if isinstance(value, Mapping) else None
        return default if value is None else value

    @property
    def method(self) -> str:
        """How the images were lifted."""
        return str(self.config["method"])

    @property
    def loss(self) -> str:
        """The data term: that of the config, unless the outliers have one."""
        robust = self.key("outliers.method")
        return str(robust if robust in ROBUST else self.key("loss", "squared"))

    @property
    def beta(self) -> float:
        """The threshold of a robust loss, normalised."""
        return float(self.key("outliers.threshold", self.key("beta", DEFAULT_THRESHOLD)))

    @property
    def tolerance(self) -> float:
        """The gap at which an image is optimal."""
        return float(self.key("solver.tolerance", 1e-6))

    @property
    def searched(self) -> bool:
        """Whether outliers were looked for before the fit."""
        return self.key("outliers.method", "none") not in ("none", *ROBUST)

    @property
    def perspective(self) -> bool:
        """Whether the camera sees in perspective."""
        return bool(self.key("camera.model") == "perspective")

    @property
    def left_out(self) -> str:
        """The dataset that names the atoms left out, "" for none."""
        return str(self.key("leave_out", ""))

    @property
    def has_posterior(self) -> bool:
        """Whether shapes have error bars and a verdict, and no proof."""
        return self.method in ("posterior", "sequences")

    @property
    def solves_program(self) -> bool:
        """Whether the convex program is solved, be it as a start."""
        return self.method in ("convex", "convex+refine") or self.has_posterior

    @property
    def is_program(self) -> bool:
        """Whether objective and shapes are those of the convex program itself."""
        return self.method == "convex" and not self.perspective

    @property
    def is_global(self) -> bool:
        """Whether objective and shapes are those of the optimum over all rotations."""
        return self.method == "global" and not self.perspective

    @property
    def has_one_rotation(self) -> bool:
        """Whether shapes are R sum_i c_i B_i with the rotation and coefficients stored."""
        refined = self.perspective and not self.has_posterior
        return refined or self.method in ("convex+refine", "alternate", "global")

    @property
    def has_gap(self) -> bool:
        """Whether every shape has a gap to a bound of its objective."""
        refined = self.method == "convex+refine" and self.loss == "squared"
        return self.is_program or self.is_global or (refined and not self.perspective)

    @property
    def required(self) -> tuple[str, ...]:
        """Datasets without which nothing can be checked; every such fit writes them."""
        names = ["shapes", "landmarks", "landmarks_fitted", "lambda", "scale", "translation"]
        names += ["status", "rotation", "objective"]
        names += ["relative_gap"] if self.has_gap else []
        names += ["coefficients", "active_atoms"] if self.has_one_rotation else []
        if self.is_program:
            names += ["coefficients", "active_atoms", "tight", "residual"]
        if self.solves_program and self.key("proof", True):
            names += PROOF
            names += [] if self.is_program else ["convex_objective", "convex_relative_gap"]
        if self.perspective:
            names += ["camera_translation", "focal", "principal_point"]
        names += ["left_out"] if self.left_out else []
        names += (
            ["shape_sd", "plausibility", "belief", "log_evidence"] if self.has_posterior else []
        )
        return tuple(dict.fromkeys(names))


def read_fit(attributes: Mapping[str, Any], file: Path) -> Fit:
    """Return the fit of the attributes `config` and `inputs` of a result.

    Raises InputError where they are not those of a fit.
    """
    try:
        config = json.loads(str(attributes["config"]))
        fit = Fit(config, dict(json.loads(str(attributes.get("inputs", "{}")))))
        if config["lambda"] != "auto":
            float(config["lambda"])
        _ = fit.required, fit.beta, fit.tolerance, str(config["dictionary"])
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        wrong = f"{type(error).__name__}: {error}"
        found = f"its attributes `config` and `inputs` are not those of a fit ({wrong})"
        raise input_error(file, found, "give a result that `shapefit fit` wrote") from None
    return fit


@dataclass(frozen=True)
class Images:
    """n images of a result: landmarks = size x points + centroid, at most points_error off.

    columns, what the result states; fitted (n,), which have a shape; points V (n, 2, p), 0 where
    hidden; weights omega (n, p) of the convex program, inliers (n, p) those of what refines it;
    centroid (n, 2); size, lam (n,); extent (n,), the largest coordinate of the landmarks; factor
    (n,), see `rounding`; reach (n,), the largest coordinate of the points.
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
    extent: Floats
    factor: Floats
    reach: Floats
    points_error: Floats

    def allow(self, terms: Floats, number: Floats | float) -> Floats:
        """Rounding (n,) of sums of terms of these magnitudes (n,) that add up to such numbers."""
        allowed: Floats = np.maximum(self.factor * terms, FLOOR * np.abs(number))
        return allowed


def read_images(columns: Columns, dependent: Flags, fit: Fit) -> Images:
    """Weigh and normalise the landmarks of n images of a result.

    omega is the confidence, 1 without one, if the loss is `exact` or where scores are but a limit,
    and 0 where a landmark is unseen or was set aside (p,). The points have their centroid, over
    visible ones, at 0 and a mean over coordinates of 1 of the standard deviations.
    """
    raw, fitted = columns["landmarks"], np.isfinite(columns["scale"])
    weights = np.where(seen_in(columns) & ~dependent, confidence(columns), 0.0)
    least = fit.key("posterior.least_score") if fit.has_posterior else None
    if least is not None and "landmark_covariance" not in columns:
        weights = ((weights > 0) & (weights >= least)).astype(np.float64)
    labelled = columns["outliers"] != 0 if "outliers" in columns else np.zeros_like(weights, bool)
    if fit.searched:
        weights = np.where(labelled, 0.0, weights)
    if fit.loss == "exact":
        weights = (weights > 0).astype(np.float64)
    visible = weights > 0
    W = np.where(visible[:, None], raw, 0.0)
    count = np.maximum(visible.sum(axis=1), 1)[:, None]
    centroid = np.einsum("nap->na", W) / count
    centred = np.where(visible[:, None], W - centroid[..., None], 0.0)
    size = np.sqrt(np.einsum("nap,nap->na", centred, centred) / count).mean(axis=1)
    points = centred / size[:, None, None]
    transforms = columns.get("transform_count", np.zeros(len(raw), np.int64))
    factor, extent = rounding(raw.shape[2], transforms), largest(np.abs(W))
    reach = largest(np.abs(points))
    return Images(
        fit=fit,
        columns=columns,
        fitted=fitted,
        points=points,
        weights=weights,
        inliers=np.where(labelled, 0.0, weights),
        centroid=centroid,
        size=size,
        lam=columns["lambda"],
        extent=extent,
        factor=factor,
        reach=reach,
        points_error=factor * (extent / size * (1 + 2 * reach) + reach),
    )


def confidence(columns: Columns) -> Floats:
    """Return the confidence (n, p) of the landmarks, 1 where the result has none."""
    shape = columns["landmarks"].shape
    given = columns.get("confidence")
    return np.ones((shape[0], shape[2])) if given is None else given.astype(np.float64)


def seen_in(columns: Columns) -> Flags:
    """The landmarks (n, p) that have a place and confidence."""
    return np.asarray(np.isfinite(columns["landmarks"]).all(axis=1) & (confidence(columns) > 0))


def check_statement(images: Images, dependent: Flags, checks: Checks) -> None:
    """Check the status, and that images have a shape where their landmarks allow one."""
    columns, fit, fitted = images.columns, images.fit, images.fitted
    words = columns["status"].astype(str)
    good = [LIMITED, OPTIMAL if fit.is_program or fit.is_global else CONVERGED]
    right = np.where(fitted, np.isin(words, good), np.isin(words, WITHOUT_SHAPE))
    everyone = np.ones_like(fitted)
    checks.hold("status is one of the method", right, of=everyone)
    whole = np.isfinite(columns["shapes"]).all(axis=(1, 2))
    empty = np.asarray(np.isnan(columns["shapes"]).all(axis=(1, 2)))
    empty &= columns.get("transform_count", np.zeros(len(empty))) == 0
    checks.hold("a shape is whole or absent", np.where(fitted, whole, empty), of=everyone)
    scale = columns["scale"]
    checks.hold("scale is above 0", (scale > 0) & (scale < np.inf), of=~np.isnan(scale))
    claim = "an image without a shape has degenerate landmarks"
    holds = np.ones_like(fitted)
    holds[~fitted] = are_degenerate(columns, ~fitted, dependent)
    checks.hold(claim, holds, of=~fitted)


def are_degenerate(columns: Columns, rows: Flags, dependent: Flags) -> Flags:
    """Whether no method could lift the landmarks of these rows.

    Those are fewer than 3 visible ones, or ones on a line, or of sizes whose squares float64 does
    not hold.
    """
    visible = (seen_in(columns) & ~dependent)[rows]
    points = np.where(visible[:, None], columns["landmarks"][rows], 0.0)
    count = visible.sum(axis=1)
    size = np.abs(points).max(axis=(1, 2), initial=0.0)
    points = points / np.where(size > 0, size, 1.0)[:, None, None]
    centred = points - (points.sum(axis=2) / np.maximum(count, 1)[:, None])[..., None]
    centred = np.where(visible[:, None], centred, 0.0)
    extent = np.minimum(size, LARGEST) * np.abs(centred).max(axis=(1, 2), initial=0.0)
    s = np.linalg.svd(centred, compute_uv=False)
    flat = (s[:, 1] <= FLAT * s[:, 0]) | (s[:, 0] == 0)
    return np.asarray((count < FEWEST) | flat | (size > LARGEST) | (extent < SMALLEST))


def check_lambda(images: Images, unit: float, checks: Checks) -> None:
    """Check that lambda is the one of the config; where that is `auto`, that it follows from it.

    Then it is noise / size E max_i ||G B_i^T||_* sqrt(visible share), the expectation `unit` over
    seeded draws of centred noise G, in bounds. Where atoms are left out it has to be above 0 only.
    """
    fit, lam = images.fit, images.lam
    stated = 1.0 if fit.loss == "exact" else fit.key("lambda")
    if stated != "auto":
        checks.equal("lambda", "lambda is that of the config", float(stated) + 0 * lam, 0.0)
    elif fit.left_out:
        checks.hold("lambda is above 0", lam > 0)
    else:
        share = np.sqrt((images.weights > 0).mean(axis=1))
        found = np.clip(fit.key("noise", 0.0) / images.size * unit * share, LEAST, MOST)
        allowed = images.allow(3 * (1 + images.extent / images.size), 1.0) * found
        checks.equal("lambda", "lambda follows from the noise", found, allowed)


def draw_noise(landmarks: int) -> Floats:
    """Seeded draws (DRAWS, 2, p) of centred noise, of which `lambda: auto` takes the mean."""
    G = np.random.default_rng(SEED).standard_normal((DRAWS, 2, landmarks))
    return np.asarray(G - G.mean(axis=-1, keepdims=True))


def check_left_out(
    images: Images, items: Sequence[str], atom_items: Sequence[str], checks: Checks
) -> Flags:
    """Check which item each image did without; returns the atoms (n, k) that it could use."""
    columns, dataset, known = images.columns, images.fit.left_out, np.array(atom_items, dtype=str)
    renamed = f"input_{dataset}"
    named = items if dataset == "item" else columns.get(renamed, columns.get(dataset, items))
    shown = np.array(named).astype(str)
    stated = columns["left_out"].astype(str)
    same = stated == np.where(np.isin(shown, known), shown, "")
    checks.hold("left_out is the item that the image shows", same, "left_out")
    return np.asarray(stated[:, None] != known)
