"""The tree of a global optimum: a true one passes, and every way to spoil one is found."""

from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from typing import NamedTuple

import h5py
import numpy as np
import pytest
from shapefit.cli.main import run as shapefit

from shapefit.dictionary.model import Dictionary
from shapefit.io import landmark_writer, write_dictionary
from shapefit.io.records import LandmarkSet

NAMES = tuple("abcdefghij")
HOLDS = "the cells hold all rotations"
VALUE = "the multipliers have the value of the bound"
FEASIBLE = "the multipliers are feasible in every cell"
BALANCED = "the multipliers are balanced"


class Done(NamedTuple):
    """How a command line ended, and all that it printed."""

    exit_code: int
    output: str


def run(*arguments: object) -> Done:
    printed = StringIO()
    with redirect_stdout(printed), redirect_stderr(printed):
        code = shapefit([str(one) for one in arguments])
    return Done(code, printed.getvalue())


@pytest.fixture(params=["plain", "confidence"])
def folder(request, tmp_path, rng):
    """A folder with a dictionary and the result of `global` with the tree of every second image."""
    mean = rng.standard_normal((3, 10))
    atoms = mean + 0.5 * rng.standard_normal((6, 3, 10))
    atoms -= atoms.mean(axis=2, keepdims=True)
    atoms /= atoms.std(axis=(1, 2), keepdims=True)
    write_dictionary(tmp_path / "dictionary.h5", Dictionary(atoms, NAMES, atoms.mean(axis=0)))
    landmarks = atoms[:5, :2] + 0.3 * rng.standard_normal((5, 2, 10))
    confidence = None
    if request.param == "confidence":
        confidence = rng.uniform(0.3, 1, (5, 10))
        confidence[1, 3] = 0
    with landmark_writer(tmp_path / "views.h5") as writer:
        writer.append(
            LandmarkSet(
                landmarks=landmarks,
                confidence=confidence,
                landmark_names=NAMES,
                items=tuple("12345"),
            )
        )
    options = ["method=global", "search.proof_every=2"]
    done = run(
        *("fit", tmp_path / "views.h5", "-d", tmp_path / "dictionary.h5"),
        *("-o", tmp_path / "result.h5"),
        *(part for option in options for part in ("--set", option)),
    )
    assert done.exit_code == 0, done.output
    return tmp_path


def missed(folder) -> set[str]:
    """Return the claims that do not hold for some image."""
    done = run("verify", folder / "result.h5", "-d", folder / "dictionary.h5")
    rows = [line.split("|") for line in done.output.splitlines() if line.startswith("| ")]
    wrong = {row[1].strip() for row in rows[1:] if row[3].strip() != "0"}
    assert done.exit_code == (1 if wrong else 0)
    return wrong


def test_a_true_tree_passes(folder):
    with h5py.File(folder / "result.h5") as file:
        cells, vertices = file["tree_cells"][:], file["tree_vertices"][:]
        assert (cells > 300).tolist() == [True, False, True, False, True]
        assert len(file["tree_splits"]) == cells.sum()
        assert len(file["tree_multipliers"]) == vertices.sum()
        assert set(file["status"].asstr()[:]) == {"optimal"}
    assert missed(folder) == set()


@pytest.mark.parametrize(
    ("spoil", "claim"),
    [
        ("split", HOLDS),
        ("leaf", HOLDS),
        ("root", HOLDS),
        ("middle", HOLDS),
        ("exchange", FEASIBLE),
        ("sign", VALUE),
        ("scale", FEASIBLE),
        ("bound", VALUE),
        ("balance", BALANCED),
    ],
)
def test_a_spoiled_tree_is_found(folder, spoil, claim):
    with h5py.File(folder / "result.h5", "r+") as file:
        splits, q, Y = file["tree_splits"], file["tree_rotations"], file["tree_multipliers"]
        if spoil == "split":
            splits[0] = 5 if splits[0] != 5 else 4
            splits[1] = -1
        elif spoil == "leaf":
            splits[np.flatnonzero(splits[:] == -1)[3]] = 0
        elif spoil == "root":
            q[4] = q[5]
        elif spoil == "middle":
            q[61] = q[61] + np.array([1e-9, 0, 0, 0])
        elif spoil == "exchange":
            count = file["tree_vertices"][0]
            Y[:count] = Y[:count][::-1]
        elif spoil == "sign":
            Y[7] = -Y[7]
        elif spoil == "scale":
            Y[:60] = 1.2 * Y[:60]
        elif spoil == "bound":
            file["relative_gap"][0] = 0.9 * file["relative_gap"][0]
        else:
            Y[3] = Y[3] + 1e-6
    assert claim in missed(folder)


def test_counts_of_cells_that_do_not_fit_are_refused(folder):
    with h5py.File(folder / "result.h5", "r+") as file:
        file["tree_cells"][0] += 1
    done = run("verify", folder / "result.h5", "-d", folder / "dictionary.h5")
    assert done.exit_code == 2
    assert "tree_cells counts" in done.output
