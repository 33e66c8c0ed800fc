"""Single images by a prior over shapes: which landmarks count, and their posterior."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from shapefit.arrays import Flags, Floats, Integers
from shapefit.convex.solver import solve_newton
from shapefit.dictionary.model import Dictionary
from shapefit.geometry.pinhole import Camera
from shapefit.lifting.estimate import Solve
from shapefit.lifting.lift import PosteriorLifting, Program, lift
from shapefit.lifting.methods import METHODS, MIN_CONFIDENCE
from shapefit.lifting.posterior.method import lift_to_posterior, with_p_value
from shapefit.lifting.posterior.model import (
    RESIDUAL_VARIANCE,
    PosteriorModel,
    make_model,
)
from shapefit.lifting.posterior.usual_lengths import LimbLengths, find_limb_lengths
from shapefit.pipelines.fit.camera import IMAGE_SIZE
from shapefit.pipelines.fit.outliers import lift_inliers
from shapefit.records import Landmarks

BORDER_SHARE = 0.01
"""Of the image's size: so near to a side of it a detector leaves what it does not see.
"""

USUAL_PROGRAM = Program(lam=0.1)
"""The convex program from which the view of an image comes."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ImagePosterior:
    """Lift single images to the posterior mean of their shapes, with error bars.

    program, of which the view to start from is the optimum, to the tolerance; camera
    gives those of images, None for weak perspective; residual_variance None stands for
    that of the dictionary; prior_scale, bar_scale, growth, limbs and covariance as in
    `PosteriorModel`; modes, how many of each image are kept.

    min_confidence, below which a landmark is hidden; image_size, width and height of
    all images, None where they state their own; shown (p,), the landmarks that the
    files show, whose errors are expected ones, None for all; outlier_threshold, of
    outliers that are searched before, None for no search.
    """

    dictionary: Dictionary
    program: Program = USUAL_PROGRAM
    tolerance: float = METHODS["posterior"].tolerance
    camera: Callable[[Landmarks], Camera] | None = None
    residual_variance: float | None = None
    prior_scale: float = 1.0
    bar_scale: float = 1.0
    growth: tuple[float, ...] = ()
    limbs: LimbLengths | None = None
    covariance: bool = False
    modes: int = 0
    min_confidence: float = MIN_CONFIDENCE
    image_size: tuple[float, float] | None = None
    shown: Flags | None = None
    outlier_threshold: float | None = None
    threads: int = 0

    @property
    def variance(self) -> float:
        """Return the residual variance as set, else of the dictionary, else default."""
        if self.residual_variance is not None:
            return self.residual_variance
        learned = self.dictionary.residual_variance
        return RESIDUAL_VARIANCE if learned is None else float(learned[0])

    @property
    def model(self) -> PosteriorModel:
        """Return the prior over shapes and residuals by which images are lifted."""
        return make_model(
            self.dictionary,
            self.variance,
            prior_scale=self.prior_scale,
            limbs=self.limbs,
            bar_scale=self.bar_scale,
            growth=self.growth,
            covariance=self.covariance,
        )

    @property
    def solve(self) -> Solve:
        """Return the solver of the convex program, to the tolerance."""
        return partial(solve_newton, tolerance=self.tolerance, threads=self.threads)

    def with_limbs(self) -> ImagePosterior:
        """Return a copy with the dictionary's usual lengths of limbs, if it has any."""
        return replace(self, limbs=find_limb_lengths(self.dictionary))

    def lift(
        self, images: Landmarks, group: Integers | None = None
    ) -> PosteriorLifting:
        """Lift each image to its posterior, without landmarks that depend on others."""
        weights = self.weigh(images)
        depends = self.dictionary.depends_on >= 0
        weights = np.where(depends, 0.0, weights)
        estimator = partial(
            lift_to_posterior,
            model=self.model,
            solve=self.solve,
            modes=self.modes,
            threads=self.threads,
        )
        camera = None if self.camera is None else self.camera(images)

        def lift_weighted(weights: Floats) -> PosteriorLifting:
            return lift(
                images.as_columns(),
                weights,
                self.dictionary.atoms,
                self.program,
                estimator,
                camera,
                group,
            )

        return lift_inliers(
            lift_weighted,
            images,
            weights,
            self.dictionary,
            self.outlier_threshold,
            self.threads,
        )

    def lift_with_p_values(
        self, images: Landmarks, group: Integers | None = None
    ) -> PosteriorLifting:
        """Lift images; add p-values and start distances, by which they are judged."""
        lifting = self.lift(images, group)
        estimate = with_p_value(
            lifting.estimate,
            lifting.problem,
            self.model,
            solve=self.solve,
            threads=self.threads,
        )
        return replace(lifting, estimate=estimate)

    def log_evidence(self, images: Landmarks) -> Floats:
        """Return log p(w) (n,): how likely the landmarks of each image are."""
        return self.lift(images).estimate.log_evidence

    def weigh(self, images: Landmarks) -> Floats:
        """Return weights (n, p): 1 for landmarks that count, 0 for all others.

        The others are unseen, less confident than `min_confidence`, or at a border of
        the image.
        """
        weights = images.weights()
        sure = (weights > 0) & (weights >= self.min_confidence)
        inside = ~find_at_border(images, self.dictionary, self.image_size)
        return (sure & inside).astype(np.float64)


def find_at_border(
    images: Landmarks,
    dictionary: Dictionary,
    image_size: tuple[float, float] | None = None,
) -> Flags:
    """Flag landmarks (n, p) that lie, with a bone's other end, at a side of the image.

    At a side is within 1% of the size, and bones are the edges of the dictionary: there
    a detector leaves what it does not see. image_size: width and height of all images,
    None where each states its own. There are none where the size or the edges are
    unknown, and where the names are not those of the dictionary.
    """
    n = len(images)
    p = len(images.landmark_names)
    marked = np.zeros((n, p), dtype=bool)
    if image_size is None:
        stated = images.column(IMAGE_SIZE)
        far = np.asarray(0.0 if stated is None else stated, float)
    else:
        far = np.array(image_size)
    same_names = images.landmark_names == dictionary.landmark_names
    if dictionary.edges is None or not same_names or far.shape not in ((2,), (n, 2)):
        return marked
    far = np.broadcast_to(far, (n, 2))[..., None]
    w = images.as_columns()
    distance = np.stack([abs(w), abs(w - far)], axis=1)
    near = (distance <= BORDER_SHARE * far[:, None]).reshape(n, 4, p)
    for edge in dictionary.edges:
        both = np.all(near[..., edge], axis=2)
        marked[:, edge] |= np.any(both, axis=1)[:, None]
    return marked
