"""The family of methods that weigh landmarks against a prior over shapes: `posterior`,
and what `sequences` has in common with it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from shapefit.arrays import Floats, Integers
from shapefit.config import FitConfig
from shapefit.config.commands.fit import PriorConfig
from shapefit.dictionary.model import Dictionary
from shapefit.io import LandmarkSource
from shapefit.lifting import trust
from shapefit.lifting.estimate import PosteriorEstimate
from shapefit.lifting.lift import Lifting, Program, fail_nonfinite
from shapefit.lifting.methods import METHODS, MIN_CONFIDENCE
from shapefit.lifting.posterior.calibration import MAX_HIDDEN
from shapefit.pipelines.fit.camera import camera_factory
from shapefit.pipelines.fit.columns import as_rows, with_certificate
from shapefit.pipelines.fit.evidence import FACTORS
from shapefit.pipelines.fit.family import (
    Batch,
    Calibration,
    Cost,
    LiftedImages,
    Pace,
    read_blocks,
)
from shapefit.pipelines.fit.image_posterior import ImagePosterior
from shapefit.pipelines.fit.outliers import RANSAC_THRESHOLD
from shapefit.pipelines.fit.sample import (
    MAX_HIDDEN_IN_TURN,
    MAX_SAMPLE,
    MIN_SAMPLE,
    calibrate_by_sample,
)
from shapefit.pipelines.joints import MEANS, LandmarkMatch
from shapefit.records import Fit, Landmarks
from shapefit.threads import thread_count

SECONDS_PER_IMAGE = 2e-10
"""Of a core, times p^3.5 (10 + components): p^3 operations, in more memory. Measured on
a Xeon with AVX-512: 0.3 to 1.6 of it for 30 to 240 landmarks, 1 to 32 components.
"""


def make_posterior_family(
    config: FitConfig, match: LandmarkMatch, calibration: Calibration | None
) -> PosteriorFamily:
    """Return the posterior family with a config's options and calibrated values."""
    posterior = make_image_posterior(config, match, calibration)
    reason = "" if calibration is None else calibration.reason
    return PosteriorFamily(
        match=match,
        skeleton=config.skeleton,
        posterior=posterior,
        method=config.method,
        prior=config.prior,
        reason=reason,
        proof=bool(config.save.proof),
        save_covariance=config.save.covariance,
    )


