"""Commands of README and docs: those in console blocks run and print what the page
shows.
"""

import re
import shlex
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from shapefit.cli.main import run

from shapefit.evaluation.metrics import similarity_error
from shapefit.io import read_results, read_shapes

PROJECT = Path(__file__).resolve().parents[1]
PAGES = [
    "README.md",
    *sorted(f"docs/{path.name}" for path in (PROJECT / "docs").glob("*.md")),
]
FENCE = re.compile(r"^( *)```(\w*)\n(.*?)^ *```", re.DOTALL | re.MULTILINE)
QUICK = {"README.md", "docs/first-result.md"}
SLOW = ("docs/cars.md", "docs/trouble.md")


class Command(NamedTuple):
    """A command of a page and the lines that the page shows below it."""

    text: str
    shown: list[str]


def console_commands(page: str) -> list[Command]:
    """Return the commands of the console blocks of a page, in order."""
    listed: list[Command] = []
    for _, kind, block in FENCE.findall((PROJECT / page).read_text(encoding="utf-8")):
        for line in block.splitlines() if kind == "console" else ():
            if line.startswith("$ "):
                listed.append(Command(line[2:], []))
            else:
                listed[-1].shown.append(line.strip())
    return listed


def run_page(page: str, capsys: pytest.CaptureFixture[str]) -> str:
    """Run the commands of a page; return the tables printed."""
    tables = ""
    for command in console_commands(page):
        words = shlex.split(command.text)
        if (
            words[0] != "shapefit"
        ):  # git, pip and make: `make test` itself needs what they do
            continue
        assert run(words[1:]) == 0, f"{command.text}\n{capsys.readouterr().err}"
        printed = capsys.readouterr()
        tables += printed.out
        lines = iter(
            [
                without_measures(line)
                for line in (printed.err + printed.out).splitlines()
            ]
        )
        for line in command.shown:
            assert without_measures(line) in lines, (
                f"{command.text} does not print: {line}"
            )
    return tables


def without_measures(line: str) -> str:
    """Return a line without its times and gaps, which differ from machine to
    machine.
    """
    timeless = re.sub(r"\b\d+(\.\d+)? s\b", "N s", line.strip())
    return re.sub(r"\b\d\.\de-\d\d\b", "G", timeless)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    for name in ("sample_data", "configs"):
        (tmp_path / name).symlink_to(PROJECT / name)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_commands_of_the_readme_and_the_first_result(folder, capsys):
    printed = run_page("README.md", capsys)
    tables = printed[printed.index("item,landmark,") :]
    text = (PROJECT / "README.md").read_text(encoding="utf-8")
    (sample,) = re.findall(r"```\n(item,landmark,x,y .*?)```", text, re.DOTALL)
    lines = (
        (PROJECT / "sample_data/one_person.csv")
        .read_text(encoding="utf-8")
        .splitlines()
    )
    shown = [line.split() for line in sample.splitlines()][:-1]
    assert len(shown) == 3
    for (line_in, line_out), line, fitted in zip(
        shown, lines, tables.splitlines(), strict=False
    ):
        assert line_in == line
        *names, x, y, z = fitted.split(",")
        numbers = (
            (x, y, z) if x == "x" else (f"{float(number):.2f}" for number in (x, y, z))
        )
        assert line_out == ",".join([*names, *numbers])
    assert (folder / "walk.html").is_file()
    run_page("docs/first-result.md", capsys)
    assert all(
        (folder / f"walk_person_1{end}").is_file() for end in (".trc", ".mot", ".bvh")
    )


@pytest.mark.slow
def test_your_animal(folder, capsys):
    run_page("docs/your-animal.md", capsys)
    result = read_results(folder / "dog.h5")
    truth = read_shapes([folder / "sample_data/animal_truth.h5"])
    error = 1000 * similarity_error(result.as_columns(), truth.as_columns()).mean()
    text = (PROJECT / "docs/your-animal.md").read_text(encoding="utf-8")
    (stated,) = re.findall(r"an error of (\d+) mm", text)
    assert error == pytest.approx(float(stated), abs=0.5)
    length = np.linalg.norm(
        truth.as_columns()[:, :, 3] - truth.as_columns()[:, :, 7], axis=1
    )
    assert length.mean() == pytest.approx(
        1.0, abs=0.25
    )  # from the nose to the tip of the tail
    bones = read_shapes([folder / "dog.bvh"])
    assert {"withers", "left_front_paw", "tail_tip"} <= set(bones.landmark_names)
    assert len(bones) == 100
    assert bones.frame_rate == 25


@pytest.mark.slow
@pytest.mark.parametrize("page", SLOW)
def test_the_commands_of_a_page(folder, capsys, page):
    run_page(page, capsys)


def test_every_page_with_console_blocks_is_run():
    """Those of docs/from_matlab.md run in tests/api/test_docs.py, between its blocks of
    Python.
    """
    with_console = {page for page in PAGES if console_commands(page)}
    assert with_console == {*QUICK, *SLOW, "docs/your-animal.md", "docs/from_matlab.md"}
