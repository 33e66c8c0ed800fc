"""Workers of a cluster that are killed again and again: `SHAPEFIT_KILLS=200` for so many."""

import os
import random
import subprocess
import time

import h5py
import pytest

from tests.pipelines.parts.test_cluster import (
    SIZE,
    cluster,
    command,
    data,
    results,
    same_bits,
    start_worker,
)

pytestmark = pytest.mark.slow
__all__ = ["cluster", "data"]

KILLS = int(os.environ.get("SHAPEFIT_KILLS", "6"))
PAUSE = 1.5
"""Most seconds between two kills; a worker takes about one to start."""


def test_what_stands_is_whole_and_the_run_goes_on(data, cluster):
    rng, killed, runs = random.Random(0), 0, 0
    while killed < KILLS:
        output, code, runs = f"kills-{runs}/", 1, runs + 1
        words = command(output, "--scheduler", cluster.address)
        while code:
            process = subprocess.Popen(words, cwd=data, stderr=subprocess.DEVNULL)
            while process.poll() is None:
                time.sleep(rng.uniform(0, PAUSE))
                if killed < KILLS and process.poll() is None:
                    number = rng.randrange(2)
                    cluster.workers[number].kill()
                    cluster.workers[number].wait()
                    cluster.workers[number] = start_worker(cluster)
                    killed += 1
            code = process.returncode
            assert code in (0, 1), f"after {killed} kills"
            for path in results(data / output):
                with h5py.File(path) as file:
                    assert len(file["item"]) == SIZE
        same_bits(data, output)
    print(f"{killed} kills in {runs} runs")