def make_image_posterior(
    config: FitConfig, match: LandmarkMatch, calibration: Calibration | None
) -> ImagePosterior:
    """Return the ImagePosterior with a config's options and calibrated values.

    Before a calibration its landmarks are those of the dictionary.
    """
    lam = None if config.lam == "auto" else config.lam
    tolerance = config.tolerance
    if tolerance is None:
        tolerance = METHODS[config.method].tolerance
    threshold = None
    if config.outliers == "ransac":
        threshold = config.outlier_threshold or RANSAC_THRESHOLD
    min_confidence = config.min_confidence
    if min_confidence is None:
        min_confidence = MIN_CONFIDENCE
    posterior = ImagePosterior(
        dictionary=match.dictionary,
        program=Program(lam, noise=config.noise or 0.0),
        tolerance=tolerance,
        camera=camera_factory(config.camera),
        residual_variance=config.prior.residual_variance,
        prior_scale=config.prior.scale or 1.0,
        bar_scale=config.prior.bar_scale,
        covariance=config.save.covariance,
        min_confidence=min_confidence,
        image_size=config.image_size,
        outlier_threshold=threshold,
        threads=config.threads,
    )
    if calibration is None:
        return posterior
    theta = {**MEANS, **(config.skeleton or {})}
    shown = np.array(calibration.shown, dtype=bool) if calibration.shown else None
    posterior = replace(
        posterior,
        dictionary=match.detector_dictionary(theta),
        growth=calibration.growth,
        covariance=True,  # for the expected error, and the error bars of joints
        shown=shown,
    )
    return posterior.with_limbs()


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class PosteriorFamily:
    """Lift to the posterior mean under a prior over shapes, with error bars and trust.

    skeleton, factors of the detector's, None where they are usual; prior, keys of that
    section, of which a sample settles what is open; reason, why no image is to be
    trusted, "" for none; proof and save_covariance, what is stored.
    """

    match: LandmarkMatch
    skeleton: Mapping[str, float] | None
    posterior: ImagePosterior
    method: str
    prior: PriorConfig
    reason: str = ""
    proof: bool = False
    save_covariance: bool = False

    @property
    def dictionary(self) -> Dictionary:
        """Return the dictionary whose landmarks are lifted."""
        return self.match.dictionary

    def check(self, sample: Landmarks) -> None:
        """Raise nothing: this family needs only landmarks."""

    def predict_cost(self, sample: Landmarks, total: int) -> Cost:
        """Predict the seconds per image by its sizes, and how many images are lifted.

        A sample is lifted as often as there are pairs of factors, and with landmarks
        hidden in turn.
        """
        posterior = self.posterior
        prior = posterior.dictionary.prior
        assert prior is not None, "checked with what the method needs"
        p = posterior.dictionary.mean_shape.shape[1]
        cores = thread_count(posterior.threads)
        per_image = SECONDS_PER_IMAGE * p**3.5 * (10 + len(prior))
        per_image /= min(cores, max(total, 1))
        liftings = total
        if total >= MIN_SAMPLE:
            hidden = min(min(total, MAX_HIDDEN_IN_TURN) * p, MAX_HIDDEN)
            liftings += min(total, MAX_SAMPLE) * len(FACTORS) ** 2 + hidden
        return Cost(per_image, liftings)

    def calibrate(self, sample: Landmarks) -> Calibration:
        """Estimate a detector's skeleton, and scales of prior and error bars."""
        return calibrate_by_sample(
            sample,
            self.match,
            self.posterior,
            self.method,
            self.prior,
            self.skeleton,
        )

    def read_batches(self, source: LandmarkSource, pace: Pace) -> Iterator[Batch]:
        """Yield blocks of images; each image is lifted by itself."""
        return read_blocks(source, pace)

    def lift(self, images: Landmarks, group: Integers | None = None) -> LiftedImages:
        """Lift landmarks of the files, and convert them to the dictionary's joints."""
        lifting = self.posterior.lift_with_p_values(images, group)
        return self.convert_to_joints(lifting, images)

    def convert_to_joints(
        self, lifting: Lifting[PosteriorEstimate], images: Landmarks
    ) -> LiftedImages:
        """Convert a lifting of detected landmarks to one of the dictionary's joints."""
        lifting = fail_nonfinite(lifting)
        if self.dictionary.depth_ambiguity:
            estimate = trust.cover_mirror_image(lifting.estimate)
            lifting = replace(lifting, estimate=estimate)
        visible = self.posterior.weigh(images) > 0
        theta = {**MEANS, **(self.skeleton or {})}
        joints, detected = self.match.to_joints(
            lifting, theta, images.as_columns(), visible, self.posterior.variance
        )
        return LiftedImages(joints, detected)

    def add_columns(self, fit: Fit, lifting: Lifting[PosteriorEstimate]) -> Fit:
        """Return the fit with error bars in its unit, and a verdict on each image."""
        estimate = lifting.estimate
        scale = lifting.scale[:, None, None]
        fit = replace(
            fit,
            shape_sd=as_rows(scale * estimate.deviation),
            shape_correlation=estimate.correlation.swapaxes(1, 2),
            log_evidence=estimate.log_evidence,
            inlier_probability=estimate.inlier_probability,
            p_value=estimate.p_value,
            start_distance=estimate.start_distance,
        )
        if self.save_covariance:
            scaled = estimate.scale_error_bars(scale)
            fit = replace(fit, shape_covariance=interleave_xyz(scaled.covariance))
        if self.proof:
            fit = with_certificate(fit, lifting, is_of_fit=False)
        return self.with_verdicts(fit, lifting)

    def with_verdicts(self, fit: Fit, lifting: Lifting[PosteriorEstimate]) -> Fit:
        """Return the fit with `trusted`, `reasons` and `expected_error` of each image.

        A reason is one of those in `trust`, or "" where the image is trusted.
        """
        estimate = lifting.estimate
        assert estimate.covariance is not None, "asked for with a calibration"
        assert estimate.p_value is not None, "added to what was lifted"
        assert estimate.start_distance is not None, "likewise"
        shown = self.posterior.shown
        expected = trust.expected_error(lifting.shapes, estimate.covariance, shown)
        expected *= lifting.scale
        if estimate.image_error is not None:
            least = trust.SEQUENCE_ERROR_SHARE * estimate.image_error
            expected = np.fmax(expected, least)
        reasons = trust.find_reasons(
            lifting.shapes,
            expected,
            np.isfinite(estimate.inlier_probability).sum(axis=1),
            estimate.p_value,
            estimate.start_distance,
            estimate.status,
            sides=estimate.sides_exchanged,
            depth_ambiguity=self.dictionary.depth_ambiguity,
            shown=shown,
        )
        reasons[reasons == ""] = self.reason
        return replace(
            fit, trusted=reasons == "", reasons=reasons, expected_error=expected
        )


def interleave_xyz(covariance: Floats | None) -> Floats | None:
    """Reorder a covariance (n, 3p, 3p): x, y, z of a landmark next to each other."""
    if covariance is None:
        return None
    n, d, _ = covariance.shape
    blocks = covariance.reshape(n, 3, d // 3, 3, d // 3).transpose(0, 2, 1, 4, 3)
    return blocks.reshape(n, d, d)
