"""Lifting single images: a method with all that it needs, and what it makes of
landmarks.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from functools import partial
from hashlib import blake2b
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Flags, Floats
from shapefit.convex.problem import Loss
from shapefit.convex.solver import solve_newton
from shapefit.dictionary.mixture import widen
from shapefit.dictionary.model import Dictionary
from shapefit.errors import input_error
from shapefit.geometry.pinhole import Camera
from shapefit.lifting.degeneracy import BEYOND_CHANCE, find_degenerate
from shapefit.lifting.lift import BETA, Group, Lifting, Program, lift, merge
from shapefit.lifting.methods import (
    METHODS,
    MIN_CONFIDENCE,
    ROBUST,
    STARTS,
    Method,
    PosteriorOptions,
    Settings,
    choose_method,
)
from shapefit.pipelines.fit.camera import IMAGE_SIZE, camera_of
from shapefit.pipelines.items import named_items
from shapefit.records import Landmarks
from shapefit.threads import on_threads

if TYPE_CHECKING:
    from shapefit.config import FitConfig

RANSAC_THRESHOLD = 0.25
"""Residual of an outlier in units of the size of the shape."""

DRAWS, MAX_ROUNDS = 500, 100
"""Of the search for outliers: triples drawn per image (2,000 change no figure of the
cars), and rounds per image.
"""

BORDER = 0.01
"""Share of the image's size: so near to a side of it a detector leaves what it does not
see.
"""

LEAVE_ONE_OUT = "leave_one_out"


@dataclass(frozen=True, kw_only=True)
class Lifter:
    """A method and all that it needs beside the images; None stands for its own
    default.

    camera is None for weak perspective; leave_one_out names the dataset of the atoms to
    do without; shown (p,), the landmarks that the files show, whose errors are expected
    ones.
    """

    method: str
    dictionary: Dictionary
    camera: Callable[[Landmarks], Camera] | None = None
    program: Program = field(default_factory=lambda: Program(0.1))
    noise: float | None = None
    tolerance: float | None = None
    residual_variance: float | None = None
    posterior: PosteriorOptions = field(default_factory=PosteriorOptions)
    prior_scale: float = 1.0
    image_size: tuple[float, float] | None = None
    min_confidence: float | None = None
    signed: bool = False
    starts: int = STARTS
    outlier_threshold: float | None = None
    leave_one_out: str | None = None
    frame_rate: float | None = None
    shown: Flags | None = None
    threads: int = 0

    @property
    def row(self) -> Method:
        """The row of the table of methods."""
        return METHODS[self.method]

    @property
    def variance(self) -> float:
        """The residual variance: as given, of the dictionary, or the default."""
        learned = self.dictionary.residual_variance
        if self.residual_variance is not None or learned is None:
            return self.residual_variance or self.posterior.residual_variance
        return float(learned[0])


def lifter_of(config: FitConfig, dictionary: Dictionary) -> Lifter:
    """Return what lifts landmarks of a dictionary as a config says."""
    names = (field.name for field in fields(Lifter) if hasattr(config, field.name))
    shared: dict[str, Any] = {name: getattr(config, name) for name in names}
    lam, prior = None if config.lam == "auto" else config.lam, config.prior
    beta, noise = config.outlier_threshold or BETA, config.noise or 0.0
    threshold = config.outlier_threshold or RANSAC_THRESHOLD
    loss = Loss(config.outliers) if config.outliers in ROBUST else Loss.SQUARED
    chosen = {
        "dictionary": dictionary,
        "camera": camera_of(config.camera),
        "program": Program(lam, loss, beta, noise),
        "residual_variance": prior.residual_variance,
        "posterior": PosteriorOptions(
            bar_scale=prior.bar_scale, covariance=config.save.covariance
        ),
        "prior_scale": prior.scale or 1.0,
        "outlier_threshold": threshold if config.outliers == "ransac" else None,
    }
    return Lifter(**shared | chosen)


def settings_of(lifter: Lifter) -> Settings:
    """Return what the method needs besides the problem."""
    method, dictionary = lifter.row, lifter.dictionary
    of_program = tolerance = (
        method.tolerance if lifter.tolerance is None else lifter.tolerance
    )
    if method.proves == "global":  # by another gap
        of_program = min(tolerance, METHODS["convex"].tolerance)
    needs = {need.name: getattr(dictionary, need.name) for need in method.needs}
    if method.has_prior:
        from shapefit.lifting.posterior.p_value import moments_at

        scale, table = lifter.prior_scale, dictionary.p_value_table
        needs["prior"] = widen(needs["prior"], scale)
        needs["p_value_table"] = None if table is None else moments_at(table, scale)
    return Settings(
        solve=partial(solve_newton, tolerance=of_program, threads=lifter.threads),
        mean_shape=dictionary.mean_shape,
        needs=needs,
        signed=lifter.signed,
        starts=lifter.starts,
        posterior=replace(lifter.posterior, residual_variance=lifter.variance),
        tolerance=tolerance,
        threads=lifter.threads,
    )


def check_needs(method: str, dictionary: Dictionary, place: str | Path) -> None:
    """Raise InputError where the dictionary lacks what the method needs, or it is of no
    use.
    """
    for need in METHODS[method].needs:
        missing = getattr(dictionary, need.name) is None
        fault = f"no `{need.name}`" if missing else need.useless(dictionary)
        if fault:
            raise input_error(place, f"{fault}: {need.what}", need.fix)


def lift_images(images: Landmarks, lifter: Lifter) -> Lifting:
    """Lift images one by one; with a prior, landmarks that depend on another one do not
    count.
    """
    method, dictionary = lifter.row, lifter.dictionary
    visible = weights = weigh(images, lifter)
    if method.has_prior:
        visible = weights = np.where(dictionary.depends_on >= 0, 0.0, weights)
    searches = lifter.outlier_threshold is not None
    if searches:
        inliers, lost = find_inliers(images, weights, lifter)
        weights = np.where(inliers, weights, 0.0)
    camera = None if lifter.camera is None else lifter.camera(images)
    w = images.as_columns()
    lifting = lift(
        w,
        weights,
        dictionary.atoms,
        lifter.program,
        choose_method(lifter.method, settings_of(lifter)),
        camera if method.perspective == "own" else None,
    )
    if searches:
        labelled = replace(lifting.estimate, outliers=(visible > 0) & ~inliers)
        lifting = replace(
            lifting, estimate=labelled, failures={**lifting.failures, **lost}
        )
    if camera is not None and method.perspective == "refined":
        from shapefit.lifting.perspective import refine_view

        lifting = refine_view(lifting, w, camera, dictionary, lifter.threads)
    return lifting


def with_p_values(lifting: Lifting, lifter: Lifter) -> Lifting:
    """Add p-values and start distances of images that were lifted with a prior."""
    from shapefit.lifting.posterior.method import with_p_value

    estimate = with_p_value(lifting.estimate, lifting.problem, settings_of(lifter))
    return replace(lifting, estimate=estimate)


def weigh(images: Landmarks, lifter: Lifter) -> Floats:
    """Weights (n, p): the confidence; with a prior, that does not count, 1 from a least
    one on.
    """
    weights = images.weights()
    if not lifter.row.precisions:
        return weights
    least = MIN_CONFIDENCE if lifter.min_confidence is None else lifter.min_confidence
    visible = (weights > 0) & (weights >= least) & ~at_border(images, lifter)
    return visible.astype(np.float64)


def at_border(images: Landmarks, lifter: Lifter) -> Flags:
    """Which landmarks (n, p) lie within 1% of a side of the image, with a neighbour
    there, too.
    """
    edges, n, p = lifter.dictionary.edges, len(images), len(images.landmark_names)
    given = lifter.image_size
    if given is None:
        stated = images.column(IMAGE_SIZE)
        size = np.asarray(0.0 if stated is None else stated, float)
    else:
        size = np.asarray(given, float)
    marked = np.zeros((n, p), dtype=bool)
    same_names = tuple(images.landmark_names) == lifter.dictionary.landmark_names
    if edges is None or not same_names or size.shape not in ((2,), (n, 2)):
        return marked
    far = np.broadcast_to(size, (n, 2))[..., None]
    w = images.as_columns()
    distance = np.stack([abs(w), abs(w - far)], axis=1)
    near = (distance <= BORDER * far[:, None]).reshape(n, 4, p)
    for edge in edges:
        marked[:, edge] |= np.any(np.all(near[..., edge], axis=2), axis=1)[:, None]
    return marked


def find_inliers(
    images: Landmarks, weights: Floats, lifter: Lifter
) -> tuple[Flags, dict[int, str]]:
    """Find the inliers (n, p), by draws that depend on the name of an item; and images
    without.

    Images with fewer than BEYOND_CHANCE landmarks, or degenerate ones, are not
    searched.
    """
    from shapefit.lifting.consensus import find_consensus

    assert lifter.outlier_threshold is not None
    seeds = [
        blake2b(f"0 {item}".encode(), digest_size=8).digest() for item in images.items
    ]
    visible = weights > 0
    searched = visible.sum(axis=1) >= BEYOND_CHANCE
    w = images.as_columns()
    searched[list(find_degenerate(w, weights))] = False
    inliers = find_consensus(
        w,
        np.where(searched[:, None], weights, 0.0),
        lifter.dictionary.mean_shape,
        np.frombuffer(b"".join(seeds), dtype="<u8").astype(np.uint64),
        threshold=lifter.outlier_threshold,
        draws=DRAWS,
        max_rounds=MAX_ROUNDS,
        threads=lifter.threads,
    )
    inliers = np.where(searched[:, None], inliers, True) & visible
    enough = np.where((inliers.sum(axis=1) < BEYOND_CHANCE)[:, None], 0.0, inliers)
    lost = [image for image in find_degenerate(w, enough) if searched[image]]
    inliers[lost] = False
    reason = f"fewer than {BEYOND_CHANCE} visible landmarks, not all on one line, agree"
    return inliers, dict.fromkeys(lost, reason)


def lift_omitting(images: Landmarks, lifter: Lifter) -> Lifting:
    """Lift each image without the atoms of its item, whose coefficients are 0."""
    dictionary, items = lifter.dictionary, find_omitted(images, lifter)

    def lift_group(item: str) -> Group:
        without = dictionary.without(item) if item else dictionary
        rows, one = (
            np.flatnonzero(items == item),
            replace(lifter, dictionary=without, threads=1),
        )
        atoms = np.flatnonzero(dictionary.atoms_without(item))
        return Group(lift_images(images.take(rows), one), rows, atoms)

    groups = on_threads(lift_group, dict.fromkeys(items.tolist()), lifter.threads)
    return merge(groups, dictionary.atoms) if groups else lift_images(images, lifter)


def find_omitted(images: Landmarks, lifter: Lifter) -> NDArray[np.str_]:
    """Return the item (n,) whose atoms the fit of each image does without, '' for
    none.
    """
    name = lifter.leave_one_out or ""
    items = np.array(named_items(images, name, LEAVE_ONE_OUT, LEAVE_ONE_OUT), dtype=str)
    return np.where(np.isin(items, lifter.dictionary.atom_items or ()), items, "")


def check_omitted(images: Landmarks, lifter: Lifter) -> None:
    """Raise InputError where no image shows an item of the dictionary, or it has but
    one.
    """
    items = [*dict.fromkeys(lifter.dictionary.atom_items or ())]
    if len(items) < 2:
        fault = f"the atoms of the dictionary are of {len(items) or 'no'} items"
        fix = (
            "learn it from several models with `method: exemplars`, or remove"
            f" `{LEAVE_ONE_OUT}`"
        )
        raise input_error(LEAVE_ONE_OUT, fault, fix)
    if len(images) and not (find_omitted(images, lifter) != "").any():
        fix = f"name the dataset that holds them, such as {', '.join(items[:3])}"
        raise input_error(
            LEAVE_ONE_OUT, "the images show no items of the dictionary", fix
        )
