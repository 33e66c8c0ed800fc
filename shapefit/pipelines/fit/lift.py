"""From the landmarks of a batch of images to their shapes, by the steps that a Lifter names.

Weigh the landmarks, set outliers aside, lift by the method, refine as the camera sees it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from hashlib import blake2b
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Flags, Floats
from shapefit.convex.problem import Loss
from shapefit.convex.solver import solve_newton
from shapefit.core import STRETCH
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
from shapefit.lifting.verdict import SIDES, cover_mirror_image
from shapefit.pipelines.fit.camera import IMAGE_SIZE, Intrinsics, find_camera
from shapefit.pipelines.items import named_items
from shapefit.threads import on_threads

if TYPE_CHECKING:
    from shapefit.config import FitConfig
    from shapefit.pipelines.fit.prepare import Setup

MAX_ROUNDS = 100
"""Of fitting and judging landmarks again, per image; they settle after a few."""

DRAWS = 500
"""Triples of landmarks drawn per image; 2,000 change no figure of the cars."""

RANSAC_THRESHOLD = 0.25
"""Residual beyond which RANSAC rejects a landmark, in units of the size of the shape."""

LEAVE_ONE_OUT = "leave_one_out"

BORDER = 0.01
"""Of width and height of an image: a landmark so near to a side of it, and its neighbour, are where
a detector leaves what it does not see."""


PROGRAM = Program(0.1)
"""The convex program with its usual lambda."""


@dataclass(frozen=True, kw_only=True)
class Lifter:
    """A method and all that it needs beside the images.

    method             its name, see METHODS
    dictionary         of the landmarks that the images have
    intrinsics         where the camera is known from; None: weak perspective
    program            the convex program
    noise              standard deviation of a landmark's coordinate; None: not known
    tolerance          relative gap at which an image is solved; None: that of the method
    residual_variance  of a normalised coordinate; None: that of the dictionary, or the default
    prior_scale        factor on the covariances of the prior
    bar_scale          factor on those of the result
    growth             (p,) further factors by landmark, see `calibration`; empty: none
    image_size         width and height of the images, where the config says them
    covariance         whether that of all landmarks together is wanted
    min_confidence     below which a method with a prior hides a landmark
    signed             coefficients of either sign
    outlier_threshold  of a search for outliers by RANSAC before the fit; None: there is none
    leave_one_out      dataset of the images that names the atoms which their fit does without
    frame_rate         of sequences; None: as the images say
    bone_lengths       (e,) of the edges, for sequences, where they are known
    threads            0 is one per core
    """

    method: str
    dictionary: Dictionary
    intrinsics: Intrinsics | None = None
    program: Program = PROGRAM
    noise: float | None = None
    tolerance: float | None = None
    residual_variance: float | None = None
    prior_scale: float = 1.0
    bar_scale: float = PosteriorOptions.widening
    growth: tuple[float, ...] = ()
    image_size: tuple[float, float] | None = None
    covariance: bool = False
    min_confidence: float | None = None
    signed: bool = False
    outlier_threshold: float | None = None
    leave_one_out: str | None = None
    frame_rate: float | None = None
    bone_lengths: Floats | None = None
    threads: int = 0

    @property
    def known(self) -> Method:
        """The row of the table of methods."""
        return METHODS[self.method]

    @property
    def variance(self) -> float:
        """The residual variance, as given, or of the dictionary, or the default."""
        if self.residual_variance is not None:
            return self.residual_variance
        learned = self.dictionary.residual_variance
        return PosteriorOptions.residual_variance if learned is None else float(learned[0])


def lifter_of(config: FitConfig, dictionary: Dictionary, lengths: Floats | None = None) -> Lifter:
    """Return what lifts landmarks of a dictionary as a config says."""
    return Lifter(
        method=config.method,
        dictionary=dictionary,
        intrinsics=Intrinsics.of(config.camera),
        program=Program(
            lam=None if config.lam == "auto" else config.lam,
            loss=Loss(config.loss),
            beta=config.outlier_threshold or BETA,
            noise=config.noise or 0.0,
        ),
        noise=config.noise,
        tolerance=config.solver_tolerance,
        residual_variance=config.prior.residual_variance,
        prior_scale=config.prior.scale or 1.0,
        bar_scale=config.prior.bar_scale,
        image_size=config.image_size,
        covariance=config.save.covariance,
        min_confidence=config.min_confidence,
        signed=config.signed,
        outlier_threshold=(
            (config.outlier_threshold or RANSAC_THRESHOLD) if config.searches_outliers else None
        ),
        leave_one_out=config.leave_one_out,
        frame_rate=config.frame_rate,
        bone_lengths=lengths,
        threads=config.threads,
    )


def lift_batch(images: LandmarkSet, setup: Setup) -> tuple[Lifting, dict[str, NDArray[Any]]]:
    """Lift images that have the landmarks of the dictionary, as `read_images` gives them.

    Returns the lifting of the joints, and the landmarks of the files in 3D as datasets, where they
    are not those of the dictionary.
    """
    sides = None
    if setup.lifter.known.sequences:
        from shapefit.pipelines.fit.sequences import put_back_sides

        seen, partner = weigh(images, setup.lifter) > 0, setup.dictionary.mirror_index
        sides = put_back_sides(images, seen, partner, setup.lifter.frame_rate)
        images = sides.images
    lifting = lift_landmarks(images, setup.lifter)
    if sides is not None:
        known = {SIDES: np.where(sides.unsure, np.nan, sides.exchanged)}
        further = {**lifting.estimate.further, **known}
        lifting = replace(lifting, estimate=replace(lifting.estimate, further=further))
    if setup.dictionary.depth_ambiguity:
        lifting = replace(lifting, estimate=cover_mirror_image(lifting.estimate))
    return setup.mapped.back(lifting, images.landmarks, weigh(images, setup.lifter) > 0)


def lift_landmarks(images: LandmarkSet, lifter: Lifter) -> Lifting:
    """Lift images with the landmarks of a dictionary, then whole sequences of them.

    Raises InputError where the images lack what the lifter names.
    """
    of_each = lift_images if lifter.leave_one_out is None else lift_left_out
    lifting = of_each(images, lifter)
    if lifter.known.has_prior:
        lifting = with_p_values(lifting, lifter)
    if lifter.known.sequences:
        from shapefit.pipelines.fit.sequences import refine_sequences

        lifting = refine_sequences(lifting, images, lifter)
    return fail_nonfinite(lifting)


def load_steps(lifter: Lifter) -> None:
    """Import what is needed, before the clock of solving starts."""
    lifter.known.load()
    if lifter.intrinsics is not None and lifter.known.perspective == "refined":
        import shapefit.lifting.perspective.view
    if lifter.outlier_threshold is not None:
        import shapefit.lifting.consensus
    if lifter.leave_one_out is not None:
        import concurrent.futures.thread  # noqa: F401

        import shapefit.lifting.merging  # noqa: F401


def lift_images(images: LandmarkSet, lifter: Lifter, *, dependent: bool = False) -> Lifting:
    """Lift images one by one; dependent landmarks, as those of feet, count only if asked for."""
    method, dictionary, lost = lifter.known, lifter.dictionary, dict[int, str]()
    visible = weights = weigh(images, lifter)
    if method.has_prior and not dependent:
        visible = weights = np.where(dictionary.depends_on >= 0, 0.0, weights)
    searches = lifter.outlier_threshold is not None
    if searches:
        inliers, lost = find_inliers(images, weights, lifter)
        weights = np.where(inliers, weights, 0.0)
    camera = None if lifter.intrinsics is None else find_camera(images, lifter.intrinsics)
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
        from shapefit.lifting.perspective.view import PerspectiveOptions, refine_view

        options = PerspectiveOptions(threads=lifter.threads)
        lifting = refine_view(lifting, images.landmarks, camera, dictionary, options)
    return lifting


def with_p_values(lifting: Lifting, lifter: Lifter) -> Lifting:
    """Say how plausible images are that were lifted with the prior of the dictionary."""
    from shapefit.lifting.posterior.method import with_p_value

    found = with_p_value(lifting.estimate, lifting.problem, settings_of(lifter))
    return replace(lifting, estimate=found)


def check_needs(method: str, dictionary: Dictionary, place: str | Path) -> None:
    """Raise InputError where the dictionary lacks what the method needs, or it is of no use."""
    for need in METHODS[method].needs:
        missing = getattr(dictionary, need.name) is None
        found = f"no `{need.name}`" if missing else need.useless(dictionary)
        if found:
            raise input_error(place, f"{found}: {need.what}", need.fix)


def settings_of(lifter: Lifter) -> Settings:
    """Return what the method needs besides the problem.

    Where its tolerance is that of another gap, the convex program is solved at its own default.
    """
    method, dictionary = lifter.known, lifter.dictionary
    tolerance = method.tolerance if lifter.tolerance is None else lifter.tolerance
    options: Any = None if method.options is None else method.options()
    if isinstance(options, AlternationOptions):
        options = replace(options, signed=lifter.signed)
    if isinstance(options, PosteriorOptions):
        options = replace(
            options,
            residual_variance=lifter.variance,
            widening=lifter.bar_scale,
            growth=lifter.growth,
            covariance=lifter.covariance,
        )
    needs = {need.name: getattr(dictionary, need.name) for need in method.needs}
    if method.has_prior:
        from shapefit.lifting.posterior.p_value import moments_at

        scale, table = lifter.prior_scale, dictionary.p_value_table
        needs["prior"] = widen(needs["prior"], scale)
        needs["p_value_table"] = None if table is None else moments_at(table, scale)
    own = min(tolerance, METHODS["convex"].tolerance) if method.proves == "global" else tolerance
    return Settings(
        solve=partial(solve_newton, tolerance=own, threads=lifter.threads),
        mean_shape=dictionary.mean_shape,
        needs=needs,
        options=options,
        tolerance=tolerance,
        threads=lifter.threads,
    )


def weigh(images: LandmarkSet, lifter: Lifter) -> Floats:
    """Weights (n, p): the confidence, or with a prior 1 from `min_confidence` on, else 0.

    A score says how sure a detector is that a landmark is where it found it, not how exactly.
    Landmarks with covariances keep their confidences.
    """
    weights, least = images.weights(), lifter.min_confidence
    if not lifter.known.precisions or LANDMARK_COVARIANCE in images.columns:
        return weights
    least = MIN_CONFIDENCE if least is None else least
    seen = (weights > 0) & (weights >= least) & ~at_border(images, lifter)
    return seen.astype(np.float64)


def at_border(images: LandmarkSet, lifter: Lifter) -> Flags:
    """Which landmarks (n, p) a detector has left at the border of the image: it does not see them.

    Those within 1% of a side of the image, of its length, with a neighbour there, too.
    """
    size = images.columns.get(IMAGE_SIZE) if lifter.image_size is None else lifter.image_size
    edges, none = lifter.dictionary.edges, np.zeros(images.landmarks.shape[::2], dtype=bool)
    if images.landmark_names != lifter.dictionary.landmark_names:
        return none  # of a file whose neighbours are not known
    if size is None or edges is None or np.shape(size) not in ((2,), (len(images), 2)):
        return none
    sides = np.stack([0 * np.asarray(size, float), size], axis=-1)  # (..., 2 coordinates, 2 sides)
    away = np.abs(
        images.landmarks[:, :, None] - np.broadcast_to(sides, (len(images), 2, 2))[..., None]
    )
    near = away <= BORDER * np.asarray(size)[..., None, None]
    together = near[..., edges[:, 0]] & near[..., edges[:, 1]]
    found = none
    for row, edge in enumerate(edges):
        found[:, edge] |= together[..., row].any(axis=(1, 2))[:, None]
    return found


def find_covariance(images: LandmarkSet) -> Floats | None:
    """Return the covariance (n, p, 2, 2) of the landmarks that came with them, if it did.

    Raises InputError where the dataset holds no covariances.
    """
    name = LANDMARK_COVARIANCE
    values = images.columns.get(name)
    if values is None:
        return None
    shape = (len(images), len(images.landmark_names), 2, 2)
    fix = "give each landmark a symmetric, positive semi-definite 2 x 2 matrix"
    if np.shape(values) != shape:
        raise input_error(name, f"has the shape {np.shape(values)}, not {shape}", fix)
    covariance = np.where(images.seen()[..., None, None], values, 0.0).astype(np.float64)
    if not np.isfinite(covariance).all() or (covariance != covariance.swapaxes(2, 3)).any():
        raise input_error(name, "holds what is no covariance", fix)
    if (np.linalg.eigvalsh(covariance) < -1e-9 * np.abs(covariance).max()).any():
        raise input_error(name, "holds a matrix with a negative variance", fix)
    return covariance


def find_inliers(
    images: LandmarkSet, weights: Floats, lifter: Lifter
) -> tuple[Flags, dict[int, str]]:
    """Find the inliers (n, p); the others are to be lifted with weight 0, as if they were hidden.

    Then neither the fit nor the normalisation knows them. An image whose inliers are fewer than
    BEYOND_CHANCE, or on one line, is lost, with a reason, and none of its landmarks is an inlier.
    One that has no more visible landmarks, or whose landmarks are degenerate themselves, is not
    searched.
    """
    from shapefit.lifting.consensus import find_consensus

    visible = weights > 0
    seen = visible.sum(axis=1)
    searched = seen >= BEYOND_CHANCE
    searched[list(find_degenerate(images.landmarks, weights))] = False
    inliers = find_consensus(
        images.landmarks,
        np.where(searched[:, None], weights, 0.0),
        lifter.dictionary.mean_shape,
        find_seeds(images),
        threshold=lifter.outlier_threshold or RANSAC_THRESHOLD,
        draws=DRAWS,
        max_rounds=MAX_ROUNDS,
        threads=lifter.threads,
    )
    inliers = np.where(searched[:, None], inliers, True) & visible
    agree = inliers.sum(axis=1)
    found = np.where((agree < BEYOND_CHANCE)[:, None], 0.0, inliers)
    lost = [image for image in find_degenerate(images.landmarks, found) if searched[image]]
    inliers[lost] = False
    return inliers, {
        image: f"only {agree[image]} of {seen[image]} visible landmarks agree with each other; the "
        f"minimum is {BEYOND_CHANCE}, not all on one line"
        for image in lost
    }


def find_seeds(images: LandmarkSet) -> NDArray[np.uint64]:
    """Return a seed (n,) for each image, from the name of the item.

    So what is drawn for an image depends neither on the others nor on its place among them.
    """
    digests = [blake2b(f"0 {item}".encode(), digest_size=8).digest() for item in images.items]
    return np.frombuffer(b"".join(digests), dtype="<u8").astype(np.uint64)


def lift_left_out(images: LandmarkSet, lifter: Lifter) -> Lifting:
    """Lift each image without the atoms of the item that the dataset `leave_one_out` names.

    Images of an item that the dictionary does not have are lifted with all atoms. The lifting has
    the columns of the whole dictionary, 0 for atoms left out. Raises InputError where the images
    lack the dataset.
    """
    from shapefit.lifting.merging import Group, merge

    dictionary = lifter.dictionary
    items = find_left_out(images, lifter)

    def lift_group(rows: NDArray[np.intp], threads: int = 1) -> Group:
        item = str(items[rows[0]])
        without = dictionary.without(item) if item else dictionary
        own = replace(lifter, dictionary=without, threads=threads)
        lifting = lift_images(images.take(rows), own)
        return Group(lifting, rows, np.flatnonzero(dictionary.atoms_without(item)))

    parts = [np.flatnonzero(items == item) for item in dict.fromkeys(items.tolist())]
    # The solvers have work for several threads where there is more than a stretch of images.
    groups = [lift_group(rows, lifter.threads) for rows in parts if len(rows) > STRETCH]
    small = [rows for rows in parts if len(rows) <= STRETCH]
    groups += on_threads(lift_group, small, lifter.threads)
    return merge(groups, dictionary.atoms) if groups else lift_images(images, lifter)


def check_items(dictionary: Dictionary) -> None:
    """Raise InputError where the atoms of a dictionary have no items, or but one."""
    if dictionary.atom_items is None:
        found = "the atoms of the dictionary have no items"
        fix = f"learn it with `method: exemplars`, or remove `{LEAVE_ONE_OUT}`"
        raise input_error(LEAVE_ONE_OUT, found, fix)
    if len(set(dictionary.atom_items)) == 1:
        found = f"every atom of the dictionary is the item '{dictionary.atom_items[0]}'"
        raise input_error(LEAVE_ONE_OUT, found, "learn the dictionary from more models")


def find_left_out(images: LandmarkSet, lifter: Lifter) -> NDArray[np.str_]:
    """Return the item (n,) whose atoms the fit of each image does without, '' for none."""
    items, known = find_items(images, lifter)
    items[~known] = ""
    return items


def find_items(images: LandmarkSet, lifter: Lifter) -> tuple[NDArray[np.str_], Flags]:
    """Return the item (n,) that each image shows, and whether atoms are of it (n,)."""
    name = lifter.leave_one_out or ""
    items = np.array(named_items(images, name, LEAVE_ONE_OUT, LEAVE_ONE_OUT), dtype=str)
    return items, np.isin(items, np.array(lifter.dictionary.atom_items, dtype=str))


def whole_stretches(images: int) -> int:
    """Round up to whole stretches: within one, images start from their neighbours' solutions."""
    return math.ceil(images / STRETCH) * STRETCH
