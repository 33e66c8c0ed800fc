"""Names of strangers: they do not reach the terminal raw, and none of them is run."""

import json
from pathlib import Path

import numpy as np
import pytest
from shapefit.cli.main import run as shapefit

from shapefit.io import landmark_writer
from shapefit.io.formats import record_writer
from shapefit.io.layout import SHAPES
from shapefit.records import Landmarks, Shapes

NASTY = "\x1b]0;title\x07\x9b31m\u202eevil\n"
"""A name that sets title, colour and direction of a terminal, and ends lines."""


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


NASTY_RESULT = f"{NASTY[:9]}.h5"


@pytest.fixture
def nasty() -> None:
    """Images, shapes, a dictionary and a result whose names and unit are nasty."""
    rng = np.random.default_rng(0)
    fields = {
        "landmark_names": (NASTY, "b", "c", "d"),
        "items": (f"{NASTY}1", "2", "3"),
        "unit": NASTY,
    }
    points = rng.normal(size=(3, 4, 2))
    images = Landmarks(points, sequences=(NASTY, NASTY, "s"), **fields)
    shapes = Shapes(rng.normal(size=(3, 4, 3)), **fields)
    with landmark_writer(Path("images.h5")) as writer:
        writer.append(images)
    with record_writer(Path("shapes.h5"), SHAPES) as writer:
        writer.append(shapes)
    assert shapefit(["learn-dict", "shapes.h5", "-o", "d.h5", "-q"]) == 0
    assert shapefit(["fit", "images.h5", "-d", "d.h5", "-o", NASTY_RESULT, "-q"]) == 0


COMMANDS = [
    ("info", "images.h5", "shapes.h5", "d.h5", NASTY_RESULT),
    ("info", "images.h5", NASTY_RESULT, "--json"),
    ("verify", NASTY_RESULT, "-d", "d.h5"),
    ("verify", NASTY_RESULT, "-d", "d.h5", "--json"),
    ("eval", NASTY_RESULT, "--truth", "shapes.h5", "-o", "report"),
    ("fit", "images.h5", "-d", "people", "-o", "x.h5"),
    ("fit", "images.h5", "-d", NASTY, "-o", "x.h5"),
    ("info", f"{NASTY}.csv"),
    ("convert", "images.h5", "-o", f"{NASTY[:9]}.xyz"),
    ("convert", "images.h5", "-o", "x.csv", "--to", NASTY),
    ("fit", "images.h5", f"--{NASTY}"),
    (NASTY,),
]


def is_printable(text: str) -> bool:
    return all(line.isprintable() for line in text.split("\n"))


def test_no_command_prints_names_as_they_are(nasty, capfd):
    for command in COMMANDS:
        shapefit(command)
        said = capfd.readouterr()
        assert is_printable(said.out), command
        assert is_printable(said.err), command
        if "--json" in command:
            json.loads(said.out)


def test_no_report_shows_names_as_they_are(nasty):
    shapefit(["eval", NASTY_RESULT, "--truth", "shapes.h5", "-o", "report"])
    texts = [path for path in Path("report").iterdir() if path.suffix != ".csv"]
    assert texts
    for path in texts:
        if path.suffix in (".html", ".svg"):
            assert is_printable(path.read_text()), path


TAGS = [
    '!!python/object/apply:os.system ["touch ran"]',
    "!!python/name:os.system",
    "!own {a: 1}",
    "!!seq {a: 1}",
    "!!map [1]",
    "!!int [1]",
    "!!set {a}",
    "!!binary aGVsbG8=",
    "[1, !!python/tuple [1]]",
]
"""Values of YAML that would make an object."""


@pytest.mark.parametrize("value", TAGS)
def test_a_tag_of_yaml_is_refused(value, capfd):
    assert shapefit(["fit", "x.csv", "--set", f"lambda={value}"]) == 2
    assert "the tag !" in capfd.readouterr().err
    assert not Path("ran").exists()


@pytest.mark.parametrize("value", TAGS)
def test_a_tag_of_a_config_is_refused_with_its_place(value, capfd):
    Path("fit.yaml").write_text(f"lambda: {value}\n")
    assert shapefit(["fit", "x.csv", "-c", "fit.yaml"]) == 2
    assert "fit.yaml:1:" in capfd.readouterr().err
    assert not Path("ran").exists()


@pytest.mark.parametrize("path", ["/proc/self/mem", "/proc/self/task"])
@pytest.mark.parametrize("output", [None, "x.h5"])
def test_what_cannot_be_read(path, output, capfd):
    command = ["info", path] if output is None else ["convert", path, "-o", output]
    assert shapefit(command) == 2
    assert f"Error: {path}" in capfd.readouterr().err


SIZE_KEYS = ("--image-size", "1000x1000")


NO_CAMERAS = {
    "huge": ("--set", "camera.focal=1e308", *SIZE_KEYS),
    "tiny": ("--set", "camera.focal=1e-300", *SIZE_KEYS),
    "large": ("--set", "camera.focal=1e160", *SIZE_KEYS),
    "far": ("--focal", "1000", "--set", "camera.principal_point=[1e308, 0]"),
}


@pytest.mark.parametrize("keys", NO_CAMERAS.values(), ids=NO_CAMERAS)
def test_a_camera_that_is_none(keys, capfd, project):
    views = str(project / "sample_data/people_views.csv")
    code = shapefit(["fit", views, "-d", "people", "-o", "r.h5", *keys])
    said = capfd.readouterr().err
    assert code == 2
    assert "which no camera has" in said
    assert "RuntimeWarning" not in said


@pytest.fixture
def shapes() -> None:
    """Sequences of people whose long names differ at their far ends."""
    rng = np.random.default_rng(0)
    sequences = ("n" * 5000, "n" * 5000, "n" * 4999 + "m", "é" * 3000)
    people = Shapes(
        rng.normal(size=(4, 4, 3)),
        landmark_names=tuple("abcd"),
        items=tuple(f"{name}/{n}" for n, name in enumerate(sequences)),
        sequences=sequences,
        unit="m",
    )
    with record_writer(Path("shapes.h5"), SHAPES) as writer:
        writer.append(people)


@pytest.mark.parametrize("to", ["trc", "c3d"])
def test_long_names_are_shortened_with_a_number(shapes, to):
    pytest.importorskip("ezc3d" if to == "c3d" else "numpy")
    assert shapefit(["convert", "shapes.h5", "-o", f"walk.{to}", "-q"]) == 0
    names = [path.name for path in Path().glob(f"walk_*.{to}")]
    assert len(names) == 3
    for name in names:
        assert len(name.encode()) < 250
