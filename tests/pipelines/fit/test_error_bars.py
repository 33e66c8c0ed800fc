"""Error bars become true by the factors of a report."""

import json

import pytest
from numpy.testing import assert_allclose

from shapefit.config import EvalConfig
from shapefit.errors import InputError
from shapefit.pipelines.evaluate.run import evaluate_results


@pytest.fixture
def evaluated(people, project, tmp_path, lift_sequences):
    """Fit by a method, and evaluate: the result, and the share of the truth in its 90%
    ellipsoids.
    """

    def evaluate(method, **prior):
        result, _ = lift_sequences(people.views, method=method, prior=prior)
        config = EvalConfig(
            results={method: tmp_path / "result.h5"},
            output=tmp_path / "report",
            plots="none",
            truth=(project / "sample_data/people_test.h5",),
            truth_frame="object",
        )
        list(evaluate_results(config))
        return result, inside_of_90(tmp_path / "report/report.json")

    return evaluate


def inside_of_90(report):
    """Return the share of the truth in the 90% ellipsoids that a report tells."""
    rows = json.loads(report.read_text(encoding="utf-8"))["calibration"]
    (of_all,) = [row for row in rows if row["group"] == "all"]
    _in_50, in_90 = of_all["inside"]
    return in_90


BY_HIDDEN_LANDMARKS = [("posterior", 0.05), ("sequences", 0.07)]
"""A method, and how far its bars may be off by hidden landmarks alone."""


@pytest.mark.parametrize(("method", "tolerance"), BY_HIDDEN_LANDMARKS)
def test_bars_too_narrow_become_true_by_a_report(
    evaluated, tmp_path, method, tolerance
):
    """Bars of sequences have a share of those of images, which limbs narrow."""
    narrow, inside = evaluated(method, bar_scale=0.05)
    factors_file = (tmp_path / "report/error_bars.json").rename(tmp_path / "rig.json")
    factors = json.loads(factors_file.read_text(encoding="utf-8"))
    factor = factors[method]["90%"]
    wide, inside_of_wide = evaluated(method, bar_scale=0.05, calibration=factors_file)
    assert inside == pytest.approx(0.9, abs=tolerance)
    assert_allclose(wide.points, narrow.points, rtol=1e-6)
    assert_allclose(wide.shape_sd, factor * narrow.shape_sd, rtol=1e-5)
    assert inside_of_wide == pytest.approx(0.9, abs=0.01)


NO_FACTORS = [
    "{",
    '{"posterior": {"90%": -2}}',
    '{"posterior": {"50%": 1, "90%": null}}',
    '{"a": {"50%": 1, "90%": 2}, "b": {"50%": 1, "90%": 2}}',
]


@pytest.mark.parametrize("text", NO_FACTORS)
def test_a_file_without_factors_is_refused(people, lift_sequences, tmp_path, text):
    path = tmp_path / "rig.json"
    path.write_text(text, encoding="utf-8")
    prior = {"calibration": path}
    with pytest.raises(InputError, match="no factors of error bars of posterior"):
        lift_sequences(people.views, method="posterior", prior=prior)
