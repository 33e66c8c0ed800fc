"""A dictionary adapted to 2D landmarks: of one person, one detector, one laboratory."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from shapefit.config import FitConfig
from shapefit.dictionary.from_2d.adaptation import Start, adapt
from shapefit.dictionary.model import Dictionary
from shapefit.errors import counted, input_error
from shapefit.geometry.normalisation import spread
from shapefit.io import LandmarkSource
from shapefit.io.records import concatenate
from shapefit.pipelines.fit.plan import find_misfit, plan_fit
from shapefit.pipelines.fit.read import read_images
from shapefit.pipelines.learn_dict.from_2d import FEWEST_IMAGES, images_of, says_something, too_few
from shapefit.pipelines.learn_dict.hidden import lift_by, predict_hidden
from shapefit.pipelines.learn_dict.prior import find_groups
from shapefit.pipelines.outcome import Outcome

PARTS = 5
"""Parts of the images, whole sequences where there are some, of which one judges."""

LEAST_GAIN = 0.01
"""Log density of a hidden landmark that the adapted prior must bring, beyond its standard error."""

BELIEVED = 0.5
"""Chance that a landmark is not gross, as the start has it, below which it is hidden."""


def adapt_to_landmarks(
    source: LandmarkSource, start: Dictionary, config: FitConfig
) -> Generator[Outcome, None, Dictionary]:
    """Adapt the prior of a dictionary to the images; an outcome a round.

    config says where images and dictionary are; the start counts as many images as there are.
    What is learned of four fifths of the images must predict the landmarks of the rest better than
    the start does. Raises InputError where it does not.
    """
    place = ", ".join(map(str, config.landmarks))
    plan = plan_fit(config, start, source.head.landmark_names)
    start = plan.dictionary
    joints, seen_start = plan.mapped, plan.mapped.see(start)
    A = joints.joints.matrix(joints.theta) if joints.active else np.eye(len(start.landmark_names))
    given = concatenate(list(read_images(source, plan.read)))
    some = given.take(says_something(given))
    found = lift_by(some, seen_start, "posterior") if len(some) else None
    lifted = np.zeros(0, bool) if found is None else np.isfinite(found.shapes).all(axis=(1, 2))
    if found is None or lifted.sum() < FEWEST_IMAGES:
        raise too_few(int(lifted.sum()), source.count, place)
    belief = found.estimate.further["belief"]
    seen = np.nan_to_num(belief) > BELIEVED
    some = some.replaced(landmarks=np.where(seen[:, None], some.landmarks, np.nan))
    fine = np.flatnonzero(lifted & says_something(some))
    some, shapes = some.take(fine), found.shapes[fine]
    out = find_groups(some.sequences, len(some), PARTS) == 0

    def adapted(rows: NDArray[np.bool_]) -> Generator[Outcome, None, Dictionary]:
        assert start.prior is not None, "the plan needs one"
        made, images = start.prior, some.take(rows)
        single = images_of(images.replaced(sequences=None))
        size = spread(images.landmarks, images.seen())[:, None, None]
        of_start = Start(
            prior=start.prior,
            landmark_map=A,
            noise=find_misfit(config, start),
            weight=len(images),
        )
        for mixture, objective in adapt(single, shapes[rows] / size, of_start):
            made = mixture
            per = objective / (2 * int((single.weights > 0).sum()))
            yield Outcome(done=1, unit="round", note=f"objective {per:.3f} a coordinate")
        return replace(start, prior=made)

    judged = some.take(out)
    trial = yield from adapted(~out)
    before, after = predict_hidden(judged, seen_start), predict_hidden(judged, joints.see(trial))
    gain = after.log_density - before.log_density
    gain = gain[np.isfinite(gain)]
    deviation = gain.std() / np.sqrt(len(gain)) if len(gain) else np.nan
    said = (
        f"hidden landmarks of {counted(len(judged), 'image')} left out predicted to "
        f"{after.error:.4f} of the size of an image, {before.error:.4f} by the start, log density "
        f"{gain.mean():+.3f} +- {deviation:.3f}"
    )
    if not gain.mean() > deviation + LEAST_GAIN:
        fix = "take the start as it is, or give more images"
        raise input_error(place, f"the start is as good without them: {said}", fix)
    whole = yield from adapted(np.ones(len(some), bool))
    yield Outcome(line=f"{counted(len(some), 'image')}: adapted; {said}")
    return whole
