"""The method that a fit chooses, and what is said of the dictionary."""

from dataclasses import replace

import numpy as np
import pytest

from shapefit.config import FitConfig, load_config
from shapefit.config.paths import find_dictionaries
from shapefit.dictionary.model import Dictionary
from shapefit.errors import InputError
from shapefit.io import (
    read_dictionary,
    write_dictionary,
)
from shapefit.lifting.methods import METHODS
from shapefit.pipelines.fit.choices import (
    MAX_USUAL_ATOM_NORM,
    MIN_SEQUENCE_FRAMES,
    are_in_sequences,
    are_long,
    choose_method,
    warn_of_dictionary,
)
from shapefit.records import Landmarks
from tests.io.files import save

ALL_IMAGES = ("a",) * MIN_SEQUENCE_FRAMES
"""Sequences of images that are all of one sequence."""


@pytest.fixture
def chosen(tmp_path):
    """The config of a fit of images of these sequences, and the line about its
    method.
    """

    def find(sequences, dictionary="people", overrides=()):
        count = len(sequences) if sequences else 2
        images = Landmarks(
            np.zeros((count, 4, 2)),
            landmark_names=tuple("abcd"),
            items=tuple(map(str, range(count))),
            sequences=sequences,
        )
        path = tmp_path / "images.h5"
        save(path, images)
        files = {
            "landmarks": str(path),
            "dictionary": str(dictionary),
            "output": str(tmp_path / "result.h5"),
        }
        config = load_config("fit", None, overrides, files)
        read = read_dictionary(config.dictionary)
        return choose_method(config, read, lambda: are_in_sequences(config))

    return find


CHOSEN_BY_SEQUENCES = [
    (None, "posterior"),
    (ALL_IMAGES, "sequences"),
    (ALL_IMAGES[1:], "posterior"),
    (ALL_IMAGES + tuple("bcdefghij"), "sequences"),
    (ALL_IMAGES + tuple("bcdefghijklm"), "posterior"),
]


@pytest.mark.parametrize(("sequences", "method"), CHOSEN_BY_SEQUENCES)
def test_half_of_the_images_decide_whether_there_are_sequences(
    chosen, sequences, method
):
    config, line = chosen(sequences)
    assert config.method == method
    assert line == f"{method} (the dictionary has a prior; change with --method)"


ASKED_FOR = [
    (["method=sequences"], "sequences", 0.01),
    (["method=posterior", "prior.residual_variance=0.3"], "posterior", 0.3),
    (["method=convex"], "convex", None),
    (["outliers=l1"], "convex", None),
    (["leave_one_out=item"], "convex", None),
    (["prior.scale=2"], "sequences", 0.01),
]
"""Keys, and the method and variance that follow."""


@pytest.mark.parametrize(("overrides", "method", "residual_variance"), ASKED_FOR)
def test_the_method_has_what_the_config_asks_for(
    chosen, overrides, method, residual_variance
):
    config, _ = chosen(ALL_IMAGES, overrides=overrides)
    assert config.method == method
    assert config.prior.residual_variance == residual_variance


@pytest.fixture
def own_people():
    """The installed dictionary as if users had learned it."""
    people = read_dictionary(find_dictionaries()["people"])
    provenance = dict(people.provenance)
    del provenance["suits"]
    return replace(people, provenance=provenance)


def test_people_of_ones_own_have_the_variance_of_joints(chosen, own_people, tmp_path):
    path = tmp_path / "own.h5"
    write_dictionary(path, own_people)
    config, _ = chosen(None, path)
    assert config.method == "posterior"
    assert config.prior.residual_variance == 0.006


def test_other_objects_have_no_usual_variance(chosen, own_people, tmp_path):
    path = tmp_path / "animal.h5"
    write_dictionary(path, replace(own_people, edge_length=None))
    config, _ = chosen(None, path)
    assert config.method == "posterior"
    assert config.prior.residual_variance is None


def test_a_dictionary_without_a_prior_has_no_keys_of_it(chosen, own_people, tmp_path):
    path = tmp_path / "atoms.h5"
    write_dictionary(path, replace(own_people, prior=None, p_value_table=None))
    config, _ = chosen(None, path)
    fault = r"the method convex has no prior; `prior\.scale` needs"
    assert config.method == "convex"
    with pytest.raises(InputError, match=fault):
        chosen(None, path, ["prior.scale=2"])


def warnings_about(method, dictionary):
    config = FitConfig.model_construct(method=method)
    return warn_of_dictionary(config, dictionary)


