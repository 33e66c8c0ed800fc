"""What is in the box: `-d people` in every command that takes a dictionary."""

from __future__ import annotations

import h5py
import numpy as np
import pytest
from shapefit.cli.main import run


@pytest.fixture
def views(project, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return str(project / "sample_data" / "people_views.csv")


def test_info_states_source_licence_and_acknowledgement(views, capsys):
    assert run(["info", "people"]) == 0
    said = capsys.readouterr().out
    assert "CMU Motion Capture Database" in said
    assert "may not be resold directly" in said
    assert "NSF EIA-0196217" in said
    assert "go on with:   shapefit fit LANDMARKS -c people -d people -o result.h5" in said


def test_people_are_lifted_without_a_file_of_theirs(views, tmp_path, capsys):
    assert run(["fit", "-c", "people", views, "-d", "people", "-o", "result.h5"]) == 0
    with h5py.File(tmp_path / "result.h5") as file:
        assert file.attrs["method"] == "posterior"
        assert np.isfinite(file["shapes"][()]).all()
        assert (file["shape_sd"][()] > 0).all()
    assert run(["verify", "result.h5", "-d", "people"]) == 0
    assert "False" not in capsys.readouterr().out


def test_a_folder_may_hold_a_file_of_that_name(views, tmp_path, capsys):
    (tmp_path / "people").write_text("no dictionary")
    assert run(["fit", views, "-d", "people", "-o", "result.h5"]) == 2
    assert f"{tmp_path / 'people'}: " in capsys.readouterr().err


def test_an_unknown_name_lists_those_that_there_are(views, capsys):
    assert run(["fit", "-c", "people", views, "-d", "persons", "-o", "result.h5"]) == 2
    assert "no installed dictionary 'persons'; installed: people" in capsys.readouterr().err
