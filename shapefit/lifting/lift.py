"""Lift a batch of landmarks: normalise, estimate the shapes by some method, scale
back.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Generic, NamedTuple

import numpy as np

from shapefit.arrays import Floats, Integers
from shapefit.convex.problem import Loss, Problem, build_problem
from shapefit.convex.solver import Status
from shapefit.convex.transforms import Transforms, nuclear_norm
from shapefit.geometry.pinhole import project_pinhole
from shapefit.lifting.degeneracy import normalise_visible
from shapefit.lifting.estimate import (
    AtomEstimate,
    E,
    Estimator,
    PosteriorEstimate,
    join_images,
)

if TYPE_CHECKING:
    from shapefit.geometry.pinhole import Camera


FAILURE_REASONS = {
    Status.DEGENERATE: "no pose of the mean shape fits the visible landmarks",
    Status.NUMERICAL_FAILURE: "numerical failure in the solver",
}
"""Why a method has no shape for landmarks that look fine."""

NOT_FINITE = "the fitted shape contains NaN or infinity"

BETA = 0.1
"""Residual, for normalised landmarks, beyond which a robust loss judges a landmark an
outlier.
"""

NOISE_DRAWS = 512
"""Draws of noise from which lambda is found."""

NOISE_SEED = 1504_01507
"""Of these draws: lambda is the same in every run."""

MIN_LAMBDA = 1e-3
"""From the noise. Where landmarks are all but exact, smaller ones change little and
take longer.
"""

MAX_LAMBDA = 1e30
"""From the noise. Every shape is empty long before, and what is larger could overflow.
"""

MAX_RELATIVE_NOISE = 1e6
"""Noise in units of the size of the landmarks beyond which these say nothing."""


class Program(NamedTuple):
    """Which convex program is solved: its lambda, loss and threshold of outliers.

    `lam` None takes lambda from `noise`, the standard deviation of a landmark's
    coordinate in the unit of the landmarks. With a robust loss a landmark is an outlier
    where a coordinate of its weighted residual exceeds `beta` (normalised), which is
    also the weight of the sparse errors.
    """

    lam: float | None
    loss: Loss = Loss.SQUARED
    beta: float = BETA
    noise: float = 0.0


@dataclass(frozen=True, eq=False, repr=False)
class PerspectiveView:
    """Where the shapes of n images are in front of a perspective camera.

    It sees X = R sum_i c_i B_i + translation. translation (n, 3), of the object's
    origin in the frame of the camera, in normalised units of the dictionary, nan where
    an image has no shape; the camera in the unit of the landmarks.
    """

    translation: Floats
    camera: Camera


@dataclass(frozen=True, eq=False, repr=False)
class Lifting(Generic[E]):
    """What lifting n images gives: shapes in the units of the landmarks, and the rest.

    shapes (n, 3, p) in the camera frame = scale (shapes of the estimate), with mean
    depth 0, + translation on x and y; landmarks_fitted (n, 2, p) are their projections:
    x and y, unless there is a perspective view. translation (n, 2), scale (n,); problem
    and estimate in normalised units; failures: image -> reason, for images without a
    shape (nan).
    """

    shapes: Floats
    landmarks_fitted: Floats
    translation: Floats
    scale: Floats
    problem: Problem
    estimate: E
    failures: Mapping[int, str]
    perspective: PerspectiveView | None = None


PosteriorLifting = Lifting[PosteriorEstimate]


def lift(
    landmarks: Floats,
    weights: Floats,
    atoms: Floats,
    program: Program,
    estimator: Estimator[E],
    camera: Camera | None = None,
    group: Integers | None = None,
) -> Lifting[E]:
    """Lift the landmarks of n images to shapes by a method, in their own unit.

    landmarks (n, 2, p), weights (n, p) with 0 = hidden, atoms (k, 3, p); estimator, the
    method on normalised landmarks; camera of the images, for a method that looks
    through it; group (n,), in which images start from each other, see `Problem`. Images
    that cannot be lifted have a reason in `failures`.
    """
    norm, failures = normalise_visible(landmarks, weights)
    fine = np.isfinite(norm.scale)
    size = np.where(fine, norm.scale, 1.0)
    problem = build_problem(
        norm.points,
        atoms,
        choose_lambda(program, atoms, size, (weights > 0).mean(axis=1)),
        weights=np.where(fine[:, None], weights, 0.0),
        loss=program.loss,
        beta=program.beta,
        group=group,
    )
    noise = noise_of_landmarks(program, size, weights.shape)
    if camera is not None:
        middle = np.where(fine[:, None], norm.centroid, 0.0)
        near = camera.normalised_as(norm._replace(centroid=middle, scale=size))
        problem = replace(problem, camera=near)
    estimate = estimator(replace(problem, noise=noise))
    for status, reason in FAILURE_REASONS.items():
        if status in estimate.status:
            ended = np.fromiter(
                (value is status for value in estimate.status), bool, len(fine)
            )
            failures |= dict.fromkeys(np.flatnonzero(ended & fine).tolist(), reason)
            fine &= ~ended
    scale = np.where(fine, norm.scale, np.nan)
    translation = scale[:, None] * estimate.translation + norm.centroid
    view, t = None, estimate.camera_translation
    if camera is not None and t is not None:
        view = PerspectiveView(np.where(fine[:, None], t, np.nan), camera)
        scale = np.sqrt(camera.focal.prod(axis=1)) / (
            camera.sign * view.translation[:, 2]
        )
    shapes = scale[:, None, None] * estimate.shapes
    shapes[:, :2] += translation[:, :, None]
    fitted = shapes[:, :2]
    if view is not None:
        fitted = project_pinhole(
            view.camera, estimate.shapes + view.translation[..., None]
        )
    return Lifting(
        shapes, fitted, translation, scale, problem, estimate, failures, view
    )


def noise_of_landmarks(
    program: Program, scale: Floats, shape: tuple[int, ...]
) -> Floats | None:
    """Return the covariance (n, p, 2, 2) of the noise of normalised landmarks.

    None where the program states none. scale (n,), by which the landmarks were divided;
    shape, (n, p).
    """
    if program.noise == 0:
        return None
    deviation = np.minimum(program.noise / scale, MAX_RELATIVE_NOISE)
    return np.broadcast_to(
        deviation[:, None, None, None] ** 2 * np.eye(2), (*shape, 2, 2)
    )


def choose_lambda(
    program: Program, atoms: Floats, scale: Floats, visible_share: Floats
) -> Floats:
    """Return lambda (n,), the weight of the penalty on transforms, of each image.

    As the program gives it, else from the noise; 1 for an exact loss, which ignores it.
    From the noise it is noise / scale E max_i ||G B_i^T||_* sqrt(visible share), with
    the scale (n,) of the landmarks; hidden ones, which no noise reaches, shrink the
    expectation.
    """
    if program.loss is Loss.EXACT:
        return np.ones_like(scale)
    if program.lam is not None:
        return np.full_like(scale, program.lam)
    unit = noise_dual_norm(atoms)
    with np.errstate(over="ignore"):
        level = program.noise / scale * unit * np.sqrt(visible_share)
    return np.clip(level, MIN_LAMBDA, MAX_LAMBDA)


def noise_dual_norm(atoms: Floats) -> float:
    """Return the mean lambda below which unit noise alone would activate an atom.

    E max_i ||G B_i^T||_* over centred landmark noise G (2, p) of unit standard
    deviation. atoms (k, 3, p). The mean of seeded draws: the same for the same atoms.
    """
    k, _, p = atoms.shape
    G = np.random.default_rng(NOISE_SEED).standard_normal((NOISE_DRAWS, 2, p))
    G -= G.mean(axis=-1, keepdims=True)
    products = G.reshape(2 * NOISE_DRAWS, p) @ atoms.reshape(3 * k, p).T
    N = products.reshape(NOISE_DRAWS, 2, k, 3)
    return float(nuclear_norm(N.swapaxes(1, 2)).max(axis=1).mean())


def fail_nonfinite(lifting: Lifting[E]) -> Lifting[E]:
    """Mark the images of a lifting as failed whose shape is not all finite.

    Those that had failed before stay as they are. The others end with NUMERICAL_FAILURE
    and without a shape (nan), whatever the solver says of them.
    """
    broken = np.flatnonzero(~np.isfinite(lifting.shapes).all(axis=(1, 2))).tolist()
    broken = [image for image in broken if image not in lifting.failures]
    if not broken:
        return lifting
    arrays = (
        lifting.shapes,
        lifting.landmarks_fitted,
        lifting.translation,
        lifting.scale,
    )
    shapes, fitted, translation, scale = copies = [values.copy() for values in arrays]
    status = list(lifting.estimate.status)
    for image in broken:
        status[image] = Status.NUMERICAL_FAILURE
        for values in copies:
            values[image] = np.nan
    return replace(
        lifting,
        shapes=shapes,
        landmarks_fitted=fitted,
        translation=translation,
        scale=scale,
        estimate=replace(lifting.estimate, status=tuple(status)),
        failures={**lifting.failures, **dict.fromkeys(broken, NOT_FINITE)},
    )


class Group(NamedTuple):
    """The lifting of some of the images with some of the atoms.

    images (m,) and atoms (j,): which of all images and of all atoms its axes run over.
    """

    lifting: Lifting[AtomEstimate]
    images: Integers
    atoms: Integers


def merge(groups: Sequence[Group], atoms: Floats) -> Lifting[AtomEstimate]:
    """Merge the liftings of groups of images into one of all images, in their order.

    Each image is in one group. atoms (k, 3, p) are those that the groups took theirs
    from; they become those of the problem, and coefficients and transforms get k
    columns.
    """
    order = np.argsort(np.concatenate([group.images for group in groups]))
    failures = {
        int(group.images[image]): reason
        for group in groups
        for image, reason in group.lifting.failures.items()
    }
    padded = [_pad(group, len(atoms)) for group in groups]
    joined: Lifting[AtomEstimate] = join_images(padded, order)
    problem = replace(joined.problem, atoms=atoms)
    return replace(joined, problem=problem, failures=dict(sorted(failures.items())))


def _pad(group: Group, k: int) -> Lifting[AtomEstimate]:
    """Return the lifting of a group with coefficients and transforms of all k atoms.

    Those of atoms that the group lacks are 0. Its failures are left out.
    """
    estimate = group.lifting.estimate
    c, M, proof = estimate.coefficients, estimate.transforms, estimate.convex_proof

    def of_all_atoms(transforms: Transforms) -> Transforms:
        """Renumber the atoms of transforms as in the whole dictionary."""
        return replace(transforms, atom=group.atoms[transforms.atom], k=k)

    if c is not None:
        full = np.zeros((len(c), k))
        full[:, group.atoms] = c
        estimate = replace(estimate, coefficients=full)
    if M is not None:
        estimate = replace(estimate, transforms=of_all_atoms(M))
    if proof is not None:
        whole = replace(proof, transforms=of_all_atoms(proof.transforms))
        estimate = replace(estimate, convex_proof=whole)
    return replace(group.lifting, estimate=estimate, failures={})
