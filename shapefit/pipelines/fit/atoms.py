"""The family of methods that combine atoms: convex, convex+refine, global, alternate,
mean-shape and pmp.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats, Integers, evenly
from shapefit.config import FitConfig
from shapefit.convex.problem import Loss, find_blocks
from shapefit.convex.solver import solve_newton
from shapefit.dictionary.model import Dictionary
from shapefit.errors import input_error
from shapefit.geometry.pinhole import Camera
from shapefit.io import LandmarkSource
from shapefit.lifting.estimate import AtomEstimate, Estimator, Solve
from shapefit.lifting.lift import BETA, Group, Lifting, Program, fail_nonfinite, lift
from shapefit.lifting.lift import merge as merge_groups
from shapefit.lifting.methods import METHODS, ROBUST, STARTS
from shapefit.pipelines.fit.camera import camera_factory
from shapefit.pipelines.fit.columns import blank_failed, with_certificate
from shapefit.pipelines.fit.family import (
    Batch,
    Calibration,
    Cost,
    LiftedImages,
    Pace,
    read_blocks,
)
from shapefit.pipelines.fit.outliers import RANSAC_THRESHOLD, lift_inliers
from shapefit.pipelines.items import names_in_dataset
from shapefit.pipelines.joints import LandmarkMatch
from shapefit.records import Fit, Landmarks
from shapefit.threads import on_threads

LEAVE_ONE_OUT = "leave_one_out"
"""Key that names the dataset of the items whose atoms an image does without."""

TIMED_IMAGES = (1, 8)
"""Images that are lifted to learn how long one takes: the first call also imports."""

WORTH_TIMING_SECONDS = 60.0
"""Of all images by the first one, below which no more are timed."""


def make_atom_family(config: FitConfig, match: LandmarkMatch) -> AtomFamily:
    """Return the family of a method that combines atoms, with a config's options."""
    lam = None if config.lam == "auto" else config.lam
    robust = config.outliers in ROBUST
    program = Program(
        lam,
        Loss(config.outliers) if robust else Loss.SQUARED,
        beta=config.outlier_threshold or BETA,
        noise=config.noise or 0.0,
    )
    threshold = None
    if config.outliers == "ransac":
        threshold = config.outlier_threshold or RANSAC_THRESHOLD
    tolerance = config.tolerance
    if tolerance is None:
        tolerance = METHODS[config.method].tolerance
    return AtomFamily(
        method=config.method,
        dictionary=match.dictionary,
        program=program,
        tolerance=tolerance,
        camera=camera_factory(config.camera),
        signed=config.signed,
        starts=config.starts,
        outlier_threshold=threshold,
        leave_one_out=config.leave_one_out,
        proof=bool(config.save.proof),
        threads=config.threads,
    )


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class AtomFamily:
    """Lift to shapes that combine atoms: S = sum_i c_i R_i B_i, or R sum_i c_i B_i.

    camera gives those of images, None for weak perspective; outlier_threshold, of
    outliers that are searched before the fit, None for no search; leave_one_out names
    the dataset of the items whose atoms an image does without; proof, whether the
    certificate of the convex program is stored.
    """

    method: str
    dictionary: Dictionary
    program: Program
    tolerance: float
    camera: Callable[[Landmarks], Camera] | None = None
    signed: bool = False
    starts: int = STARTS
    outlier_threshold: float | None = None
    leave_one_out: str | None = None
    proof: bool = False
    threads: int = 0

    def check(self, sample: Landmarks) -> None:
        """Raise InputError where atoms are to be left out, but no image names any."""
        if self.leave_one_out is not None:
            check_omitted(sample, self.leave_one_out, self.dictionary)

    def predict_cost(self, sample: Landmarks, total: int) -> Cost:
        """Predict seconds per image by lifting one of the sample, or several.

        One is enough unless all `total` images take long.
        """
        per_image = 0.0
        if total <= 1:
            return Cost(per_image, total)
        for number in TIMED_IMAGES:
            timed = sample.take(evenly(len(sample), number))
            began = time.perf_counter()
            self.lift_images(timed)
            per_image = (time.perf_counter() - began) / max(len(timed), 1)
            if per_image * total < WORTH_TIMING_SECONDS:
                break
        return Cost(per_image, total)

    def calibrate(self, sample: Landmarks) -> Calibration:
        """Return an empty calibration: only the camera is left open."""
        return Calibration()

    def read_batches(self, source: LandmarkSource, pace: Pace) -> Iterator[Batch]:
        """Yield blocks of images; each image is lifted by itself."""
        return read_blocks(source, pace)

    def lift(self, images: Landmarks, group: Integers | None = None) -> LiftedImages:
        """Lift images, without the atoms of their items if `leave_one_out` is set."""
        if self.leave_one_out is None:
            lifting = self.lift_images(images, group)
        else:
            lifting = self.lift_omitting(images, self.leave_one_out, group)
        omitted = None
        if self.leave_one_out is not None:
            omitted = find_omitted(images, self.leave_one_out, self.dictionary)
        return LiftedImages(fail_nonfinite(lifting), omitted=omitted)

    def add_columns(self, fit: Fit, lifting: Lifting[AtomEstimate]) -> Fit:
        """Return the fit with coefficients, duality gap and certificate."""
        estimate = lifting.estimate
        failed = np.isnan(lifting.scale)
        fit = replace(
            fit,
            coefficients=blank_failed(estimate.coefficients, failed),
            relative_gap=blank_failed(estimate.relative_gap, failed),
            active_atoms=estimate.active_atoms,
            tight=estimate.tight,
        )
        if self.proof:
            is_of_fit = METHODS[self.method].proves == "optimum"
            fit = with_certificate(fit, lifting, is_of_fit=is_of_fit)
        return fit

    def lift_images(
        self, images: Landmarks, group: Integers | None = None
    ) -> Lifting[AtomEstimate]:
        """Lift images, then refine pose and coefficients for the camera, if any.

        Methods that look through the camera themselves are not refined.
        """
        w = images.as_columns()
        estimator = ESTIMATORS[self.method](self)

        def lift_weighted(weights: Floats) -> Lifting[AtomEstimate]:
            return lift(
                w,
                weights,
                self.dictionary.atoms,
                self.program,
                estimator,
                group=group,
            )

        lifting = lift_inliers(
            lift_weighted,
            images,
            images.weights(),
            self.dictionary,
            self.outlier_threshold,
            self.threads,
        )
        if self.camera is not None and METHODS[self.method].perspective == "refined":
            from shapefit.lifting.perspective import refine_view

            camera = self.camera(images)
            lifting = refine_view(lifting, w, camera, self.dictionary, self.threads)
        return lifting

    def lift_omitting(
        self, images: Landmarks, dataset: str, group: Integers | None
    ) -> Lifting[AtomEstimate]:
        """Lift each image without the atoms of its item, whose coefficients are 0.

        Images of an item start from one another where they are in one block of their
        file: no bit depends on the size of a batch.
        """
        omitted = find_omitted(images, dataset, self.dictionary)
        files = np.zeros(len(images), np.int64) if group is None else group
        block: Integers = np.cumsum(find_blocks(files))

        def lift_group(item: str) -> Group:
            """Lift the images of an item without its atoms; "" is no item."""
            without = self.dictionary.without(item) if item else self.dictionary
            family = replace(self, dictionary=without, threads=1)
            rows = np.flatnonzero(omitted == item)
            atoms = np.flatnonzero(self.dictionary.atoms_without(item))
            lifting = family.lift_images(images.take(rows), block[rows])
            return Group(lifting, rows, atoms)

        items = dict.fromkeys(omitted.tolist())
        groups = on_threads(lift_group, items, self.threads)
        if not groups:
            return self.lift_images(images, group)
        return merge_groups(groups, self.dictionary.atoms)

    def solver(self, tolerance: float | None = None) -> Solve:
        """Return the solver of the convex program; by default, to `self.tolerance`."""
        if tolerance is None:
            tolerance = self.tolerance
        return partial(solve_newton, tolerance=tolerance, threads=self.threads)


