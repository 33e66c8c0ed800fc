"""The simulate command's work: a grid of planted instances in, a folder of tables out."""

import csv
import json
import sys

import pytest

from shapefit.config import SimulateConfig
from shapefit.errors import InputError
from shapefit.evaluation.recovery import plant
from shapefit.pipelines import simulate
from shapefit.pipelines.simulate import run

TABLES = {"recovery.csv", "recovery.json", "recovery.md"}


@pytest.fixture
def config(tmp_path):
    return SimulateConfig(
        output=tmp_path / "report",
        landmarks=[10, 15],
        active_atoms=[1, 2, 3],
        trials=8,
        plots=False,
    )


def changed(config, **changes):
    return SimulateConfig(**{**config.model_dump(), **changes})


def table(config):
    list(run(config))
    with (config.output / "recovery.csv").open(newline="", encoding="utf-8") as file:
        return {(int(row["p"]), int(row["z"])): row["success"] for row in csv.DictReader(file)}


def test_one_outcome_a_cell_and_then_the_report(config):
    *cells, last = run(config)
    assert [outcome.done for outcome in cells] == [8] * 6
    assert {outcome.total for outcome in cells} == {48}
    assert not any(outcome.failures for outcome in cells)
    assert {path.name for path in last.written} == TABLES
    assert {path.name for path in config.output.iterdir()} == TABLES
    assert f"{last.note}\n" == (config.output / "recovery.md").read_text("utf-8")


def test_results_depend_neither_on_threads_nor_on_the_order_of_cells(config):
    shares = table(config)
    assert len(set(shares.values())) > 2  # neither all nor none is recovered
    backwards = changed(config, landmarks=[15, 10], active_atoms=[3, 2, 1], threads=3)
    assert table(backwards) == shares
    assert table(changed(config, landmarks=[15], threads=1)) == {
        place: share for place, share in shares.items() if place[0] == 15
    }


def test_each_trial_cell_and_seed_has_an_instance_of_its_own(config, monkeypatch):
    first_entries = []

    def watched(k, p, z, rng):
        instance = plant(k, p, z, rng)
        first_entries.append(instance.atoms[0, 0, 0])
        return instance

    monkeypatch.setattr(simulate, "plant", watched)
    for place in [(10, 2, 0), (10, 2, 1), (10, 3, 0), (15, 2, 0)]:
        simulate.attempt(config, *place)
    simulate.attempt(changed(config, seed=1), 10, 2, 0)
    assert len(set(first_entries)) == 5
    simulate.attempt(config, 10, 2, 0)
    assert first_entries[-1] == first_entries[0]


def test_a_translation_takes_information_away(config):
    one_cell = changed(config, landmarks=[20], active_atoms=[4], trials=60)
    (free,) = table(one_cell).values()
    (none,) = table(changed(one_cell, translation="none")).values()
    assert float(free) < float(none)


def test_what_is_not_solved_fails_and_is_listed(config):
    hopeless = changed(config, solver={"max_iterations": 1}, landmarks=[15], active_atoms=[2])
    cell, last = run(hopeless)
    assert len(cell.failures) == 8
    assert cell.failures[3].item == "p=15 z=2 trial 3"
    assert cell.failures[3].reason.startswith("iteration limit after 1 iteration, residual ")
    assert "p=15 z=2: 8" in last.note
    document = json.loads((config.output / "recovery.json").read_text("utf-8"))
    assert document["cells"][0]["unsolved"] == list(range(8))


def test_json_says_how_the_numbers_were_made(config):
    list(run(config))
    document = json.loads((config.output / "recovery.json").read_text("utf-8"))
    assert document["config"]["seed"] == 0
    assert document["config"]["translation"] == "free"
    assert document["version"]
    assert document["seconds"] > 0
    for cell in document["cells"]:
        assert cell["largest_relative_gap"] <= 1e-6
        assert cell["largest_residual"] <= 1e-6


def test_the_heat_map_is_drawn(config):
    small = changed(config, plots=True, landmarks=[10], trials=1)
    *_, last = run(small)
    assert {path.name for path in last.written} == TABLES | {"recovery.png", "recovery.svg"}
    assert (config.output / "recovery.png").read_bytes().startswith(b"\x89PNG")


def test_plots_without_matplotlib_stop_before_the_work(config, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(InputError, match="pip install matplotlib"):
        next(run(changed(config, plots=True)))


def test_a_folder_that_cannot_be_made_stops_before_the_work(config, tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="file is not a folder"):
        next(run(changed(config, output=tmp_path / "file" / "report")))
    with pytest.raises(InputError, match="not a folder"):
        next(run(changed(config, output=tmp_path / "file")))
