"""`fit` and inputs that are refused; results as CSV."""

from __future__ import annotations

import csv

import pytest

from shapefit.config import FitConfig
from shapefit.errors import InputError
from shapefit.pipelines.fit.run import run

LANDMARK_ROWS = "item,landmark,x,y\n"


class TestInputsThatAreRefused:
    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ("", "views.csv"),
            (LANDMARK_ROWS + "one,point0,abc,1\n", "views.csv:2"),
            (LANDMARK_ROWS + "one,point0,inf,1\n", "views.csv:2"),
            (LANDMARK_ROWS + "one,poimt0,1,1\n", "point0"),
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
            fit(tmp_path, dictionary, text)
        assert old.read_text() == "old"
        assert sorted(p.name for p in tmp_path.iterdir()) == [
            "dictionary.h5",
            "result.h5",
            "views.csv",
        ]

    def test_a_dictionary_that_is_none(self, fit, tmp_path, images, write):
        other = write(tmp_path / "other.h5", images)
        with pytest.raises(InputError, match="shapefit-dictionary"):
            fit(tmp_path, other, images)

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
