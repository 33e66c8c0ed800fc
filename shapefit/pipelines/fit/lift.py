"""From the landmarks of images to their shapes, by the steps that a Lifter names.

Weigh the landmarks, set outliers aside, lift by the method, refine as the camera sees it; then
whole sequences.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial
from hashlib import blake2b
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Flags, Floats
from shapefit.convex.problem import Loss
from shapefit.convex.solver import solve_newton
from shapefit.core import IMAGES_PER_BLOCK
from shapefit.dictionary.mixture import widen
from shapefit.dictionary.model import Dictionary
from shapefit.errors import input_error
from shapefit.io import LandmarkSet
from shapefit.io.layout import LANDMARK_COVARIANCE
from shapefit.lifting.degeneracy import BEYOND_CHANCE, find_degenerate
from shapefit.lifting.lift import BETA, Lifting, Program, fail_nonfinite, lift
from shapefit.lifting.methods import (
    METHODS,
    MIN_CONFIDENCE,
    AlternationOptions,
    Method,
    PosteriorOptions,
    Settings,
    choose_method,
)
from shapefit.lifting.trust import SIDES, cover_mirror_image
from shapefit.pipelines.fit.camera import IMAGE_SIZE, Intrinsics, find_camera
from shapefit.pipelines.items import named_items
from shapefit.threads import on_threads

if TYPE_CHECKING:
    from shapefit.config import FitConfig
    from shapefit.pipelines.fit.prepare import Setup

RANSAC_THRESHOLD, DRAWS, MAX_ROUNDS = 0.25, 500, 100
"""Of the search for outliers: residual beyond which a landmark is one, in units of the size of the
shape; triples drawn per image (2,000 change no figure of the cars); rounds per image."""

BORDER = 0.01
"""Share of the image's width and height: landmarks so near to a side of it, neighbours together,
are where a detector leaves what it does not see."""

LEAVE_ONE_OUT = "leave_one_out"


@dataclass(frozen=True, kw_only=True)
class Lifter:
    """A method and all that it needs beside the images.

    camera is None for weak perspective; posterior, the model of methods with a prior, whose
    `residual_variance` is that of the dictionary where None is given here; noise is the standard
    deviation of a landmark's coordinate; growth and covariances of the result, see
    PosteriorOptions. tolerance None is that of the method. leave_one_out names the dataset of the
    atoms that the fit of an image does without; threads 0 is one per core.
    """

    method: str
    dictionary: Dictionary
    camera: Intrinsics | None = None
    program: Program = field(default_factory=lambda: Program(0.1))
    noise: float | None = None
    tolerance: float | None = None
    residual_variance: float | None = None
    posterior: PosteriorOptions = field(default_factory=PosteriorOptions)
    prior_scale: float = 1.0
    image_size: tuple[float, float] | None = None
    min_confidence: float | None = None
    signed: bool = False
    outlier_threshold: float | None = None
    leave_one_out: str | None = None
    frame_rate: float | None = None
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
    threshold = config.outlier_threshold or RANSAC_THRESHOLD
    return Lifter(
        method=config.method,
        dictionary=dictionary,
        camera=Intrinsics.of(config.camera),
        program=Program(
            lam=None if config.lam == "auto" else config.lam,
            loss=Loss(config.loss),
            beta=config.outlier_threshold or BETA,
            noise=config.noise or 0.0,
        ),
        noise=config.noise,
        tolerance=config.solver_tolerance,
        residual_variance=config.prior.residual_variance,
        posterior=PosteriorOptions(
            bar_scale=config.prior.bar_scale, covariance=config.save.covariance
        ),
        prior_scale=config.prior.scale or 1.0,
        image_size=config.image_size,
        min_confidence=config.min_confidence,
        signed=config.signed,
        outlier_threshold=threshold if config.searches_outliers else None,
        leave_one_out=config.leave_one_out,
        frame_rate=config.frame_rate,
        threads=config.threads,
    )


def settings_of(lifter: Lifter) -> Settings:
    """Return what the method needs besides the problem.

    Where its tolerance is that of another gap, the convex program is solved at its own default.
    """
    method, dictionary = lifter.row, lifter.dictionary
    tolerance = method.tolerance if lifter.tolerance is None else lifter.tolerance
    of_program = min(tolerance, METHODS["convex"].tolerance)
    needs = {need.name: getattr(dictionary, need.name) for need in method.needs}
    options: Any = None if method.options is None else method.options()
    if isinstance(options, AlternationOptions):
        options = replace(options, signed=lifter.signed)
    if method.has_prior:
        from shapefit.lifting.posterior.p_value import moments_at

        scale, table = lifter.prior_scale, dictionary.p_value_table
        options = replace(lifter.posterior, residual_variance=lifter.variance)
        needs["prior"] = widen(needs["prior"], scale)
        needs["p_value_table"] = None if table is None else moments_at(table, scale)
    return Settings(
        solve=partial(
            solve_newton,
            tolerance=of_program if method.proves == "global" else tolerance,
            threads=lifter.threads,
        ),
        mean_shape=dictionary.mean_shape,
        needs=needs,
        options=options,
        tolerance=tolerance,
        threads=lifter.threads,
    )


def check_needs(method: str, dictionary: Dictionary, place: str | Path) -> None:
    """Raise InputError where the dictionary lacks what the method needs, or it is of no use."""
    for need in METHODS[method].needs:
        missing = getattr(dictionary, need.name) is None
        found = f"no `{need.name}`" if missing else need.useless(dictionary)
        if found:
            raise input_error(place, f"{found}: {need.what}", need.fix)


def lift_batch(images: LandmarkSet, setup: Setup) -> tuple[Lifting, dict[str, NDArray[Any]]]:
    """Lift images that have the landmarks of the dictionary.

    Returns the lifting of the joints, and the landmarks of the files in 3D as datasets, where they
    are not those of the dictionary.
    """
    lifter, sides = setup.lifter, None
    if lifter.row.sequences:
        from shapefit.pipelines.fit.sequences import restore_sides

        sides = restore_sides(images, weigh(images, lifter) > 0, lifter)
        images = sides.images
    lifting = lift_landmarks(images, lifter)
    estimate = lifting.estimate
    if sides is not None:
        exchanged = np.where(sides.unsure, np.nan, sides.exchanged)
        estimate = replace(estimate, further={**estimate.further, SIDES: exchanged})
    if setup.dictionary.depth_ambiguity:
        estimate = cover_mirror_image(estimate)
    visible = weigh(images, lifter) > 0
    return setup.mapped.back(replace(lifting, estimate=estimate), images.landmarks, visible)


def lift_landmarks(images: LandmarkSet, lifter: Lifter, *, p_values: bool = True) -> Lifting:
    """Lift images with the landmarks of a dictionary, then whole sequences of them.

    Raises InputError where the images lack what the lifter names.
    """
    lift_all = lift_images if lifter.leave_one_out is None else lift_omitting
    lifting = lift_all(images, lifter)
    if lifter.row.has_prior and p_values:
        lifting = with_p_values(lifting, lifter)
    if lifter.row.sequences:
        from shapefit.pipelines.fit.sequences import refine_sequences

        lifting = refine_sequences(lifting, images, lifter)
    return fail_nonfinite(lifting)


def lift_images(images: LandmarkSet, lifter: Lifter) -> Lifting:
    """Lift images one by one; with a prior, landmarks that depend on another one do not count."""
    method, dictionary = lifter.row, lifter.dictionary
    visible = weights = weigh(images, lifter)
    if method.has_prior:
        visible = weights = np.where(dictionary.depends_on >= 0, 0.0, weights)
    searches = lifter.outlier_threshold is not None
    if searches:
        inliers, lost = find_inliers(images, weights, lifter)
        weights = np.where(inliers, weights, 0.0)
    camera = None if lifter.camera is None else find_camera(images, lifter.camera)
    lifting = lift(
        images.landmarks,
        weights,
        dictionary.atoms,
        lifter.program,
        choose_method(lifter.method, settings_of(lifter)),
        find_covariance(images) if method.precisions else None,
        camera if method.perspective == "own" else None,
    )
    if searches:
        labelled = replace(lifting.estimate, outliers=(visible > 0) & ~inliers)
        lifting = replace(lifting, estimate=labelled, failures={**lifting.failures, **lost})
    if camera is not None and method.perspective == "refined":
        from shapefit.lifting.perspective import PerspectiveOptions, refine_view

        options = PerspectiveOptions(threads=lifter.threads)
        lifting = refine_view(lifting, images.landmarks, camera, dictionary, options)
    return lifting


def with_p_values(lifting: Lifting, lifter: Lifter) -> Lifting:
    """Add p-values and start distances of images that were lifted with a prior."""
    from shapefit.lifting.posterior.method import with_p_value

    estimate = with_p_value(lifting.estimate, lifting.problem, settings_of(lifter))
    return replace(lifting, estimate=estimate)


def weigh(images: LandmarkSet, lifter: Lifter) -> Floats:
    """Weights (n, p): the confidence, or with a prior 1 from `min_confidence` on, else 0.

    A score says how sure a detector is that a landmark is where it put it, not how exactly.
    Landmarks with covariances keep their confidences.
    """
    weights = images.weights()
    if not lifter.row.precisions or LANDMARK_COVARIANCE in images.columns:
        return weights
    least = MIN_CONFIDENCE if lifter.min_confidence is None else lifter.min_confidence
    visible = (weights > 0) & (weights >= least) & ~at_border(images, lifter)
    return visible.astype(np.float64)


def at_border(images: LandmarkSet, lifter: Lifter) -> Flags:
    """Which landmarks (n, p) lie within 1% of a side of the image, with a neighbour there, too."""
    edges, n, given = lifter.dictionary.edges, len(images), lifter.image_size
    size = np.asarray(images.columns.get(IMAGE_SIZE, 0.0) if given is None else given, float)
    marked = np.zeros(images.landmarks.shape[::2], dtype=bool)
    same_names = images.landmark_names == lifter.dictionary.landmark_names
    if edges is None or not same_names or size.shape not in ((2,), (n, 2)):
        return marked
    far = np.broadcast_to(size, (n, 2))[..., None]
    away = np.stack([abs(images.landmarks), abs(images.landmarks - far)], axis=1)
    near = np.asarray(away <= BORDER * far[:, None], dtype=bool).reshape(
        n, 4, len(images.landmark_names)
    )
    for edge in edges:
        together: Flags = np.asarray(np.any(near[..., edge].all(axis=2), axis=1))
        marked[:, edge] |= together[:, None]
    return marked


def find_covariance(images: LandmarkSet) -> Floats | None:
    """Return the covariance (n, p, 2, 2) of the landmarks that came with them, if it did.

    Raises InputError where the dataset holds no covariances.
    """
    values = images.columns.get(LANDMARK_COVARIANCE)
    if values is None:
        return None
    shape = (len(images), len(images.landmark_names), 2, 2)
    fine, covariance = np.shape(values) == shape, np.empty(0)
    if fine:
        covariance = np.where(images.visible()[..., None, None], values, 0.0).astype(np.float64)
        fine = bool(np.isfinite(covariance).all() and (covariance == covariance.mT).all())
    if fine and (np.linalg.eigvalsh(covariance) >= -1e-9 * abs(covariance).max(initial=0)).all():
        return covariance
    found = f"has the shape {np.shape(values)}, or holds a matrix that is no covariance"
    fix = f"give {shape}: for each landmark a symmetric, positive semi-definite matrix"
    raise input_error(LANDMARK_COVARIANCE, found, fix)


def find_inliers(
    images: LandmarkSet, weights: Floats, lifter: Lifter
) -> tuple[Flags, dict[int, str]]:
    """Find the inliers (n, p); the others are lifted with weight 0, as if they were hidden.

    An image with fewer than BEYOND_CHANCE inliers, or all on one line, is lost, with a reason.
    One with no more visible landmarks, or degenerate ones, is not searched. The draws of an image
    depend on the name of its item alone.
    """
    from shapefit.lifting.consensus import find_consensus

    seeds = [blake2b(f"0 {item}".encode(), digest_size=8).digest() for item in images.items]
    visible = weights > 0
    searched = visible.sum(axis=1) >= BEYOND_CHANCE
    searched[list(find_degenerate(images.landmarks, weights))] = False
    inliers = find_consensus(
        images.landmarks,
        np.where(searched[:, None], weights, 0.0),
        lifter.dictionary.mean_shape,
        np.frombuffer(b"".join(seeds), dtype="<u8").astype(np.uint64),
        threshold=lifter.outlier_threshold or RANSAC_THRESHOLD,
        draws=DRAWS,
        max_rounds=MAX_ROUNDS,
        threads=lifter.threads,
    )
    inliers = np.where(searched[:, None], inliers, True) & visible
    agree = inliers.sum(axis=1)
    enough = np.where((agree < BEYOND_CHANCE)[:, None], 0.0, inliers)
    lost = [image for image in find_degenerate(images.landmarks, enough) if searched[image]]
    inliers[lost] = False
    return inliers, {
        image: f"only {agree[image]} of {visible[image].sum()} visible landmarks agree with "
        f"each other; the minimum is {BEYOND_CHANCE}, not all on one line"
        for image in lost
    }


def lift_omitting(images: LandmarkSet, lifter: Lifter) -> Lifting:
    """Lift each image without the atoms of the item that the dataset `leave_one_out` names.

    Images of an item that the dictionary does not have are lifted with all atoms. The lifting has
    the columns of the whole dictionary, 0 for atoms left out. Raises InputError where the images
    lack the dataset.
    """
    from shapefit.lifting.lift import Group, merge

    dictionary = lifter.dictionary
    items = find_omitted(images, lifter)

    def lift_group(rows: NDArray[np.intp], threads: int = 1) -> Group:
        item = str(items[rows[0]])
        without = dictionary.without(item) if item else dictionary
        lifting = lift_images(
            images.take(rows), replace(lifter, dictionary=without, threads=threads)
        )
        return Group(lifting, rows, np.flatnonzero(dictionary.atoms_without(item)))

    groups = [np.flatnonzero(items == item) for item in dict.fromkeys(items.tolist())]
    # the solvers have work for several threads where there is more than a stretch of images
    lifted = [lift_group(rows, lifter.threads) for rows in groups if len(rows) > IMAGES_PER_BLOCK]
    small = [rows for rows in groups if len(rows) <= IMAGES_PER_BLOCK]
    lifted += on_threads(lift_group, small, lifter.threads)
    return merge(lifted, dictionary.atoms) if lifted else lift_images(images, lifter)


def find_omitted(images: LandmarkSet, lifter: Lifter) -> NDArray[np.str_]:
    """Return the item (n,) whose atoms the fit of each image does without, '' for none."""
    items, in_dictionary = find_items(images, lifter)
    items[~in_dictionary] = ""
    return items


def find_items(images: LandmarkSet, lifter: Lifter) -> tuple[NDArray[np.str_], Flags]:
    """Return the item (n,) that each image shows, and whether atoms are of it (n,)."""
    name = lifter.leave_one_out or ""
    items = np.array(named_items(images, name, LEAVE_ONE_OUT, LEAVE_ONE_OUT), dtype=str)
    return items, np.isin(items, np.array(lifter.dictionary.atom_items, dtype=str))


def check_items(dictionary: Dictionary) -> None:
    """Raise InputError where the atoms of a dictionary are not of several items."""
    items = set(dictionary.atom_items or ())
    if len(items) < 2:
        found = f"the atoms of the dictionary are of {len(items) or 'no'} items"
        fix = f"learn it from several models with `method: exemplars`, or remove `{LEAVE_ONE_OUT}`"
        raise input_error(LEAVE_ONE_OUT, found, fix)
