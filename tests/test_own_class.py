"""The commands of docs/own_class.md run on a clone, and give what the page says."""

import re
import shlex

import numpy as np
import pytest
from shapefit.cli.main import run

from shapefit.evaluation.metrics import similarity
from shapefit.io import read_results, read_shapes
from shapefit.io.writers.bones import JOINTS


@pytest.fixture(scope="module")
def page(project):
    return (project / "docs/own_class.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def made(project, page, tmp_path_factory):
    """The folder in which all commands of the page have run, in their order."""
    folder = tmp_path_factory.mktemp("own_class")
    (folder / "sample_data").symlink_to(project / "sample_data")
    blocks = re.findall(r"```console\n(.*?)```", page, re.DOTALL)
    commands = [line[2:] for block in blocks for line in block.splitlines()]
    assert len(commands) == 5
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for command in commands:
            assert run(shlex.split(command)[1:]) == 0, command
    return folder


def test_the_error_is_that_of_the_page(made, page):
    found = read_results(made / "dog.h5")
    truth = read_shapes([made / "sample_data/animal_truth.h5"])
    assert found.items == truth.items
    assert found.landmark_names == truth.landmark_names
    error = 1000 * similarity(found.shapes, truth.shapes).mean()
    (stated,) = re.findall(r"an error of (\d+) mm", page)
    assert error == pytest.approx(float(stated), abs=0.5)
    length = np.linalg.norm(truth.shapes[:, :, 3] - truth.shapes[:, :, 7], axis=1)
    assert length.mean() == pytest.approx(1.0, abs=0.25)  # from the nose to the tip of the tail


def test_the_dog_walks_out_in_metres_with_its_own_names(made):
    bones = read_shapes([made / "dog.bvh"])
    assert (len(bones), bones.frame_rate) == (100, 25)
    assert {"withers", "left_front_paw", "tail_tip"} <= set(bones.landmark_names)
    assert not set(JOINTS.values()) & set(bones.landmark_names)
    assert bones.shapes[:, 1].min() > -1.5
    assert "left_front_paw" in (made / "dog.html").read_text(encoding="utf-8")
