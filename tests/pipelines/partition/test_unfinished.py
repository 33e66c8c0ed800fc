"""Folders of results that a run has not finished: who reads them is told."""

import json
from pathlib import Path

import pytest
from shapefit.cli.main import run as shapefit

from shapefit.io import read_results, write_shapes
from shapefit.pipelines.unfinished import describe_unfinished
from shapefit.records import Shapes
from tests.pipelines.partition.made import make_dictionary, make_images

OUT = Path("out")
MANIFEST = OUT / "manifest.jsonl"
TOLD = "1 of its 3 parts have no result: run the same `fit` again"


@pytest.fixture
def parts(tmp_path, rng, monkeypatch):
    """The results of a run of three files, a part each."""
    monkeypatch.chdir(tmp_path)
    make_dictionary(Path("dict.h5"), rng)
    for number, name in enumerate(("a.h5", "b.h5", "c.h5")):
        make_images(name, rng.normal(size=(20, 2, 8)), 100 * number)
    command = "fit a.h5 b.h5 c.h5 -d dict.h5 -o out/ --method convex"
    assert shapefit(command.split()) == 0
    return sorted(OUT.glob("part-*.h5"))


@pytest.fixture
def killed(parts):
    """Two of the results: the run ended before the last part."""
    *lines, last = MANIFEST.read_text().splitlines(keepends=True)
    MANIFEST.write_text("".join(lines))
    lost = OUT / json.loads(last)["file"]
    lost.unlink()
    return [part for part in parts if part != lost]


def test_a_finished_run_needs_no_word(parts):
    assert describe_unfinished(parts) == ()


def test_a_run_that_was_killed_is_told(killed):
    (warning,) = describe_unfinished(killed)
    assert warning == f"out: {TOLD}"


def test_a_part_that_is_read_by_itself_is_no_folder(killed):
    assert describe_unfinished(killed[:1]) == ()


@pytest.mark.parametrize(
    "command",
    ["info out", "convert out -o all.h5", "view out -o page.html"],
)
def test_every_command_tells_it(killed, capsys, command):
    shapefit(command.split())
    assert TOLD in capsys.readouterr().err


def test_eval_tells_it(killed, capsys, rng):
    results = read_results(killed[0])
    noise = 0.1 * rng.standard_normal(results.shapes.shape)
    names = results.landmark_names
    truth = Shapes(results.shapes + noise, landmark_names=names, items=results.items)
    write_shapes(Path("truth.h5"), truth)

    shapefit(["eval", "out", "--truth", "truth.h5", "-o", "report"])

    assert TOLD in capsys.readouterr().err
