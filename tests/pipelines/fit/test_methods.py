"""What belongs to one method or loss and not to others: results, and kinds of dictionaries."""

from dataclasses import replace

import numpy as np
import pytest

from shapefit.config import FitConfig
from shapefit.dictionary.model import Dictionary
from shapefit.errors import InputError
from shapefit.io import read_dictionary, write_dictionary
from shapefit.pipelines.fit.prepare import warn_of_dictionary

NAMES = tuple(f"point{j}" for j in range(10))


class TestFamily:
    @pytest.mark.parametrize("loss", ["sparse-error", "l1"])
    def test_robust_losses_find_the_planted_outliers(self, fit, tmp_path, atoms, images, loss):
        one = tmp_path / "one.h5"  # with more atoms than landmarks need, anything fits
        write_dictionary(one, Dictionary(atoms[:1], NAMES, atoms[0]))
        few = images.take([0, 6])  # the ones that show this atom
        few.landmarks[np.arange(2), 0, np.arange(2)] += 30
        wrong = np.eye(2, 10, dtype=bool)
        found, _ = fit(one, few, outliers=loss, outlier_threshold=0.2, **{"lambda": 0.01})
        judged = found.columns["outliers"].astype(bool)
        assert judged[wrong].all()
        # its pull is bounded, not ended: another landmark may come to lie beyond
        assert (judged & ~wrong).sum() <= (1 if loss == "sparse-error" else 0)
        plain, _ = fit(one, few)
        assert "outliers" not in plain.columns
        good = ~wrong
        robust, squared = (
            np.linalg.norm(part.shapes[:, :2] - few.landmarks, axis=1)[good].max()
            for part in (found, plain)
        )
        assert robust < (0.5 if loss == "l1" else 3.0) < squared

    def test_lambda_follows_the_noise(self, fit, dictionary, images):
        low, _ = fit(dictionary, images, **{"lambda": "auto", "noise": 0.5})
        high, _ = fit(dictionary, images, **{"lambda": "auto", "noise": 1.0})
        np.testing.assert_allclose(high.columns["lambda"], 2 * low.columns["lambda"])
        np.testing.assert_allclose(
            low.columns["lambda"] * low.scale, low.columns["lambda"][0] * low.scale[0]
        )


@pytest.mark.parametrize(
    ("learned", "method", "made_for"),
    [
        ("pca-bases", "convex", "convex is made for sparse-coding or exemplars"),
        ("pca-bases", "alternate", "alternate is made for sparse-coding or exemplars"),
        ("sparse-coding", "pmp", "pmp is made for pca-bases"),
        ("exemplars", "pmp", "pmp is made for pca-bases"),
        ("pca-bases", "pmp", None),
        ("pca-bases", "mean-shape", None),
        ("sparse-coding", "convex+refine", None),
        ("exemplars", "convex", None),
        (None, "pmp", None),
    ],
)
def test_bases_belong_to_pmp_and_atoms_to_the_others(learned, method, made_for):
    provenance = {} if learned is None else {"method": learned}
    dictionary = Dictionary(np.ones((1, 3, 2)), ("a", "b"), np.ones((3, 2)), provenance=provenance)
    told = warn_of_dictionary(FitConfig.model_construct(method=method), dictionary)
    assert len(told) == (made_for is not None)
    if made_for:
        assert f"learned with `method: {learned}`; {made_for}" in told[0]


@pytest.mark.parametrize(
    ("edges", "size", "found"),
    [
        (None, 1.0, "no `edges`"),
        ([[0, 1], [2, 2]], 1.0, "every edge of `mean_shape` has length 0"),
    ],
    ids=["missing", "coincident"],
)
def test_pmp_refuses_a_dictionary_whose_limbs_have_no_length(
    fit, dictionary, images, edges, size, found
):
    plain = read_dictionary(dictionary)
    mean = plain.mean_shape * size
    mean[:, 1] = mean[:, 0]
    edges = None if edges is None else np.asarray(edges)
    write_dictionary(dictionary, replace(plain, mean_shape=mean, edges=edges))
    with pytest.raises(InputError) as error:
        fit(dictionary, images, method="pmp")
    assert str(error.value) == (
        f"{dictionary}: {found}: the limbs whose lengths pmp keeps; "
        "learn it with `method: pca-bases` from shapes with edges"
    )