MADE_FOR_OTHERS = [
    ("pca-bases", "convex", "sparse-coding or exemplars"),
    ("pca-bases", "alternate", "sparse-coding or exemplars"),
    ("sparse-coding", "pmp", "pca-bases"),
    ("exemplars", "pmp", "pca-bases"),
]
"""What a dictionary was learned with, a method, and what that is made for."""


MADE_FOR_EACH_OTHER = [
    ("pca-bases", "pmp"),
    ("pca-bases", "mean-shape"),
    ("sparse-coding", "convex+refine"),
    ("exemplars", "convex"),
    (None, "pmp"),
]


def learned_with(method):
    """Return a dictionary that says how it was learned, or does not for None."""
    provenance = {} if method is None else {"method": method}
    atoms = np.ones((1, 3, 2))
    return Dictionary(atoms, ("a", "b"), atoms[0], provenance=provenance)


def test_auto_is_no_method_with_starts(chosen):
    with pytest.raises(InputError, match="does not support `starts`; use"):
        chosen(None, overrides=["starts=1"])


@pytest.mark.parametrize(("learned", "method", "made_for"), MADE_FOR_OTHERS)
def test_bases_belong_to_pmp_and_atoms_to_the_others(learned, method, made_for):
    (warning,) = warnings_about(method, learned_with(learned))
    fault = f"the dictionary was learned with `method: {learned}`"
    assert warning == f"{fault}; {method} is made for {made_for}"


@pytest.mark.parametrize(("learned", "method"), MADE_FOR_EACH_OTHER)
def test_what_is_made_for_a_dictionary_is_not_warned_of(learned, method):
    assert warnings_about(method, learned_with(learned)) == ()


@pytest.mark.parametrize(("method", "minds"), [("convex", True), ("alternate", False)])
@pytest.mark.parametrize("thickness", [0.0, 0.002, 0.3])
def test_flat_dictionaries_are_said(rng, method, minds, thickness):
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    lying = rng.normal(size=(6, 3, 8)) * [[1], [1], [thickness]]
    shapes = turn @ lying
    dictionary = Dictionary(shapes, tuple("abcdefgh"), shapes[0])
    flat = [text for text in warnings_about(method, dictionary) if "are flat" in text]
    assert len(flat) == (minds and thickness < 0.01)


@pytest.mark.parametrize(("factor", "told"), [(300, 1), (1e-3, 1), (1, 0), (0.2, 0)])
@pytest.mark.parametrize("method", ["convex", "alternate", "mean-shape"])
def test_atoms_of_another_size_are_said(rng, factor, told, method):
    shapes = factor * rng.normal(size=(6, 3, 8))
    dictionary = Dictionary(shapes, tuple("abcdefgh"), shapes[0])
    warnings = warnings_about(method, dictionary)
    about_size = [text for text in warnings if "lambda is meant for" in text]
    expected = told if METHODS[method].mixes_atoms else 0
    assert len(about_size) == expected


def test_pmp_refuses_a_dictionary_whose_limbs_have_no_length(fit, dictionary, images):
    edges = np.array([[0, 0], [2, 2]])
    without_limbs = replace(read_dictionary(dictionary), edges=edges)
    write_dictionary(dictionary, without_limbs)
    fault = "length 0: the limbs whose lengths pmp keeps; learn it"
    with pytest.raises(InputError, match=fault):
        fit(dictionary, images, method="pmp")


def test_pmp_refuses_a_dictionary_without_limbs(fit, dictionary, images):
    without_limbs = replace(read_dictionary(dictionary), edges=None)
    write_dictionary(dictionary, without_limbs)
    with pytest.raises(InputError, match="no `edges`: the limbs whose lengths"):
        fit(dictionary, images, method="pmp")


@pytest.mark.parametrize(
    ("factor", "is_told"),
    [
        (0.99 * MAX_USUAL_ATOM_NORM, False),
        (1.01 * MAX_USUAL_ATOM_NORM, True),
    ],
)
def test_atoms_far_larger_than_normalised_shapes_are_told(chosen, rng, factor, is_told):
    """Those have the norm (3 p)^(1/2)."""
    atoms = rng.standard_normal((4, 3, 12))
    norms = np.linalg.norm(atoms, axis=(1, 2), keepdims=True)
    large = factor * 36**0.5 * atoms / norms
    names = tuple(f"p{i}" for i in range(12))
    dictionary = Dictionary(large, names, mean_shape=large[0])
    config, _ = chosen(None, overrides=("method=convex",))

    warnings = warn_of_dictionary(config, dictionary)

    assert any("the atoms have a norm" in text for text in warnings) == is_told


@pytest.mark.parametrize(("name", "long"), [("film", True), ("", False)])
def test_images_are_long_sequences_where_they_have_one(name, long):
    assert are_long([name] * MIN_SEQUENCE_FRAMES) is long