def convex_estimator(family: AtomFamily) -> Estimator[AtomEstimate]:
    """Return the estimator of the method `convex`."""
    from shapefit.lifting.reconstruction import lift_convex

    return partial(lift_convex, solve=family.solver(), threads=family.threads)


def refined_estimator(family: AtomFamily) -> Estimator[AtomEstimate]:
    """Return the estimator of the method `convex+refine`."""
    from shapefit.lifting.shared_rotation import refine_convex

    return partial(
        refine_convex,
        solve=family.solver(),
        mean_shape=family.dictionary.mean_shape,
        signed=family.signed,
        threads=family.threads,
    )


def global_estimator(family: AtomFamily) -> Estimator[AtomEstimate]:
    """Return the estimator of the method `global`.

    Its tolerance is that of the global gap, and not of the convex program.
    """
    from shapefit.lifting.global_optimum import find_global

    of_program = min(family.tolerance, METHODS["convex"].tolerance)
    return partial(
        find_global,
        solve=family.solver(of_program),
        mean_shape=family.dictionary.mean_shape,
        starts=family.starts,
        tolerance=family.tolerance,
        threads=family.threads,
    )


def alternating_estimator(family: AtomFamily) -> Estimator[AtomEstimate]:
    """Return the estimator of the method `alternate`."""
    from shapefit.lifting.shared_rotation import alternate_from_mean

    return partial(
        alternate_from_mean,
        mean_shape=family.dictionary.mean_shape,
        starts=family.starts,
        signed=family.signed,
        threads=family.threads,
    )


