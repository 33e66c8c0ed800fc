"""`method: auto` chooses by the dictionary and by how many images are frames of sequences."""

from dataclasses import replace

import numpy as np
import pytest

from shapefit.config import load_config
from shapefit.config.paths import find_dictionaries
from shapefit.errors import InputError
from shapefit.io import read_dictionary, write_dictionary
from shapefit.io.records import LandmarkSet
from shapefit.pipelines.fit.prepare import FRAMES, choose_method, in_sequences
from tests.io.files import save


@pytest.fixture
def chosen(tmp_path):
    """The config of a fit of images of these sequences, and the line about its method."""

    def find(sequences, dictionary="people", overrides=()):
        n = len(sequences or "12")
        images = LandmarkSet(
            landmarks=np.zeros((n, 2, 4)),
            landmark_names=tuple("abcd"),
            items=tuple(map(str, range(n))),
            sequences=sequences,
        )
        save(tmp_path / "images.h5", images)
        files = {"landmarks": str(tmp_path / "images.h5"), "dictionary": str(dictionary)}
        files["output"] = str(tmp_path / "result.h5")
        config = load_config("fit", None, overrides, files)
        known = read_dictionary(config.dictionary)
        return choose_method(config, known, lambda: in_sequences(config))

    return find


@pytest.mark.parametrize(
    ("sequences", "method"),
    [
        (None, "posterior"),
        (("a",) * FRAMES, "sequences"),
        (("a",) * (FRAMES - 1), "posterior"),
        (("a",) * FRAMES + tuple("bcdefghij"), "sequences"),
        (("a",) * FRAMES + tuple("bcdefghijklm"), "posterior"),
    ],
)
def test_half_of_the_images_decide_whether_there_are_sequences(chosen, sequences, method):
    config, line = chosen(sequences)
    assert config.method == method
    assert line == f"{method} (the dictionary has a prior; change with --method)"


@pytest.mark.parametrize(
    ("overrides", "method", "residual_variance"),
    [
        (["method=sequences"], "sequences", 0.01),
        (["method=posterior", "prior.residual_variance=0.3"], "posterior", 0.3),
        (["method=convex"], "convex", None),
        (["outliers=l1"], "convex", None),
        (["leave_one_out=item"], "convex", None),
        (["prior.scale=2"], "sequences", 0.01),
    ],
)
def test_the_method_has_what_the_config_asks_for(chosen, overrides, method, residual_variance):
    config, _ = chosen(("a",) * FRAMES, overrides=overrides)
    assert (config.method, config.prior.residual_variance) == (method, residual_variance)


def test_other_dictionaries_have_their_own_variance_or_no_prior(chosen, tmp_path):
    known = read_dictionary(find_dictionaries()["people"])
    retained = {key: text for key, text in known.provenance.items() if key != "suits"}
    write_dictionary(tmp_path / "own.h5", replace(known, provenance=retained))
    config, _ = chosen(None, tmp_path / "own.h5")
    assert (config.method, config.prior.residual_variance) == ("posterior", None)
    write_dictionary(tmp_path / "atoms.h5", replace(known, prior=None, p_value_table=None))
    assert chosen(None, tmp_path / "atoms.h5")[0].method == "convex"
    with pytest.raises(InputError, match=r"the method convex has no prior; `prior\.scale` needs"):
        chosen(None, tmp_path / "atoms.h5", ["prior.scale=2"])
