"""Parts of sequences: each sequence whole, in one part of one file."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from shapefit.config import load_config
from shapefit.errors import InputError
from shapefit.io import landmark_writer
from shapefit.io.records import LandmarkSet
from shapefit.pipelines.parts.plan import plan_parts

NAMES = tuple("abcd")


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def written(path: str, sequences: Sequence[str]) -> str:
    """Write images of these sequences, without landmarks of interest."""
    items = tuple(f"{path}-{n}" for n in range(len(sequences)))
    points = 9.0 * np.ones((len(sequences), 2, len(NAMES)))
    with landmark_writer(Path(path)) as writer:
        writer.append(
            LandmarkSet(
                landmarks=points, landmark_names=NAMES, items=items, sequences=tuple(sequences)
            )
        )
    return path


def planned(*landmarks: str, partition: int = 100_000):
    arguments = {"landmarks": landmarks, "dictionary": "people", "output": "out/"}
    keys = ("method=sequences", f"partition={partition}")
    return plan_parts(load_config("fit", None, keys, arguments))


def test_parts_are_cut_between_sequences():
    one = written("one.h5", ["a"] * 5 + ["b"] * 30 + ["c"] * 4 + ["d"] * 9)
    two = written("two.h5", ["e"] * 3)
    rows = [part.rows for part in planned(one, two, partition=10)]
    assert rows == [(0, 35), (35, 48), None]


@pytest.mark.parametrize("ending", ["h5", "csv"])
@pytest.mark.parametrize("other", ["h5", "csv"])
def test_a_sequence_over_two_files_names_both(ending, other):
    one = written(f"one.{ending}", ["a", "a", "b"])
    two = written(f"two.{other}", ["b", "c"])
    with pytest.raises(InputError, match=r"'b' is in .*one\.\w+ and in .*two\.\w+; put") as error:
        planned(one, two)
    assert len(error.value.problems) == 1


def test_a_sequence_that_goes_on_after_another_is_refused():
    with pytest.raises(InputError, match=r"'a' is in .*one\.h5, in two places"):
        planned(written("one.h5", ["a", "b", "a"]))


def test_other_methods_take_them():
    one, two = written("one.h5", ["a"]), written("two.h5", ["a"])
    arguments = {"landmarks": (one, two), "dictionary": "people", "output": "out/"}
    assert len(plan_parts(load_config("fit", None, ("partition=1",), arguments))) == 2
