"""What the posterior of an image is made of, and how its error bars are reported."""

from __future__ import annotations

from dataclasses import dataclass

from shapefit.arrays import Floats
from shapefit.dictionary.mixture import Mixture, widen
from shapefit.dictionary.model import Dictionary
from shapefit.lifting.posterior.p_value import moments_at
from shapefit.lifting.posterior.posterior import OUTLIERS, Outliers
from shapefit.lifting.posterior.usual_lengths import LimbLengths

RESIDUAL_VARIANCE = 0.01
"""Of a coordinate of normalised landmarks, where the dictionary knows none."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class PosteriorModel:
    """The prior over shapes, the errors of landmarks, and factors on error bars.

    prior over normalised shapes, of landmarks whose mean_shape is (3, p);
    residual_variance, what the model cannot explain of a coordinate of normalised
    landmarks at confidence 1; outliers, landmarks that are something else;
    p_value_table (c, 3), moments of distances under the prior, None if nobody asks for
    p-values; limbs, usual lengths that the limbs of single images are to have.

    bar_scale, factor of all covariances, for bodies and motions that the prior lacks;
    growth (p,), factors of those of landmarks beyond it, empty for none; covariance,
    whether that of all landmarks together is wanted.
    """

    prior: Mixture
    mean_shape: Floats
    residual_variance: float = RESIDUAL_VARIANCE
    outliers: Outliers = OUTLIERS
    p_value_table: Floats | None = None
    limbs: LimbLengths | None = None
    bar_scale: float = 1.0
    growth: tuple[float, ...] = ()
    covariance: bool = False


def make_model(
    dictionary: Dictionary,
    residual_variance: float,
    *,
    prior_scale: float = 1.0,
    limbs: LimbLengths | None = None,
    bar_scale: float = 1.0,
    growth: tuple[float, ...] = (),
    covariance: bool = False,
) -> PosteriorModel:
    """Return the model of landmarks under a dictionary's prior, which must be there.

    prior_scale: factor of the prior's covariances; the rest as in `PosteriorModel`.
    """
    assert dictionary.prior is not None, "checked with what the method needs"
    table = dictionary.p_value_table
    return PosteriorModel(
        prior=widen(dictionary.prior, prior_scale),
        mean_shape=dictionary.mean_shape,
        residual_variance=residual_variance,
        p_value_table=None if table is None else moments_at(table, prior_scale),
        limbs=limbs,
        bar_scale=bar_scale,
        growth=growth,
        covariance=covariance,
    )
