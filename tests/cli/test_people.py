"""What is in the box: `-d people` in every command that takes a dictionary."""

from pathlib import Path

import h5py
import numpy as np
import pytest
from shapefit.cli.main import run

from shapefit.io import read_shapes


@pytest.fixture
def views(project, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return str(project / "sample_data" / "people_views.csv")


def test_people_are_lifted_without_a_file_of_theirs(views, tmp_path, capsys):
    assert run(["fit", "-c", "people", views, "-d", "people", "-o", "result.h5"]) == 0
    with h5py.File(tmp_path / "result.h5") as file:
        assert file.attrs["method"] == "posterior"
        assert np.isfinite(file["shapes"][()]).all()
        assert (file["shape_sd"][()] > 0).all()
    assert run(["verify", "result.h5", "-d", "people"]) == 0
    assert "False      0 of 12 images" in capsys.readouterr().out


@pytest.mark.parametrize("y_axis", ["down", "up"])
def test_people_stand_on_their_feet_where_y_is_what_it_was_said_to_be(
    views, tmp_path, capsys, y_axis
):
    """Pixels of a detector count downwards; the same picture may count upwards, if that is said."""
    if y_axis == "up":
        lines = [line.split(",") for line in Path(views).read_text().splitlines()]
        turned = [[*row[:3], row[3] and f"{480 - float(row[3]):.1f}"] for row in lines[1:]]
        views = tmp_path / "turned.csv"
        views.write_text("\n".join(map(",".join, [lines[0], *turned])) + "\n")
    assert run(["info", str(views)]) == 0
    assert "y axis:       down, as the file does not say" in capsys.readouterr().out
    for said in ("down", "up"):
        line = ["fit", "-c", "people", str(views), "-d", "people", "-o", f"{said}.trc"]
        assert run([*line, *(["--set", "y_axis=up"] if said == "up" else [])]) == 0
        report = capsys.readouterr().err
        shapes = read_shapes([tmp_path / f"{said}.trc"])
        place = shapes.landmark_names.index
        ankles = shapes.shapes[:, 1, [place("lankle"), place("rankle")]].max(axis=1)
        assert ((shapes.shapes[:, 1, place("head")] > ankles) == (said == y_axis)).all()
        on_head = f"12 images with people on their heads: y was taken to point {said}"
        assert (f"{on_head}: if it points {y_axis}, set `y_axis: {y_axis}`" in report) == (
            said != y_axis
        )
