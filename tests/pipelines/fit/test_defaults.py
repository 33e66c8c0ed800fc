"""A dictionary brings its config: single images or sequences, unless the fit names another."""

from dataclasses import replace

import numpy as np
import pytest

from shapefit.config import load_config
from shapefit.io import read_dictionary, write_dictionary
from shapefit.io.records import LandmarkSet
from shapefit.pipelines.fit.default import ENOUGH, choose_default
from tests.io.files import save

NAMES = tuple("abcd")


@pytest.fixture
def suited(tmp_path):
    """The config that suits images of these sequences and a dictionary."""

    def find(sequences, dictionary="people", overrides=()):
        n = len(sequences or "12")
        images = LandmarkSet(
            landmarks=np.zeros((n, 2, 4)),
            landmark_names=NAMES,
            items=tuple(map(str, range(n))),
            sequences=sequences,
        )
        save(tmp_path / "images.h5", images)
        files = {"landmarks": (str(tmp_path / "images.h5"),), "dictionary": str(dictionary)}
        files["output"] = str(tmp_path / "result.h5")
        return choose_default(load_config("fit", None, overrides, files)).config

    return find


@pytest.mark.parametrize(
    ("sequences", "name"),
    [
        (None, "people"),
        (("a",) * ENOUGH, "sequences"),
        (("a",) * (ENOUGH - 1), "people"),
        (("a",) * ENOUGH + tuple("bcdefghij"), "sequences"),
        (("a",) * ENOUGH + tuple("bcdefghijklm"), "people"),
    ],
)
def test_half_of_the_images_decide_whether_there_are_sequences(suited, sequences, name):
    assert suited(sequences) == name


@pytest.mark.parametrize(
    ("method", "name"),
    [("sequences", "sequences"), ("posterior", "people"), ("convex", None)],
)
def test_the_config_of_a_method_that_is_named_is_taken_or_none(suited, method, name):
    assert suited(("a",) * ENOUGH, overrides=(f"method={method}",)) == name


@pytest.mark.parametrize(
    ("suits", "name"), [({}, None), ({"suits": "cars"}, "cars"), ({"suits": "strange"}, None)]
)
def test_other_dictionaries_bring_what_they_name(suited, tmp_path, suits, name):
    from shapefit.config.paths import find_dictionaries

    known = read_dictionary(find_dictionaries()["people"])
    kept = {key: text for key, text in known.provenance.items() if key != "suits"}
    write_dictionary(tmp_path / "own.h5", replace(known, provenance=kept | suits))
    assert suited(("a",) * ENOUGH, tmp_path / "own.h5") == name