def pose_estimator(family: AtomFamily) -> Estimator[AtomEstimate]:
    """Return the estimator of the method `mean-shape`."""
    from shapefit.lifting.shared_rotation import pose_mean_shape

    return partial(
        pose_mean_shape,
        mean_shape=family.dictionary.mean_shape,
        starts=family.starts,
        threads=family.threads,
    )


def pursuit_estimator(family: AtomFamily) -> Estimator[AtomEstimate]:
    """Return the estimator of the method `pmp`."""
    from shapefit.lifting.matching_pursuit import lift_by_pursuit

    edges = family.dictionary.edges
    assert edges is not None, "checked with what the method needs"
    return partial(
        lift_by_pursuit, mean_shape=family.dictionary.mean_shape, edges=edges
    )


ESTIMATORS: dict[str, Callable[[AtomFamily], Estimator[AtomEstimate]]] = {
    "convex": convex_estimator,
    "convex+refine": refined_estimator,
    "global": global_estimator,
    "alternate": alternating_estimator,
    "mean-shape": pose_estimator,
    "pmp": pursuit_estimator,
}
"""What gives the estimator of each method, which is imported where it is chosen."""


def find_omitted(
    images: Landmarks, dataset: str, dictionary: Dictionary
) -> NDArray[np.str_]:
    """Return the item (n,) whose atoms are left out for each image, '' for none."""
    items = np.array(
        names_in_dataset(images, dataset, LEAVE_ONE_OUT, LEAVE_ONE_OUT), str
    )
    return np.where(np.isin(items, dictionary.atom_items or ()), items, "")


def check_omitted(images: Landmarks, dataset: str, dictionary: Dictionary) -> None:
    """Raise InputError unless images name items of a dictionary that has several."""
    items = [*dict.fromkeys(dictionary.atom_items or ())]
    if len(items) < 2:
        fault = f"the atoms of the dictionary are of {len(items) or 'no'} items"
        fix = (
            "learn it from several models with `method: exemplars`, or remove"
            f" `{LEAVE_ONE_OUT}`"
        )
        raise input_error(LEAVE_ONE_OUT, fault, fix)
    if len(images) and not (find_omitted(images, dataset, dictionary) != "").any():
        fault = "the images show no items of the dictionary"
        fix = f"name the dataset that holds them, such as {', '.join(items[:3])}"
        raise input_error(LEAVE_ONE_OUT, fault, fix)
