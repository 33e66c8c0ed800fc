"""How often methods are optimal: counted against the best objectives, of the same model only."""

import json
from pathlib import Path

import h5py
import numpy as np
import pytest

from benchmarks.optimality import sections

BEST = [1.0, 2.0, 4.0, np.nan]


def write(
    path: Path, *, signed: bool = False, status: list[str] | None = None, **data: list[float]
):
    with h5py.File(path, "w") as file:
        file.attrs["config"] = json.dumps({"signed": signed})
        for name, values in data.items():
            file[name] = values
        if status is not None:
            file.create_dataset("status", data=status, dtype=h5py.string_dtype())


@pytest.fixture
def folder(tmp_path):
    status = ["optimal", "iteration limit", "optimal", "degenerate"]
    gap = [0.01, 0.03, 0.0, np.nan]
    write(tmp_path / "global.h5", objective=BEST, relative_gap=gap, status=status)
    refined = [1.0, 2.5, 4.0, np.nan]
    write(tmp_path / "refine.h5", objective=refined, relative_gap=[0.1, 0.5, 0.0, np.nan])
    write(tmp_path / "alternate-nonnegative.h5", objective=[1.005, 2.0, 6.0, np.nan])
    return tmp_path


def rows(page: str) -> dict[str, list[str]]:
    lines = [line.strip("|").split("|") for line in page.splitlines() if line.startswith("|")]
    return {first.strip(): [entry.strip() for entry in rest] for first, *rest in lines}


def test_excess_and_the_parts_of_the_gap(folder):
    _, text, table = sections(folder)
    found = rows(table)
    assert found["Convex+refine"] == ["33.33%", "25% (25%)", "20.00%", "6.67%", "13.33%"]
    search = (1 - 1 / 1.005 + 1 - 4 / 6) / 3
    assert found["Alternate, c >= 0"] == ["33.33%", "50% (50%)", "–", f"{search:.2%}", "–"]
    assert found["the better of both"][:2] == ["0.00%", "0% (0%)"]
    assert "Certified to 1%: 66.67% of 3 images; largest gap 3.00%." in text


def test_results_of_another_model_are_refused(folder):
    write(folder / "alternate-nonnegative.h5", signed=True, objective=BEST)
    with pytest.raises(ValueError, match="another model"):
        sections(folder)


def test_no_section_without_the_search(tmp_path):
    assert sections(tmp_path) == []
