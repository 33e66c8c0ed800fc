"""What a result file holds is enough to prove its optimum, with NumPy and without shapefit."""

from __future__ import annotations

import h5py
import numpy as np
import pytest

from shapefit.config import FitConfig
from shapefit.dictionary.model import Dictionary
from shapefit.errors import InputError
from shapefit.geometry.normalisation import normalise
from shapefit.io import LandmarkSet, landmark_writer, write_dictionary
from shapefit.pipelines.fit import run

N, K, P = 12, 6, 10
NAMES = tuple(f"point{j}" for j in range(P))


@pytest.fixture
def files(tmp_path, rng):
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
    with landmark_writer(tmp_path / "landmarks.h5") as writer:
        writer.append(images)
    write_dictionary(
        tmp_path / "dictionary.h5", Dictionary(atoms, NAMES, normalise(atoms.mean(0)).points)
    )
    config = FitConfig(
        landmarks=[str(tmp_path / "landmarks.h5")],
        dictionary=str(tmp_path / "dictionary.h5"),
        output=str(tmp_path / "result.h5"),
        lam=0.3,
        transforms=True,
        solver={"tolerance": 1e-9},
    )
    list(run(config))
    return config.output, atoms


def test_objective_and_gap_follow_from_the_datasets(files):
    result, atoms = files
    with h5py.File(result) as file:
        data = {name: file[name][()] for name in file}
    W = data["landmarks"].transpose(0, 2, 1)
    seen = np.isfinite(W).all(axis=1)
    assert seen.sum(axis=1).tolist() == [P - 2] * N
    omega = np.where(seen, data["confidence"], 0.0)
    for i in range(N):
        w, at, weights = W[i][:, seen[i]], atoms[:, :, seen[i]], omega[i, seen[i]]
        w = (w - w.mean(axis=1, keepdims=True)) / w.std(axis=1).mean()
        fitted = np.einsum("kab,kbp->ap", data["transforms"][i], at)
        T = ((w - fitted) * weights**2).sum(axis=1) / (weights**2).sum()
        residual = weights * (w - fitted - T[:, None])
        norms = np.linalg.norm(data["transforms"][i], ord=2, axis=(1, 2))
        lam = data["lambda"][i]
        primal = 0.5 * (residual**2).sum() + lam * norms.sum()
        assert primal == pytest.approx(data["objective"][i], rel=1e-9)
        nuclear = np.linalg.svd((residual * weights) @ at.transpose(0, 2, 1), compute_uv=False)
        Y = residual * min(1.0, lam / nuclear.sum(axis=1).max())
        dual = (Y * weights * w).sum() - 0.5 * (Y**2).sum()
        assert -1e-12 <= primal - dual <= 1e-5 * primal  # a plainer Y than fit has
        assert data["relative_gap"][i] <= 1e-9


@pytest.mark.parametrize("key", ["path", "transforms"])
def test_no_file_of_points_is_asked_to_hold_more(files, tmp_path, key):
    config = FitConfig(
        landmarks=[str(tmp_path / "landmarks.h5")],
        dictionary=str(tmp_path / "dictionary.h5"),
        output=str(tmp_path / "result.csv"),
        **{key: {"path": (1.0, 0.1), "transforms": True}[key]},
    )
    with pytest.raises(InputError, match=f"{key}: asks for what .*csv cannot hold"):
        list(run(config))
    assert not config.output.exists()
