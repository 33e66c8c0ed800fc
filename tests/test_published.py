"""The paper's numbers stand beside ours in reports of `eval` and `simulate`."""

import json
import re
import runpy
from pathlib import Path

import pytest

from shapefit.config import EvalConfig, SimulateConfig
from shapefit.io import read_shapes, write_shapes
from shapefit.pipelines import simulate
from shapefit.pipelines.evaluate import run as evaluate

MODULE = runpy.run_path(str(Path(__file__).resolve().parents[1] / "benchmarks/published.py"))
REPORTS = MODULE["REPORTS"]


def simulated(folder: Path, **keys) -> Path:
    config = SimulateConfig(output=folder / "recovery", plots=True, **keys)
    list(simulate.run(config))
    return config.output


def test_rows_of_the_published_figure_are_reproduced(tmp_path):
    folder = simulated(tmp_path, landmarks=[10, 20, 30])
    page = REPORTS["recovery"](folder)
    found = json.loads((folder / "recovery.json").read_text("utf-8"))["published"]
    assert len(found["cells"]) == 30
    assert found["largest_deviation"] <= 0.12
    assert "## Ours minus published" in page
    assert (folder / "recovery.md").read_text("utf-8").count("## Published") == 1


def test_shares_are_matched_by_cell_and_added_once(tmp_path):
    folder = simulated(tmp_path, landmarks=[7, 10], active_atoms=[1, 2], trials=2)
    before = (folder / "recovery.png").read_bytes()
    for _ in range(2):
        page = REPORTS["recovery"](folder)
    known = json.loads((folder / "recovery.json").read_text("utf-8"))
    ours = {(c["p"], c["z"]): c["success"] for c in known["cells"]}
    assert {(c["p"], c["z"]): c["success"] for c in known["published"]["cells"]} == {
        (10, 1): 0.95,
        (10, 2): 0.11,
    }
    for cell in known["published"]["cells"]:
        deviation = ours[cell["p"], cell["z"]] - cell["success"]
        assert cell["deviation"] == pytest.approx(deviation)
    text = (folder / "recovery.md").read_text("utf-8")
    assert text.count("## Published") == 1
    assert text.endswith(page)
    assert (folder / "recovery.png").read_bytes() != before


def test_nothing_is_added_where_no_cell_is_published(tmp_path):
    folder = simulated(tmp_path, landmarks=[7], active_atoms=[1], trials=1)
    before = (folder / "recovery.md").read_bytes()
    assert REPORTS["recovery"](folder) == ""
    assert (folder / "recovery.md").read_bytes() == before


@pytest.fixture
def report(project, tmp_path):
    """A report on true shapes as results, in two sequences that are named like the paper's."""
    shapes = read_shapes([project / "sample_data/people_test.h5"]).take(slice(8))
    named = shapes.take(slice(8))
    object.__setattr__(named, "sequences", ("13_01",) * 4 + ("14_01",) * 4)
    write_shapes(tmp_path / "truth.h5", named)
    write_shapes(tmp_path / "found.csv", named)
    groups = {"Subject 13": "13_*", "Subject 14": "14_*"}
    config = EvalConfig(
        results={"Ours": tmp_path / "found.csv"},
        truth=tmp_path / "truth.h5",
        output=tmp_path / "report",
        groups=groups,
        metrics=["similarity"],
        plots=False,
        view=False,
    )
    list(evaluate.run(config))
    return config.output


def test_rows_and_caveats_of_the_paper_stand_in_the_report(report):
    before = json.loads((report / "report.json").read_text("utf-8"))
    page = REPORTS["mocap"](report)
    row = next(line for line in page.splitlines() if "0.259" in line)
    cells = re.split(r" *\| *", row.strip("| "))
    assert (cells[0], cells[2:]) == ("Subject 13", ["0.259", "0.293", "0.390"])
    assert "- Sequences 14_31 and 14_36 are one motion." in page
    after = json.loads((report / "report.json").read_text("utf-8"))
    assert after["published"]["PMP (paper)"] == {"Subject 13": 0.39, "Subject 14": 0.393}
    assert {**after, "published": {}, "caveats": []} == before
    assert (report / "report.md").read_text("utf-8").startswith(page.rstrip())


def test_a_report_is_added_to_once(report):
    page = REPORTS["mocap"](report)
    assert REPORTS["mocap"](report) == page
