"""What a process imports: start-up is most of the time of a short run."""

import json
import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from shapefit.dictionary.model import Dictionary
from shapefit.io import (
    landmark_writer,
    write_dictionary,
)
from shapefit.records import Landmarks

OF_HELP = "h5py numba numpy orjson pyarrow pydantic ruamel scipy tqdm trimesh"
OF_OTHER_FITS = """
    concurrent.futures dask distributed llvmlite matplotlib multiprocessing numba
    numpy.f2py
    numpy.ma numpy.polynomial numpy.random numpy.testing polars ruamel scipy
    shapefit.config.commands.others shapefit.config.manifest
    shapefit.evaluation shapefit.lifting.perspective
    shapefit.lifting.consensus shapefit.lifting.sequences
    shapefit.lifting.posterior.method
    shapefit.meshes shapefit.pipelines.meshes shapefit.pipelines.partition.run
    shapefit.pipelines.fit.sequences tqdm trimesh
"""
NEEDED = "numpy h5py pydantic shapefit.config.commands.fit shapefit.io.csv_file"

SCRIPT = """
import sys
from shapefit.cli.main import run
code = run(sys.argv[1:])
print("imported", *sys.modules)
sys.exit(code)
"""


def imported(*arguments: object) -> set[str]:
    """Return the modules that a command line imports."""
    command = [sys.executable, "-c", SCRIPT, *map(str, arguments)]
    done = subprocess.run(
        command, capture_output=True, text=True, check=True, timeout=120
    )
    return set(done.stdout.splitlines()[-1].split()[1:])


@pytest.fixture(scope="module")
def of_a_fit(tmp_path_factory) -> set[str]:
    folder = tmp_path_factory.mktemp("start-up")
    rng = np.random.default_rng(0)
    names = tuple("abcdef")
    atoms = rng.normal(size=(4, 3, 6))
    write_dictionary(folder / "dictionary.h5", Dictionary(atoms, names, atoms[0]))
    with landmark_writer(folder / "one.csv") as writer:
        landmarks = rng.normal(size=(1, 2, 6))
        writer.append(
            Landmarks(landmarks.swapaxes(1, 2), landmark_names=names, items=("image",))
        )
    out = folder / "out.csv"
    modules = imported(
        "fit", folder / "one.csv", "-d", folder / "dictionary.h5", "-o", out
    )
    assert out.read_text().startswith("item,landmark,x,y,z\n")
    return modules


@pytest.mark.parametrize("arguments", [("--help",), ("--version",), ("fit", "--help")])
def test_help_imports_nothing_heavy(arguments):
    roots = {name.partition(".")[0] for name in imported(*arguments)}
    assert not roots & set(OF_HELP.split())


def test_a_fit_of_csv_imports_what_it_needs_and_no_more(of_a_fit):
    assert not of_a_fit & set(OF_OTHER_FITS.split())
    assert of_a_fit >= set(NEEDED.split())


def test_what_a_fit_must_not_import_is_there():
    named = [name for name in OF_OTHER_FITS.split() if name.startswith("shapefit.")]
    assert [name for name in named if find_spec(name) is None] == []


def test_no_cycles_are_looked_for_in_what_was_imported():
    script = (
        "import gc, sys; gc.disable()\nfrom shapefit.cli.main import run\ncode ="
        " run(sys.argv[1:]); print(gc.isenabled(), gc.get_freeze_count());"
        " sys.exit(code)"
    )
    image = Path(__file__).parents[2] / "sample_data/one_person.csv"
    command = [sys.executable, "-c", script, "info", str(image)]
    done = subprocess.run(
        command, capture_output=True, text=True, check=True, timeout=120
    )
    enabled, frozen = done.stdout.splitlines()[-1].split()
    assert enabled == "True"
    assert int(frozen) > 10_000


WRITES = """
import json, os, sys
written = set()
def hook(event, arguments):
    name = arguments[0] if arguments else None
    if event == "open" and isinstance(name, (str, bytes, os.PathLike)):
        if (arguments[2] or 0) & (os.O_WRONLY | os.O_RDWR | os.O_CREAT):
            written.add(os.path.realpath(os.fsdecode(name)))
    elif event in ("os.mkdir", "os.rename"):
        written.add(os.path.realpath(os.fsdecode(name)))
sys.addaudithook(hook)
sys.dont_write_bytecode = True
from shapefit.cli.main import run
code = run(sys.argv[1:])
found = {"code": code, "written": sorted(written), "modules": list(sys.modules)}
print(json.dumps(found))
"""


def test_a_fit_without_a_home_writes_its_output_alone_and_reads_one_word_itself(
    project, tmp_path
):
    views = project / "sample_data/one_person.csv"
    out = tmp_path / "out"
    out.mkdir()
    done = subprocess.run(
        [
            sys.executable,
            "-c",
            WRITES,
            "fit",
            views,
            "-o",
            out / "result.h5",
            "--set",
            "method=posterior",
        ],
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
        env={
            **os.environ,
            **dict.fromkeys(("HOME", "XDG_CACHE_HOME"), "/no"),
            "TMPDIR": str(out),
        },
    )
    told = json.loads(done.stdout.splitlines()[-1])
    assert told["code"] == 0
    own = (str(out), "/dev/", "/proc/")
    assert [name for name in told["written"] if not name.startswith(own)] == []
    assert not {"numpy.ma", "ruamel"} & set(told["modules"])
