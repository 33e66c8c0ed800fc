"""The index of `make paper` says what the reports say, beside the paper's numbers."""

import json
import re
import runpy
from pathlib import Path

import pytest

MODULE = runpy.run_path(str(Path(__file__).resolve().parents[1] / "benchmarks/paper_index.py"))
index, SENSITIVITIES = MODULE["index"], MODULE["SENSITIVITIES"]


def sweep(key, values, mean=0.25, seconds=0.0005):
    points = [
        {"value": v, "group": g, "mean": mean + i / 100, "seconds_per_image": seconds}
        for v in values
        for i, g in enumerate(["Subject 13", "Subject 14"])
    ]
    return {"key": key, "points": points}


@pytest.fixture
def folder(tmp_path):
    summary = {"metric": "similarity", "unit": "normalised", "group": "Subject 13"}
    reports = {
        "mocap/report.json": {
            "methods": [
                {"name": "Convex", "solving": {"mean_objective": 0.1}},
                {"name": "Alternate", "solving": {"mean_objective": 0.8046}},
                {"name": "Alternate+", "solving": {"mean_objective": None}},
            ],
            "summaries": [
                {**summary, "method": "Convex", "sequence": None, "mean": 0.2891},
                {**summary, "method": "Convex", "sequence": "13_01", "mean": 0.9},
                {**summary, "method": "Convex", "unit": "m", "sequence": None, "mean": 0.07},
            ],
            "published": {"Convex (paper)": {"Subject 13": 0.259}},
            "caveats": ["The data are others."],
        },
        "recovery/recovery.json": {
            "cells": [{"trials": 100}],
            "published": {"largest_deviation": 0.117},
        },
        "timing/sweep.json": sweep("fit.method", ["convex", "mean-shape"]),
        "timing-pmp/sweep.json": sweep("fit.method", ["pmp"], seconds=0.002),
        **{f"{name}/sweep.json": sweep("key", [0.5]) for name in SENSITIVITIES},
    }
    for name, report in reports.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(json.dumps(report), encoding="utf-8")
    return tmp_path


def rows(page):
    lines = [re.split(r" *\| *", line.strip("| ")) for line in page.splitlines() if "|" in line]
    return {line[0]: line[1:] for line in lines}


def test_numbers_stand_beside_those_of_the_paper(folder):
    page = index(folder)
    assert rows(page)["Convex"] == ["0.289"]
    assert rows(page)["*Convex (paper)*"] == ["0.259"]
    assert rows(page)["convex"] == ["0.5", "*330*"]
    assert rows(page)["mean-shape"] == ["0.5", "–"]
    assert rows(page)["pmp"] == ["2", "*3020*"]
    assert rows(page)["0.5"] == ["0.250", "0.260"]
    assert "is 0.12." in page
    assert "Mean objectives here: Alternate 0.805, Alternate+ –." in page
    assert "- The data are others." in page


def test_planted_rotations_have_a_section(folder):
    cell = {"p": 15, "z": 3, "trials": 20, "certified": 0.9, "missed": 2, "better": 1, "stopped": 1}
    shares = {"global": 0.9, "convex+refine": 0.6, "alternate": 0.05, "convex": 0.3}
    (folder / "rotation-recovery.json").write_text(
        json.dumps({"cells": [cell | {"recovered": shares}]}), encoding="utf-8"
    )
    page = index(folder)
    assert rows(page)["15, `convex+refine`"] == ["60"]
    assert "certified 90.0% of 20 trials" in page


def test_every_report_is_linked(folder):
    page = index(folder)
    for path in folder.rglob("*.json"):
        name = path.relative_to(folder).with_suffix(".md")
        assert f"({name})" in page
