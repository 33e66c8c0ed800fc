"""`fit` with each loss: what belongs to one and not to others."""

from __future__ import annotations

import itertools
from types import SimpleNamespace

import numpy as np
import pytest

from shapefit.dictionary.model import Dictionary
from shapefit.io import write_dictionary

NAMES = tuple(f"point{j}" for j in range(10))


class TestFamily:
    @pytest.mark.parametrize("loss", ["sparse-error", "l1"])
    def test_robust_losses_find_the_planted_outliers(self, fit, tmp_path, atoms, images, loss):
        one = tmp_path / "one.h5"  # with more atoms than landmarks need, anything fits
        write_dictionary(one, Dictionary(atoms[:1], NAMES, atoms[0]))
        few = images.take([0, 6])  # the ones that show this atom
        few.landmarks[np.arange(2), 0, np.arange(2)] += 30
        wrong = np.eye(2, 10, dtype=bool)
        found, _ = fit(
            tmp_path, one, few, outliers={"method": loss, "threshold": 0.2}, **{"lambda": 0.01}
        )
        judged = found.extras["outliers"].astype(bool)
        assert judged[wrong].all()
        # its pull is bounded, not ended: another landmark may come to lie beyond
        assert (judged & ~wrong).sum() <= (1 if loss == "sparse-error" else 0)
        plain, _ = fit(tmp_path, one, few)
        assert "outliers" not in plain.extras
        good = ~wrong
        robust, squared = (
            np.linalg.norm(part.landmarks_fitted - few.landmarks, axis=1)[good].max()
            for part in (found, plain)
        )
        assert robust < (0.5 if loss == "l1" else 3.0) < squared

    def test_the_exact_loss_leaves_no_residual(self, fit, tmp_path, dictionary, images):
        found, _ = fit(tmp_path, dictionary, images, loss="exact", solver={"tolerance": 1e-8})
        assert found.extras["residual"].max() < 1e-8

    def test_lambda_follows_the_noise(self, fit, tmp_path, dictionary, images):
        low, _ = fit(tmp_path, dictionary, images, **{"lambda": "auto", "noise": 0.5})
        high, _ = fit(tmp_path, dictionary, images, **{"lambda": "auto", "noise": 1.0})
        np.testing.assert_allclose(high.extras["lambda"], 2 * low.extras["lambda"])
        np.testing.assert_allclose(
            low.extras["lambda"] * low.scale, low.extras["lambda"][0] * low.scale[0]
        )

    def test_the_time_is_that_of_solving_all_chunks(
        self, fit, tmp_path, dictionary, views, monkeypatch
    ):
        """By a clock that ticks once whenever it is looked at."""
        clock = SimpleNamespace(perf_counter=itertools.count().__next__)
        monkeypatch.setattr("shapefit.pipelines.fit.run.time", clock)
        found, _ = fit(tmp_path, dictionary, views, chunk=64)
        assert found.attributes["solve_seconds"] == 4
        assert found.attributes["images_per_second"] == pytest.approx(193 / 4)
