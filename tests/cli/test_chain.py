"""The commands one after the other, on sample data and on real data."""

import csv
from pathlib import Path
from types import SimpleNamespace

import pytest

from tests.cli.conftest import run_in

SMALL = ("--set", "k=16", "--set", "iterations=2")


def shapefit(*arguments: object, folder: Path, text: str = "") -> SimpleNamespace:
    """Run a command in `folder`; fail with what it says unless it exits with 0."""
    result = run_in(folder, *arguments, text=text)
    assert result.returncode == 0, result.stderr
    return result


@pytest.fixture(scope="module")
def demo(project, tmp_path_factory):
    """The chain with configs/demo and a small dictionary; what eval printed, and the folder."""
    folder, configs = tmp_path_factory.mktemp("demo"), project / "configs/demo"
    shapefit(
        "learn-dict", "-c", configs / "learn-dict.yaml", *SMALL, "--set", "every=8",
        "-o", "dict.h5", folder=folder,
    )  # fmt: skip
    shapefit("project", "-c", configs / "project.yaml", "-o", "views.h5", folder=folder)
    shapefit(
        "fit", "-c", configs / "fit.yaml", "views.h5", "-d", "dict.h5", "-o", "result.h5",
        folder=folder,
    )  # fmt: skip
    shown = shapefit(
        "eval", "-c", configs / "eval.yaml", "result.h5", "-o", "report", "--set", "plots=false",
        folder=folder,
    )  # fmt: skip
    return folder, shown.stdout


def similarity_errors(report: Path) -> dict[str, float]:
    """Return the mean normalised similarity error of each group."""
    with report.open(newline="", encoding="utf-8") as file:
        return {
            row["group"]: float(row["mean"])
            for row in csv.DictReader(file)
            if row["metric"] == "similarity" and row["unit"] == "normalised" and not row["sequence"]
        }


def test_the_demo_lifts_people(demo):
    folder, table = demo
    assert "error aligned" in table
    assert (folder / "report/report.md").read_text(encoding="utf-8").startswith("# Errors")
    (error,) = similarity_errors(folder / "report/report.csv").values()
    flat = 1.0  # the error of a shape without any depth is about the spread of the depths
    assert 0 < error < flat / 2


def test_a_wrong_name_leaves_the_old_result(demo):
    folder, _ = demo
    before = (folder / "result.h5").read_bytes()
    wrong = "item,landmark,x,y\na,pelviss,1,2\na,rhip,2,1\na,lhip,0,0\n"
    result = run_in(folder, "fit", "-d", "dict.h5", "-o", "result.h5", "-", text=wrong)
    assert result.returncode == 2
    assert "pelviss" in result.stderr
    assert "pelvis" in result.stderr.replace("pelviss", "")
    assert (folder / "result.h5").read_bytes() == before
