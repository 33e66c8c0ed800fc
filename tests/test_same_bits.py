"""One answer in every way, to the last bit: threads, parts, formats."""

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from shapefit.config import FitConfig
from shapefit.config.paths import ResultFolder
from shapefit.io import open_landmarks
from shapefit.pipelines.fit.family import Calibration
from shapefit.pipelines.fit.fit import WHOLE_FIT, FitPart, fit
from shapefit.pipelines.partition.run import fit_parts
from tests.api.conftest import read_values
from tests.io.files import save

PERSPECTIVE = {
    "method": "convex+refine",
    "camera": {"focal": 1500.0, "principal_point": [0.0, 0.0]},
}


METHODS = {
    "convex": ("people", {}),
    "l1": ("people", {"method": "convex", "outliers": "l1"}),
    "ransac": ("people", {"method": "convex+refine", "outliers": "ransac"}),
    "convex+refine": ("people", {}),
    "alternate": ("people", {}),
    "mean-shape": ("people", {}),
    "global": ("people", {}),
    "pmp": ("bases of people", {}),
    "posterior": ("people with a prior", {}),
    "sequences": ("people with a prior", {}),
    "perspective": ("people", PERSPECTIVE),
}
"""Method or chain -> the dictionary that it takes, and its keys of `fit`."""

WAYS = {
    "one thread, CSV and HDF5": {"threads": 1, "landmarks": ["a.csv", "b.h5"]},
    "parts": {"output": ResultFolder(Path("parts"), 64, replace=True)},
    "workers": {"output": ResultFolder(Path("workers"), 64, 2, replace=True)},
}
"""Way -> the keys of `fit` that differ."""

SLOW_WAYS = {"workers": ("convex", "sequences")}
"""Those that take seconds to start are gone with these methods only."""

SLOW = {("pmp", "one thread, CSV and HDF5"), ("sequences", "workers")}


@pytest.fixture(scope="module")
def folder(world, tmp_path_factory):
    """Views of two sequences of 64 images, one after the other, in every format.

    Images start from the solutions of neighbours within 64: files and parts are cut
    there.
    """
    folder = tmp_path_factory.mktemp("same_bits")
    views = world.views("people", noise=0.01, hidden=0.1, y_axis="down")
    with open_landmarks([views]) as source:
        images = source.whole()
    rows = np.concatenate([np.arange(start, start + 64) for start in (0, 80)])
    images = images.take(rows).replaced(extras={}, file_extras={})
    save(folder / "views.h5", images)
    save(folder / "a.csv", images.take(slice(64)))
    save(folder / "b.h5", images.take(slice(64, None)))
    return folder


OF_A_FILE = ("landmark_names", "input_landmark_names", "edges", "landmark_map")
"""Datasets without an axis of images."""


def keys_of(case: str) -> dict:
    """Return the keys of `fit` of a method."""
    _, keys = METHODS[case]
    return {"method": case, "frame_rate": 24, "tolerance": 1e-6, **keys}


def run(world, folder: Path, case: str, part: FitPart = WHOLE_FIT, **way) -> list[Path]:
    """Fit by a method; return the results, one or several."""
    way = {"landmarks": ["views.h5"], "output": Path("other.h5"), **way}
    dictionary, _ = METHODS[case]
    output = way.pop("output")
    in_parts = isinstance(output, ResultFolder)
    written = folder / (output.path if in_parts else output)
    config = FitConfig(
        **keys_of(case),
        **way
        | {
            "landmarks": [str(folder / name) for name in way["landmarks"]],
            "dictionary": str(world.dictionary(dictionary)),
            "output": replace(output, path=written) if in_parts else written,
        },
    )
    outcomes = fit_parts(config) if in_parts else fit(config, part)
    for outcome in outcomes:
        assert not outcome.failures
    return sorted(written.glob("*.h5")) if in_parts else [written]


def datasets(paths: list[Path]) -> dict[str, np.ndarray]:
    """Return the datasets of the results, one file after the other."""
    parts: dict[str, list[np.ndarray]] = {}
    for path in paths:
        with h5py.File(path) as file:
            for name, node in file.items():
                if isinstance(node, h5py.Dataset):
                    parts.setdefault(name, []).append(read_values(node))
    whole = {}
    for name, values in parts.items():
        whole[name] = values[0] if name in OF_A_FILE else np.concatenate(values)
    return whole


CASES = [
    pytest.param(case, way, marks=[pytest.mark.slow] * ((case, way) in SLOW))
    for case in METHODS
    for way in WAYS
    if case in SLOW_WAYS.get(way, METHODS)
]


@pytest.fixture(scope="module")
def expected(world, folder):
    """Return what fits by a method in the plain way, once."""
    known: dict[str, dict[str, np.ndarray]] = {}

    def plain(case):
        if case not in known:
            known[case] = datasets(run(world, folder, case))
        return known[case]

    return plain


@pytest.mark.parametrize(("case", "way"), CASES)
def test_every_way_has_the_same_bits(world, folder, expected, case, way):
    plain = expected(case)
    found = datasets(run(world, folder, case, **WAYS[way]))
    assert len(plain) >= 5
    for name in plain:
        assert_array_equal(found[name], plain[name], err_msg=name)


SIZES_OF_FILES = (1, 64, 1, 2, 30)

SMALL_FILES = ("convex", "l1", "ransac", "convex+refine", "perspective", "posterior")


@pytest.fixture(scope="module")
def small_files(folder):
    """Files of one image and of many, which follow each other in a video."""
    with open_landmarks([folder / "views.h5"]) as source:
        images = source.whole().replaced(frames=None, times=None, sequences=None)
    names = []
    stop = 0
    for count in SIZES_OF_FILES:
        start, stop = stop, stop + count
        names.append(f"from {start}.csv")
        save(folder / names[-1], images.take(slice(start, stop)))
    return names


@pytest.mark.parametrize("case", SMALL_FILES)
@pytest.mark.parametrize("threads", [1, 2])
def test_a_file_has_the_same_bits_whatever_others_are_given(
    world, folder, small_files, case, threads
):
    part = FitPart(calibration=Calibration(lines=("camera: unknown",)))
    way = {"threads": threads, "landmarks": small_files}
    together = datasets(run(world, folder, case, part, **way))
    alone: dict[str, list[np.ndarray]] = {}
    for name in small_files:
        of_file = datasets(run(world, folder, case, part, landmarks=[name]))
        for dataset, values in of_file.items():
            alone.setdefault(dataset, []).append(values)
    assert len(together) >= 5
    for name, values in together.items():
        expected = alone[name][0]
        if name not in OF_A_FILE:
            expected = np.concatenate(alone[name])
        assert_array_equal(values, expected, err_msg=name)
