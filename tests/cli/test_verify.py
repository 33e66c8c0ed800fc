"""What `shapefit verify` hands on, prints and exits with."""

from __future__ import annotations

from pathlib import Path

import pytest

from shapefit.errors import InputError
from shapefit.pipelines import verify
from shapefit.pipelines.outcome import Failure, Outcome


@pytest.fixture
def requests(monkeypatch):
    """Put a pipeline in place that yields `outcomes`; returns what it is asked."""
    asked = []

    def install(*outcomes):
        def run(request):
            asked.append(request)
            for outcome in outcomes:
                if isinstance(outcome, Exception):
                    raise outcome
                yield outcome

        monkeypatch.setattr(verify, "run", run)
        return asked

    return install


def test_the_table_goes_to_stdout(shapefit, requests):
    asked = requests(Outcome(done=3, total=3), Outcome(note="| claim |"))
    result = shapefit("verify", "result.h5", "-d", "dict.h5", "--landmarks", "views.h5")
    assert asked == [verify.Request(Path("result.h5"), Path("dict.h5"), (Path("views.h5"),))]
    assert (result.code, result.out) == (0, "| claim |\n")
    assert result.err.startswith("verify: 3 images in ")


def test_a_claim_that_does_not_hold_is_a_failure(shapefit, requests):
    requests(Outcome(done=3, failures=(Failure("a", "the objective is P: off by 1"),)))
    result = shapefit("verify", "result.h5", "-d", "dict.h5")
    assert result.code == 1
    assert "Failed: a: the objective is P: off by 1\n" in result.err


def test_bad_input_is_one(shapefit, requests):
    requests(InputError(["result.h5: holds no dual; fit again"]))
    result = shapefit("verify", "result.h5", "-d", "dict.h5")
    assert (result.code, result.err) == (2, "Error: result.h5: holds no dual; fit again\n")


@pytest.mark.parametrize("arguments", [["result.h5"], ["-d", "dict.h5"], ["a.h5", "b.h5"]])
def test_a_result_and_its_dictionary_are_needed(shapefit, arguments):
    assert shapefit("verify", *arguments).code == 2


def test_files_that_are_not_there_are_named(shapefit):
    result = shapefit("verify", "nowhere.h5", "-d", "dict.h5")
    assert result.code == 2
    assert "Error: dict.h5: is empty" in result.err
