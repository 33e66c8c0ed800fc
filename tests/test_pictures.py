"""The pictures of the demo in README and docs are those that `make pictures` makes today."""

import contextlib
import re

import numpy as np
import pytest
from shapefit.cli.main import run as run_command

from tests.viewer.conftest import require

LIMIT = 0.1
"""Of the mean absolute difference of pixels, of 255; drawn again, a picture has less than 0.001."""


@pytest.fixture(scope="module")
def demo(project, tmp_path_factory):
    """Return the folder of the results of `make demo` that pictures are made of."""
    folder = tmp_path_factory.mktemp("pictures")
    makefile = (project / "Makefile").read_text("utf-8").replace("\\\n", "")
    (walk,) = re.findall(r"\$\(SHAPEFIT\) (fit sample_data/openpose .*)", makefile)
    (folder / "sample_data").symlink_to(project / "sample_data")
    with contextlib.chdir(folder):
        assert run_command(walk.split()) == 0
    return folder / "results/demo"


def check(project, folder, *names):
    """Fail unless the pictures in the folder are those of the docs."""
    from PIL import Image

    for name in names:
        old, new = (
            np.asarray(Image.open(place / f"{name}.png").convert("RGB"), dtype=float)
            for place in (project / "docs/images", folder)
        )
        assert old.shape == new.shape, f"{name}.png: run `make pictures`"
        far = np.abs(old - new).mean()
        assert far < LIMIT, f"{name}.png differs by {far:.3f}: look at it, and run `make pictures`"


@pytest.mark.slow
def test_pages(project, demo, tmp_path):
    require("chromium")
    require("chromedriver")
    from tools.page_pictures import photograph

    photograph(demo, tmp_path)
    check(project, tmp_path, "walk")
