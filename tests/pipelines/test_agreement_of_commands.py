"""Every level of the processor has the optimum of the others, with its proof."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from shapefit.cli.main import run

from shapefit import core
from shapefit.io import read_results

COMMAND = Path(sys.executable).with_name("shapefit")


@pytest.mark.parametrize("loss", ["outliers=none", "outliers=sparse-error"])
def test_levels_of_the_processor_have_one_optimum_and_a_proof(world, tmp_path, loss):
    """A level is chosen when the core is loaded: each has a process of its own."""
    views, dictionary = world.images("people"), world.dictionary("people")
    found = {}
    for level in core.LEVELS:
        output = tmp_path / f"{level}.h5"
        command = [COMMAND, "fit", views, "-d", dictionary, "-o", output, "--set", loss]
        environment = os.environ | {"SHAPEFIT_LEVEL": str(level)}
        command += ["--set", "tolerance=1e-9"]
        subprocess.run(command, env=environment, check=True, capture_output=True, timeout=120)
        found[level] = read_results(output)
        words = ["verify", output, "-d", dictionary, "--landmarks", views, "-q"]
        assert run(list(map(str, words))) == 0
    first, *others = found.values()
    for other in others:
        np.testing.assert_array_equal(other.status, first.status)
        np.testing.assert_allclose(other.objective, first.objective, rtol=1e-7)
