"""What a result file holds is enough to prove its optimum, with NumPy and without shapefit."""

import h5py
import numpy as np
import pytest

from shapefit.dictionary.model import Dictionary
from shapefit.geometry.normalisation import normalise
from shapefit.io import LandmarkSet, write_dictionary

N, K, P = 12, 6, 10
NAMES = tuple(f"point{j}" for j in range(P))


@pytest.fixture
def files(fit, tmp_path, rng):
    """A result of hidden and half believed landmarks, and the atoms."""
    atoms = normalise(rng.standard_normal((K, 3, P))).points
    landmarks = 100 + 20 * rng.standard_normal((N, 2, P))
    landmarks[:, :, 2] = np.nan
    confidence = rng.uniform(0.2, 1.5, (N, P))
    confidence[:, 4] = 0
    images = LandmarkSet(
        landmarks=landmarks,
        landmark_names=NAMES,
        items=tuple(f"image{i}" for i in range(N)),
        confidence=confidence,
    )
    dictionary = tmp_path / "dictionary.h5"
    write_dictionary(dictionary, Dictionary(atoms, NAMES, normalise(atoms.mean(0)).points))
    fit(dictionary, images, lam=0.3)
    return tmp_path / "result.h5", atoms


def test_objective_and_gap_follow_from_the_datasets(files):
    result, atoms = files
    with h5py.File(result) as file:
        data = {name: file[name][()] for name in file}
    W = data["landmarks"].transpose(0, 2, 1)
    visible = np.isfinite(W).all(axis=1)
    assert visible.sum(axis=1).tolist() == [P - 2] * N
    omega = np.where(visible, data["confidence"], 0.0)
    starts = np.cumsum(data["transform_count"]) - data["transform_count"]
    for i in range(N):
        w, at, weights = W[i][:, visible[i]], atoms[:, :, visible[i]], omega[i, visible[i]]
        w = (w - w.mean(axis=1, keepdims=True)) / w.std(axis=1).mean()
        mine = slice(starts[i], starts[i] + data["transform_count"][i])
        M, used = data["active_transforms"][mine], data["transform_atom"][mine]
        fitted = np.einsum("kab,kbp->ap", M, at[used])
        residual = weights * (w - fitted - data["convex_translation"][i][:, None])
        norms = np.linalg.norm(M, ord=2, axis=(1, 2))
        lam = data["lambda"][i]
        primal = 0.5 * (residual**2).sum() + lam * norms.sum()
        assert primal == pytest.approx(data["objective"][i], rel=1e-12)
        Y = data["dual"][i].T[:, visible[i]]
        assert np.abs(Y @ weights).max() <= 1e-12
        nuclear = np.linalg.svd((Y * weights) @ at.transpose(0, 2, 1), compute_uv=False)
        assert nuclear.sum(axis=1).max() <= lam * (1 + 1e-12)
        dual = (Y * weights * w).sum() - 0.5 * (Y**2).sum()
        gap = (primal - dual) / primal
        assert gap == pytest.approx(data["relative_gap"][i], abs=1e-12)
        assert 0 <= gap <= 1e-4
