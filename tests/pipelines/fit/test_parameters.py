"""The tops that the search for parameters of a skeleton finds are those of planted parabolas."""

import numpy as np
import pytest

from shapefit.pipelines.fit.prepare import STEPS, THETA, maximise_theta

SHARP = 1e4


@pytest.mark.parametrize("top", [-0.19, -0.12, 0.0, 0.07, 0.16, 0.21])
def test_a_top_within_the_steps_is_found(top):
    name = next(iter(THETA))
    start = {name: THETA[name].mean}
    at = np.log(THETA[name].mean) + top

    def evidence(theta):
        return -0.5 * SHARP * (np.log(theta[name]) - at) ** 2

    theta, deviation = maximise_theta(evidence, [name], start)
    whole = SHARP + THETA[name].std ** -2
    expected = (SHARP * at + np.log(THETA[name].mean) * THETA[name].std ** -2) / whole
    assert np.log(theta[name]) == pytest.approx(expected, abs=1e-9)
    assert deviation[name] == pytest.approx(whole**-0.5)


def test_a_top_far_away_is_approached_by_the_widest_steps():
    name = next(iter(THETA))
    theta, _ = maximise_theta(lambda theta: 100 * np.log(theta[name]), [name], {name: 1.0})
    assert np.log(theta[name]) == pytest.approx(1.5 * STEPS[-1])
