"""A fit reports a dictionary of a kind that its method is not made for or cannot use."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from shapefit.config import FitConfig
from shapefit.dictionary.model import Dictionary
from shapefit.errors import InputError
from shapefit.io import read_dictionary, write_dictionary
from shapefit.pipelines.fit.plan import mismatch


@pytest.mark.parametrize(
    ("learned", "method", "made_for"),
    [
        ("pca-bases", "convex", "convex is made for `sparse-coding` or `exemplars`"),
        ("pca-bases", "alternate", "alternate is made for `sparse-coding` or `exemplars`"),
        ("sparse-coding", "pmp", "pmp is made for `method: pca-bases`"),
        ("exemplars", "pmp", "pmp is made for `method: pca-bases`"),
        ("pca-bases", "pmp", None),
        ("pca-bases", "mean-shape", None),
        ("sparse-coding", "convex+refine", None),
        ("exemplars", "convex", None),
        (None, "pmp", None),
        (None, "convex", None),
    ],
)
def test_bases_belong_to_pmp_and_atoms_to_the_others(learned, method, made_for):
    provenance = {} if learned is None else {"method": learned}
    dictionary = Dictionary(np.ones((1, 3, 2)), ("a", "b"), np.ones((3, 2)), provenance=provenance)
    told = mismatch(FitConfig.model_construct(method=method), dictionary)
    assert len(told) == (made_for is not None)
    if made_for:
        assert f"learned with `method: {learned}`; {made_for}" in told[0]


def test_signed_coefficients_may_meet_bases(project, tmp_path):
    dictionary = Dictionary(
        np.ones((1, 3, 2)), ("a", "b"), np.ones((3, 2)), provenance={"method": "pca-bases"}
    )
    views = str(project / "sample_data/people_views.csv")
    config = FitConfig(
        landmarks=[views], dictionary=views, output=str(tmp_path / "r.h5"), method="alternate",
        alternation={"signed": True},
    )  # fmt: skip
    assert mismatch(config, dictionary) == ()


@pytest.mark.parametrize(
    ("edges", "size", "found"),
    [
        (None, 1.0, "no `edges`"),
        (np.empty((0, 2), np.int64), 1.0, "`edges` is empty"),
        ([[0, 1], [2, 2]], 1.0, "every edge of `mean_shape` has length 0"),
        ([[0, 9]], 1e-170, "every edge of `mean_shape` has length 0"),
    ],
    ids=["missing", "empty", "coincident", "underflow"],
)
def test_pmp_refuses_a_dictionary_whose_limbs_have_no_length(
    fit, tmp_path, dictionary, images, edges, size, found
):
    plain = read_dictionary(dictionary)
    mean = plain.mean_shape * size
    mean[:, 1] = mean[:, 0]
    edges = None if edges is None else np.asarray(edges)
    write_dictionary(dictionary, replace(plain, mean_shape=mean, edges=edges))
    with pytest.raises(InputError) as error:
        fit(tmp_path, dictionary, images, method="pmp")
    assert str(error.value) == (
        f"{dictionary}: {found}: the limbs whose lengths pmp keeps; "
        "learn it with `method: pca-bases` from shapes with edges"
    )
