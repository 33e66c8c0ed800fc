"""`fit` and inputs that are refused, or taken with a warning; results as CSV."""

import csv

import numpy as np
import pytest

from shapefit.config import FitConfig
from shapefit.dictionary.model import Dictionary
from shapefit.errors import InputError
from shapefit.io import write_dictionary
from shapefit.io.records import LandmarkSet
from shapefit.pipelines.fit.run import run

LANDMARK_ROWS = "item,landmark,x,y\n"


class TestInputsThatAreRefused:
    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ("", "views.csv"),
            (LANDMARK_ROWS + "one,point0,abc,1\n", "views.csv:2"),
            (LANDMARK_ROWS + "one,point0,inf,1\n", "views.csv:2"),
            (LANDMARK_ROWS + "one,poimt0,10,10\n", "point0"),
            (LANDMARK_ROWS + "one,point0,1,1\none,point0,2,2\n", "views.csv:3"),
            ("item,landmark,x\none,point0,1\n", "y"),
        ],
    )
    def test_the_message_names_the_place_and_the_old_result_stays(
        self, fit, tmp_path, dictionary, text, message
    ):
        old = tmp_path / "result.h5"
        old.write_text("old")
        with pytest.raises(InputError, match=message):
            fit(dictionary, text)
        assert old.read_text() == "old"
        assert sorted(p.name for p in tmp_path.iterdir()) == [
            "dictionary.h5",
            "result.h5",
            "views.csv",
        ]

    def test_a_dictionary_that_is_none(self, fit, tmp_path, images, write):
        other = write(tmp_path / "other.h5", images)
        with pytest.raises(InputError, match="shapefit-dictionary"):
            fit(other, images)

    def test_an_output_folder_that_cannot_be_made(self, tmp_path, dictionary, images, write):
        config = FitConfig(
            landmarks=[str(write(tmp_path / "views.h5", images))],
            dictionary=str(dictionary),
            output=str(tmp_path / "views.h5" / "result.h5"),
        )
        with pytest.raises(InputError, match=r"views\.h5 is not a folder"):
            list(run(config))

    def test_csv_out(self, tmp_path, dictionary, images, write):
        config = FitConfig(
            landmarks=[str(write(tmp_path / "views.h5", images))],
            dictionary=str(dictionary),
            output=str(tmp_path / "shapes.csv"),
        )
        list(run(config))
        with config.output.open() as file:
            table = list(csv.DictReader(file))
        assert len(table) == 80
        assert list(table[0]) == ["item", "landmark", "x", "y", "z", "sequence"]


NAMES = tuple("abcdef")


@pytest.fixture
def warnings(fit, tmp_path, rng):
    """Fit images of these confidences, and return the warnings."""
    mean = rng.standard_normal((3, 6))
    atoms = rng.standard_normal((2, 3, 6))
    write_dictionary(tmp_path / "d.h5", Dictionary(atoms, NAMES, mean, objective_trace=np.empty(0)))

    def told(n, confidence):
        images = LandmarkSet(
            landmarks=rng.standard_normal((n, 2, 6)),
            confidence=None if confidence is None else np.full((n, 6), confidence),
            landmark_names=NAMES,
            items=tuple(map(str, range(n))),
        )
        _, outcomes = fit(tmp_path / "d.h5", images)
        return [warning for outcome in outcomes for warning in outcome.warnings]

    return told


def test_confidences_above_one_are_told(warnings):
    (warning,) = warnings(3, 95.0)
    assert warning.startswith("confidences above 1: ")
    assert "`lambda`" in warning
    for confidence in (None, 0.5, 1.0):
        assert warnings(3, confidence) == []


def test_an_input_of_no_images_is_told(warnings):
    assert warnings(0, None) == ["the input holds no images"]
