"""`method: posterior` from files to files."""

from dataclasses import replace

import h5py
import numpy as np
import pytest

from shapefit.dictionary.mixture import Mixture
from shapefit.errors import InputError
from shapefit.io import read_dictionary, write_dictionary
from shapefit.lifting import trust
from tests.pipelines.told import failures


@pytest.fixture
def with_prior(dictionary, atoms, rng):
    """The dictionary with a prior of two Gaussians about its atoms."""
    known = read_dictionary(dictionary)
    B = 0.1 * rng.standard_normal((2, 30, 30))
    C = B @ B.swapaxes(1, 2) / 30 + 0.01 * np.eye(30)
    means = 5 * np.stack([atoms[:3].mean(axis=0), atoms[3:].mean(axis=0)])
    write_dictionary(dictionary, replace(known, prior=Mixture(np.array([0.7, 0.3]), means, C)))
    return dictionary


def test_results_hold_error_bars_in_the_unit_of_the_landmarks(fit, with_prior, images):
    keys = {"method": "posterior", "save": {"covariance": True}}
    keys |= {"camera": {"focal": "none"}}
    found, _ = fit(with_prior, images, **keys)
    covariance = found.columns["shape_covariance"]
    assert covariance.shape == (8, 30, 30)
    variance = np.diagonal(covariance, axis1=1, axis2=2).reshape(8, 10, 3)
    assert found.shape_sd.swapaxes(1, 2) ** 2 == pytest.approx(variance)
    blocks = covariance.reshape(8, 10, 3, 10, 3)
    sd, correlation = found.shape_sd.swapaxes(1, 2), found.columns["shape_correlation"]
    for row, (a, b) in enumerate(((0, 1), (0, 2), (1, 2))):
        own = np.einsum("npp->np", blocks[:, :, a, :, b]) / (sd[..., a] * sd[..., b])
        assert correlation[..., row] == pytest.approx(own, abs=1e-6)
    assert ((found.columns["p_value"] >= 0) & (found.columns["p_value"] <= 1)).all()
    assert set(found.status) == {"converged"}
    larger = images.replaced(landmarks=10 * images.landmarks)
    grown, _ = fit(with_prior, larger, **keys)
    assert grown.shape_sd == pytest.approx(10 * found.shape_sd, rel=1e-4)


def test_noise_widens_and_a_covariance_of_each_landmark_takes_its_place(fit, with_prior, images):
    keys = {"method": "posterior", "camera": {"focal": "none"}}
    plain, _ = fit(with_prior, images, **keys)
    noisy, _ = fit(with_prior, images, noise=2.0, **keys)
    assert np.median(noisy.shape_sd[:, :2]) > np.median(plain.shape_sd[:, :2])
    each = np.tile(4.0 * np.eye(2), (8, 10, 1, 1))
    told = images.replaced(further={**images.further, "landmark_covariance": each})
    same, _ = fit(with_prior, told, **keys)
    assert same.shapes == pytest.approx(noisy.shapes)
    wrong = images.replaced(further={"landmark_covariance": -each})
    fit(with_prior, wrong, method="convex")  # which does not use it
    with pytest.raises(InputError, match="no covariance"):
        fit(with_prior, wrong, method="posterior")


def test_implausible_images_are_reported_and_keep_their_status(
    fit, with_prior, images, monkeypatch
):
    monkeypatch.setattr(trust, "LIMITS", replace(trust.LIMITS, min_p_value=0.999999))
    keys = {"camera": {"focal": "none"}}
    found, outcomes = fit(with_prior, images, method="posterior", **keys)
    (reasons,) = [reasons for out in outcomes for reasons in out.reasons]
    assert reasons.text == "implausible landmarks"
    assert set(reasons.items) == set(found.items)
    assert not found.columns["trusted"].any()
    assert set(found.columns["reasons"]) == {"implausible landmarks"}
    assert set(found.status) == {"converged"}


def test_a_known_camera_is_looked_through(fit, tmp_path, with_prior, images):
    """Images far from a long lens are those of weak perspective; a proof and a place come along."""
    keys = {"method": "posterior", "save": {"covariance": True, "proof": True}}
    weak, _ = fit(with_prior, images, camera={"focal": "none"}, **keys)
    camera = {"focal": 1e7, "principal_point": [100.0, 50.0]}
    found, outcomes = fit(with_prior, images, camera=camera, **keys)
    assert found.shapes == pytest.approx(weak.shapes, abs=1e-3)
    assert found.shape_sd == pytest.approx(weak.shape_sd, rel=1e-3, abs=1e-4)
    assert found.landmarks_fitted == pytest.approx(weak.shapes[:, :2], abs=1e-3)
    assert found.columns["camera_translation"][:, 2] == pytest.approx(1e7 / found.scale, rel=1e-6)
    with h5py.File(tmp_path / "result.h5") as file:
        assert np.isfinite(file["dual"][:]).all()
    assert not failures(outcomes)
    near = {"focal": 60.0, "principal_point": [80.0, 50.0]}
    other, _ = fit(with_prior, images, camera=near, **keys)
    assert np.abs(other.landmarks_fitted - other.shapes[:, :2]).max() > 0.1
    names = ("shape_covariance", "camera_translation", "focal", "principal_point")
    assert all(np.isfinite(other.columns[name]).all() for name in names)
