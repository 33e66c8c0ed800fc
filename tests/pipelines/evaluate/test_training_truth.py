"""`eval` says so where the truth is the training data of the dictionary."""

import subprocess
import sys
from pathlib import Path

SAMPLES = Path(__file__).parents[3] / "sample_data"


def shapefit(*arguments: object) -> str:
    """Run a command in the folder of the project; return what it says."""
    command = [Path(sys.executable).with_name("shapefit"), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return done.stderr


def judge(folder: Path, truth: Path, *fit: str) -> str:
    """Learn from the training motions, lift views of the truth, and evaluate."""
    learned, views, result = folder / "dict.h5", folder / "views.h5", folder / "result.h5"
    shapefit(
        *("learn-dict", SAMPLES / "people_train.h5", "-o", learned),
        *("--set", "k=8", "--set", "iterations=2"),
    )
    shapefit("project", truth, "-o", views)
    shapefit("fit", views, "-d", learned, "-o", result, *fit)
    return shapefit(
        "eval", result, "--truth", truth, "-o", folder / "report", "--set", "view=false"
    )


def test_truth_that_the_dictionary_was_learned_from_is_a_warning(tmp_path):
    said = judge(tmp_path, SAMPLES / "people_train.h5")
    assert f"the dictionary was learned from the truth, {SAMPLES / 'people_train.h5'}" in said
    assert "learned from the truth" in (tmp_path / "report" / "report.md").read_text()


def test_truth_that_took_no_part_in_learning_is_none(tmp_path):
    assert "learned from the truth" not in judge(tmp_path, SAMPLES / "people_test.h5")
