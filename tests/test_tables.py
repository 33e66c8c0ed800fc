"""A method, a file format and a metric are added by an entry in a table: each runs end
to end.
"""

import subprocess
import sys
from pathlib import Path

import h5py
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.dictionary.model import Dictionary
from shapefit.io import (
    landmark_writer,
    write_dictionary,
)
from shapefit.records import Landmarks

PROJECT = Path(__file__).resolve().parents[1]
NAMES = tuple("abcdef")


@pytest.fixture
def folder(tmp_path, rng) -> Path:
    """A folder with a dictionary of six landmarks, and five images of them."""
    atoms = rng.normal(size=(4, 3, 6))
    write_dictionary(tmp_path / "dictionary.h5", Dictionary(atoms, NAMES, atoms[0]))
    with landmark_writer(tmp_path / "views.h5") as writer:
        landmarks = rng.normal(size=(5, 2, 6))
        writer.append(
            Landmarks(
                landmarks.swapaxes(1, 2), landmark_names=NAMES, items=tuple("12345")
            )
        )
    return tmp_path


class Toy:
    """A new file beside the package, an entry in a table of it, and command lines run
    with both.
    """

    def __init__(self, folder: Path, module: str, entry: str) -> None:
        (folder / "toy.py").write_text(module, encoding="utf-8")
        self._entry = entry
        self._folder = folder

    def run(self, *lines: str) -> subprocess.CompletedProcess[str]:
        """Run command lines in one process, up to the first that fails."""
        source = (
            "import shlex, sys\nsys.path.insert(0,"
            f" {str(self._folder)!r})\n{self._entry}\nfrom shapefit.cli.main import"
            " run\nfor line in sys.argv[1:]:\n    if code := run(shlex.split(line)):\n"
            "        sys.exit(code)"
        )
        command = [sys.executable, "-c", source, *lines]
        return subprocess.run(
            command,
            capture_output=True,
            text=True,
            cwd=self._folder,
            timeout=120,
            check=False,
        )

    def succeed(self, *lines: str) -> None:
        done = self.run(*lines)
        assert done.returncode == 0, done.stderr


def errors_of(folder: Path, metric: str) -> list[float]:
    """Return the errors of a metric in the report of the folder, image by image."""
    text = (folder / "report/per_image.csv").read_text(encoding="utf-8")
    return [
        float(row.split(",")[4])
        for row in text.splitlines()[1:]
        if f",{metric}," in row
    ]


FLAT = '''
"""The method `flat`: every landmark at depth 0."""

import numpy as np

from shapefit.convex.solver import Status
from shapefit.lifting.estimate import AtomEstimate, fit_translation


def lift_flat(problem):
    shapes = np.concatenate([problem.landmarks, 0 * problem.landmarks[:, :1]], axis=1)
    placed, n = fit_translation(problem, shapes[:, :2]), len(shapes)
    return AtomEstimate(
        shapes=shapes,
        translation=placed.translation,
        rotation=np.tile(np.eye(3), (n, 1, 1)),
        objective=placed.half_squared_residual,
        residual=placed.residual,
        iterations=np.zeros(n, np.int64),
        status=(Status.CONVERGED,) * n,
    )
'''

FLAT_ENTRY = """
from shapefit.lifting.methods import METHODS, Method
METHODS["flat"] = Method(
    summary="every landmark at depth 0",
    learned=(),
    mixes_atoms=False,
)
from shapefit.pipelines.fit.atoms import ESTIMATORS
from toy import lift_flat
ESTIMATORS["flat"] = lambda family: lift_flat
"""


def test_a_method_is_a_file_and_an_entry(folder):
    fit = "fit views.h5 -d dictionary.h5 --set method=flat -o"
    Toy(folder, FLAT, FLAT_ENTRY).succeed(
        f"{fit} result.h5",
        f"{fit} truth.csv",
        "eval result.h5 --truth truth.csv -o report --set plots=none",
    )
    with (
        h5py.File(folder / "views.h5") as views,
        h5py.File(folder / "result.h5") as result,
    ):
        assert result.attrs["method"] == "flat"
        assert_allclose(result["shapes"][..., :2], views["landmarks"], atol=1e-12)
        assert not result["shapes"][:, :, 2].any()
        assert "coefficients" not in result
    errors = errors_of(folder, "similarity")
    assert len(errors) == 10  # five images, in two units
    assert max(errors) < 1e-6


POINTS = '''
"""A text file of landmarks: the word POINTS and the names, then one image a line."""

from contextlib import contextmanager

import numpy as np

from shapefit.io.options import Summary
from shapefit.io.readers.poses import poses_from_frames
from shapefit.io.atomic import atomic_path


def read_points(paths):
    first, *lines = paths[0].read_text().splitlines()
    names = tuple(first.split()[1:])
    rows = [line.split() for line in lines]
    numbers = np.array([row[1:] for row in rows], float).reshape(-1, len(names), 2)
    labels = [row[0] for row in rows]
    return poses_from_frames(paths[0], numbers, labels=labels, landmark_names=names)


@contextmanager
def write_points(target, form, options):
    with atomic_path(target) as path, path.open("w") as file:
        yield Writer(file)


class Writer:
    def __init__(self, file):
        self.attributes = {}
        self.summary = Summary()
        self.file = file
        self.begun = False

    def append(self, record):
        if not self.begun:
            print("POINTS", *record.landmark_names, file=self.file)
        self.begun = True
        for item, points in zip(record.items, record.landmarks, strict=True):
            print(item, *points.T.ravel().tolist(), file=self.file)
'''

POINTS_ENTRY = """
import toy
from shapefit.io.detect import FORMATS
from shapefit.io.formats import TARGETS, FileFormat
FORMATS["points"] = TARGETS["points"] = FileFormat(
    title="a points file",
    suffixes=(".points",),
    recognise=lambda head: head.bytes.startswith(b"POINTS"),
    records=("landmarks",), read_poses=toy.read_points,
    write=toy.write_points,
)
"""


def test_a_format_is_a_file_and_an_entry(folder):
    """It is recognised by content and fitted, written where an output is named so, or
    refused.
    """
    toy = Toy(folder, POINTS, POINTS_ENTRY)
    with h5py.File(folder / "views.h5") as file:
        views = file["landmarks"][:]
    lines = [
        f"{1 + i} {' '.join(map(repr, row.ravel().tolist()))}"
        for i, row in enumerate(views)
    ]
    for name in ("views.points", "views.txt"):
        text = "\n".join([f"POINTS {' '.join(NAMES)}", *lines])
        (folder / name).write_text(text, encoding="utf-8")
    toy.succeed(
        "fit views.points -d dictionary.h5 -o points.h5",
        "fit views.txt -d dictionary.h5 -o txt.h5",
        "fit views.points -d dictionary.h5 -o shapes.csv",
        "project shapes.csv -o again.points",
        "fit again.points -d dictionary.h5 -o other.h5",
    )
    for name in ("points", "txt"):
        with h5py.File(folder / f"{name}.h5") as result:
            assert_array_equal(result["landmarks"], views)
            assert result.attrs["y_axis"] == "down"
    assert (
        (folder / "again.points")
        .read_text(encoding="utf-8")
        .startswith("POINTS a b c d e f")
    )
    for line, told in (
        (
            "fit views.h5 -d dictionary.h5 -o result.points",
            "result.points: a result cannot be points; give it a name in .h5",
        ),
        (
            "fit views.h5 -d views.points -o result.h5",
            "views.points: is a points file, not an HDF5 file; give a",
        ),
    ):
        done = toy.run(line)
        assert (done.returncode, told in done.stderr) == (2, True), done.stderr
