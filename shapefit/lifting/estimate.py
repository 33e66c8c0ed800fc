"""What every method of lifting returns, and what they share in making it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Flags, Floats, Integers, Singles
from shapefit.convex.problem import Problem
from shapefit.convex.solver import Solution, Status
from shapefit.convex.transforms import Transforms

if TYPE_CHECKING:
    from shapefit.lifting.posterior.posterior import Modes as PosteriorModes


PAIRS = ((0, 1), (0, 2), (1, 2))
"""Coordinates of a landmark, in the order of the correlations."""


@dataclass(frozen=True, eq=False, repr=False)
class ConvexProof:
    """What proves the optimum of the convex program for n images, in normalised units.

    transforms M and translation T (n, 2), at which the objective P (n,) is taken;
    dual Y (n, 2, p), feasible, whose value D makes the relative_gap (P - D) / P (n,).
    """

    transforms: Transforms
    translation: Floats
    dual: Floats
    objective: Floats
    relative_gap: Floats

    @classmethod
    def of(cls, solution: Solution) -> ConvexProof:
        """Take the fields of a solution of the convex program that certify it."""
        return cls(
            **{field.name: getattr(solution, field.name) for field in fields(cls)}
        )


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Estimate:
    """What every method estimates of n images, in normalised units.

    W ~ first two rows of shapes + T 1^T. shapes (n, 3, p) in the camera frame, with
    mean depth 0; translation T (n, 2); rotation (n, 3, 3), shared by all atoms or their
    consensus, nan where unknown; objective (n,), that of the method; residual (n,),
    ||Omega o (W - shapes - T 1^T)||_F / ||Omega o (W - mean)||_F; iterations (n,);
    status, a Status per image.

    outliers (n, p), the landmarks that a robust loss or a search before the fit set
    aside, None without either; convex_proof, of the convex program that the method is
    or starts from, None without one; camera_translation (n, 3), of a method that looks
    through the camera of the problem itself: then W is seen of shapes +
    camera_translation, both in the unit of the dictionary, and T (n, 2) is where the
    middle of the shapes is seen; limit, what ends an image as ITERATION_LIMIT, in words
    for its warning, "" where the status says all.
    """

    shapes: Floats
    translation: Floats
    rotation: Floats
    objective: Floats
    residual: Floats
    iterations: Integers
    status: tuple[Status, ...]
    outliers: Flags | None = None
    convex_proof: ConvexProof | None = None
    camera_translation: Floats | None = None
    limit: str = ""

    def status_words(self) -> NDArray[np.object_]:
        """Return the status of each image as its word (n,), such as "optimal".

        To ask each one takes ten times as long.
        """
        words = {id(status): status.value for status in Status}
        return np.array([*map(words.__getitem__, map(id, self.status))], dtype=object)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class AtomEstimate(Estimate):
    """What methods estimate that combine atoms, without a prior over shapes.

    coefficients c (n, k); active_atoms (n,), how many of them are not 0; transforms M;
    relative_gap (n,), of the method's objective; tight (n,), as in Reconstruction. None
    where a method has no such thing.
    """

    coefficients: Floats | None = None
    active_atoms: Integers | None = None
    transforms: Transforms | None = None
    relative_gap: Floats | None = None
    tight: Flags | None = None


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class PosteriorEstimate(Estimate):
    """What methods estimate that weigh landmarks against a prior over shapes.

    deviation (n, 3, p), of the coordinates of shapes + T; correlation (n, 3, p), of
    the `PAIRS` of coordinates of a landmark; covariance (n, 3p, 3p), all x, then y,
    then z, None where nobody asked for it; log_evidence log p(w) (n,);
    inlier_probability (n, p), nan where a landmark is not seen; squared_mahalanobis
    (n,), of the landmarks from those expected. modes of each image, from which
    sequences are inferred, None unless asked for.

    p_value and start_distance (n,) are added by `with_p_value`; sequence_noise and
    image_error (n,), and sides_exchanged (n,), by the inference of sequences.
    image_error is in the unit of the landmarks.
    """

    deviation: Floats
    correlation: Singles
    log_evidence: Floats
    inlier_probability: Floats
    squared_mahalanobis: Floats
    covariance: Floats | None = None
    modes: PosteriorModes | None = None
    p_value: Floats | None = None
    start_distance: Floats | None = None
    sequence_noise: Floats | None = None
    image_error: Floats | None = None
    sides_exchanged: Floats | None = None

    def scale_error_bars(
        self, factor: Floats | float = 1.0, divisor: Floats | float = 1.0
    ) -> PosteriorEstimate:
        """Return the estimate with its error bars alone multiplied by factor / divisor.

        Covariances are multiplied by the square of it. Both are (n, 1, 1) or numbers.
        """
        covariance = self.covariance
        if covariance is not None:
            covariance = factor**2 * covariance / divisor**2
        deviation = factor * self.deviation / divisor
        return replace(self, deviation=deviation, covariance=covariance)


Solve = Callable[[Problem], Solution]
"""Solves the convex program of a problem."""

E = TypeVar("E", bound=Estimate)

Estimator = Callable[[Problem], E]
"""Estimates the shapes of a problem."""


class Placement(NamedTuple):
    """A projected shape placed on the landmarks of n images.

    translation T (n, 2); half_squared_residual (n,), 1/2 ||Omega o (W - S - T
    1^T)||_F^2; residual (n,), the norm in it beside that of the centred landmarks. nan
    for images without visible landmarks.
    """

    translation: Floats
    half_squared_residual: Floats
    residual: Floats


def fit_translation(
    problem: Problem, projected: Floats, translation: Floats | None = None
) -> Placement:
    """Return the translations that fit projected shapes to landmarks, and residuals.

    argmin_T 1/2 ||Omega o (W - S - T 1^T)||_F^2, the mean of W - S with the weights
    squared; a given T is kept, and its residuals are returned. S (n, 2, p); further
    rows do not count.
    """
    squares = problem.weights[:, None] ** 2
    with np.errstate(invalid="ignore"):  # where nothing is seen

        def weighted_mean(points: Floats) -> Floats:
            mean: Floats = (squares * points).sum(axis=-1) / squares.sum(axis=-1)
            return mean

        left, W = problem.landmarks - projected[:, :2], problem.landmarks
        if translation is None:
            T = weighted_mean(left)
        else:
            T = np.array(translation, np.float64)
        half_squared_residual, whole = (
            0.5
            * (squares * (points - middle[..., None]) ** 2).sum(axis=-1).sum(axis=-1)
            for points, middle in ((left, T), (W, weighted_mean(W)))
        )
    share = np.divide(
        half_squared_residual, whole, out=np.zeros_like(whole), where=whole != 0
    )
    return Placement(T, half_squared_residual, np.sqrt(share))


def join_images(records: Sequence[Any], order: Integers) -> Any:
    """Join records of images, all of one type, into one with its images in `order`.

    order: the images by their indices in all records, one record after the other.
    Arrays, tuples and transforms in them, and in records and mappings that they hold,
    have the images first; all else, and the atoms of a problem, are those of the first
    record.
    """
    first = records[0]
    if isinstance(first, np.ndarray):
        return np.concatenate(records)[order]
    if isinstance(first, Transforms):
        return Transforms.concatenate(records).take(order)
    if isinstance(first, tuple):
        images = [image for record in records for image in record]
        return tuple(images[row] for row in order.tolist())
    if isinstance(first, Mapping):
        return {
            key: join_images([record[key] for record in records], order)
            for key in first
        }
    if is_dataclass(first):
        names = [entry.name for entry in fields(first) if entry.name != "atoms"]
        parts = {name: [getattr(record, name) for record in records] for name in names}
        joined = {name: join_images(part, order) for name, part in parts.items()}
        return replace(first, **joined)  # type: ignore[type-var]
    return first
