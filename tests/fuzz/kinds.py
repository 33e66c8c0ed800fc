"""Kinds of cases: good files, and what spoils one of them and names the command that
reads it.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Mapping
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from random import Random
from typing import Any

import h5py
import numpy as np
from shapefit.cli.main import run

from shapefit.io import (
    read_shapes,
    write_shapes,
)
from shapefit.records import Shapes
from tests.io.readers.made import DETECTORS, TRACKERS

from .spoil import (
    NAMES,
    NUMBERS,
    insert,
    spoil_bytes,
    spoil_hdf5,
    spoil_json,
    spoil_table,
    spoil_text_bytes,
)

MOTION = Path(__file__).with_name("motion")
"""Small files of 3D motion."""

Command = tuple[str, ...]
Make = Callable[[Random, Path], Command]
"""Spoil the files of a folder, and return the command line that reads them."""

SAMPLE = Path(__file__).resolve().parents[2] / "sample_data" / "people_test.h5"

HAS_EZC3D = find_spec("ezc3d") is not None
"""Whether C3D can be written; else its cases read a file that is not there."""

OF_SEQUENCES = "m_a.c3d"
"""The first of the files that C3D of several sequences is written to."""

C3D_HEAD = 1536
"""Bytes of the header and the parameters of C3D."""

ITEMS = 8
"""Shapes and images in each file: a case should take some milliseconds."""

FIT = ("fit", "views.h5", "-d", "dict.h5", "-o", "out.h5", "--set=threads=1")
LEARN = ("-o", "out.h5", "--set=k=3", "--set=iterations=2")
NO_PLOTS = "--set=plots=none"


TRACKED_SIZE = (5, 4)
"""Frames and landmarks of files of trackers."""


DETECTED_SIZE = (4, 5)
"""Those of files of detectors."""


def make_shapes() -> tuple[Shapes, Shapes]:
    """Return a few people, and the same with a mesh and further fields."""
    people = read_shapes([SAMPLE])
    rng = np.random.default_rng(0)
    few = people.take(np.linspace(0, len(people) - 1, ITEMS).astype(int))
    noise = 0.1 * rng.standard_normal((ITEMS, 6, 3))
    meshed = Shapes(
        few.points,
        landmark_names=few.landmark_names,
        items=few.items,
        sequences=tuple("ab"[number % 2] for number in range(ITEMS)),
        edges=few.edges,
        mesh_vertices=few.points[:, :6] + noise,
        mesh_faces=np.array([[0, 1, 2], [3, 4, 5]]),
        unit="m",
        extras={
            "weight": rng.uniform(size=ITEMS),
            "model": np.array(few.items, object),
        },
    )
    return few, meshed


def make_files_of_other_tools(folder: Path) -> None:
    """Write files of two people or animals in all formats of trackers and detectors."""
    rng = np.random.default_rng(1)
    for writers, (frames, p) in ((TRACKERS, TRACKED_SIZE), (DETECTORS, DETECTED_SIZE)):
        points = rng.integers(1, 600, (frames, 2, p, 2)).astype(float)
        for name, write in writers.items():
            write(folder / name, points, rng.uniform(size=(frames, 2, p)))


LEARN_BASE = ("learn-dict", "shapes.h5")


FIT_BASE = ("fit", "views.h5", "-d", "dict.h5")


PROJECT_KEYS = ("--set", "camera.view=random", "--set", "hidden=0.1")


TO_C3D = ("convert", "shapes.h5", "-o", "m.c3d")


BASE_COMMANDS: tuple[Command, ...] = (
    (*LEARN_BASE, "--set", "iterations=2", "--set", "k=4", "-o", "dict.h5"),
    (*LEARN_BASE, "--set", "method=exemplars", "-o", "exemplars.h5"),
    (*LEARN_BASE, "--set", "method=pca-bases", "-o", "bases.h5"),
    ("project", "shapes.h5", *PROJECT_KEYS, "-o", "views.h5"),
    ("project", "shapes.csv", *PROJECT_KEYS, "-o", "views.csv"),
    (*FIT_BASE, "-o", "result.h5"),
    ("fit", "views.csv", "-d", "dict.h5", "-o", "result.csv"),
    (*FIT_BASE, "-o", "refined.h5", "--set=method=convex+refine"),
    ("fit", "views.h5", "-d", "bases.h5", "-o", "x.h5", "--set", "method=pmp"),
    *([TO_C3D] if HAS_EZC3D else []),
    ("eval", "result.h5", "--truth", "shapes.h5", "-o", "report", NO_PLOTS),
    ("verify", "result.h5", "-d", "dict.h5", "--landmarks", "views.h5"),
    ("view", "result.h5", "--truth", "shapes.h5", "-o", "page.html"),
)
"""Commands that make the good files, and that import what cases need."""


def make_base_files(folder: Path) -> None:
    """Fill the folder by the commands themselves; raises RuntimeError where one of them
    fails.

    They also import and compile whatever the cases need, so that these can be forked.
    """
    os.chdir(folder)
    few, meshed = make_shapes()
    write_shapes(Path("shapes.h5"), meshed)
    write_shapes(Path("shapes.csv"), few)
    make_files_of_other_tools(folder)
    for command in BASE_COMMANDS:
        if run(command) not in (0, 1):
            raise RuntimeError(f"a good command fails: {' '.join(command)}")


SETTINGS_OF_FIT = (
    "outliers=none",
    "outliers=l1",
    "outliers=sparse-error",
    "outliers=ransac",
    "method=convex+refine",
    "method=alternate",
    "method=mean-shape",
    "method=global",
    "export.folder=out_meshes",
    "leave_one_out=model",
    "lambda=auto",
    "noise=0.1",
)


FIT_ANY = ("fit", "{}", "-d", "dict.h5", "-o", "out.h5", "--set=threads=1")


# Our own files


TRUTH = ("--truth", "shapes.h5", "-o", "out", NO_PLOTS)
VERIFY = ("-d", "dict.h5", "--landmarks", "views.h5")
OF_SHAPES = (
    ("learn-dict", "{}", *LEARN),
    ("learn-dict", "{}", "-o", "out.h5", "--set=method=exemplars"),
    ("project", "{}", "-o", "out.csv", "--set=hidden=0.2", "--set=noise=0.1"),
    ("eval", "result.h5", "--truth", "{}", "-o", "out", NO_PLOTS),
    *(
        ("convert", "{}", "-o", f"out.{suffix}")
        for suffix in ("trc", "bvh", "metres.csv")
    ),
    ("view", "{}", "-o", "out.html"),
)
OF_IMAGES = tuple((*FIT_ANY, f"--set={setting}") for setting in SETTINGS_OF_FIT)
OF_RESULTS = (
    ("eval", "{}", *TRUTH),
    ("verify", "{}", *VERIFY),
    ("view", "views.h5", "{}", "--truth", "shapes.h5", "-o", "out.html"),
    ("convert", "{}", "-o", "out.trc", "--height", "1.8"),
)
OF_DICTIONARIES = (
    ("fit", "views.h5", "-d", "{}", "-o", "out.h5", "--set=threads=1"),
    ("fit", "views.h5", "-d", "{}", "-o", "out.h5", "--set=method=pmp"),
    ("verify", "result.h5", "-d", "{}"),
)
READ_BY = {
    **dict.fromkeys(("shapes.h5", "shapes.csv"), OF_SHAPES),
    **dict.fromkeys(("views.h5", "views.csv"), OF_IMAGES),
    **dict.fromkeys(("result.h5", "refined.h5"), OF_RESULTS),
    **dict.fromkeys(("dict.h5", "exemplars.h5", "bases.h5"), OF_DICTIONARIES),
    "result.csv": (OF_RESULTS[0], ("view", "{}", "-o", "out.html")),
}
"""Good files, and the commands that read them."""


def make_ours(rng: Random, folder: Path) -> Command:
    """Spoil one of our files, and read it."""
    name = rng.choice([*READ_BY])
    spoil = spoil_table if name.endswith(".csv") else spoil_hdf5
    spoil(rng, folder / name)
    return tuple(word.format(name) for word in rng.choice(READ_BY[name]))


# Files of other tools


def make_tracker(rng: Random, folder: Path) -> Command:
    """Spoil a file of a tracker of animals, and convert it."""
    name = rng.choice(list(TRACKERS))
    with suppress(ValueError, IndexError):  # changes that need a row with cells
        (spoil_table if name.endswith(".csv") else spoil_hdf5)(rng, folder / name)
    return _read(rng, name)


def _read(rng: Random, name: str) -> Command:
    """Return a command that reads a file of another tool."""
    convert = ("convert", name, "-o", rng.choice(("out.h5", "out.csv")))
    fit = ("fit", name, "-d", "dict.h5", "-o", "out.h5", "--set=threads=1")
    return rng.choice((convert, convert, ("info", name), fit))


def make_detector(rng: Random, folder: Path) -> Command:
    """Spoil a file of a detector of people, one of its folder, or of 3D motion, and
    convert it.
    """
    shutil.copytree(MOTION, folder, dirs_exist_ok=True)
    further = ("m.trc", "m.bvh", "m.amc", "m.csv", "m.tps", "m.pts", "t.csv")
    name = rng.choice((*DETECTORS, *further))
    path = folder / name
    if path.is_dir():
        path = rng.choice(sorted(path.iterdir()))
    if path.suffix == ".json" and rng.random() < 0.8:
        spoil_json(rng, path)
    elif path.suffix.startswith(".np"):
        spoil_bytes(rng, path)
    else:
        path.write_bytes(spoil_text_bytes(rng, path.read_bytes()))
    given = name if rng.random() < 0.7 else str(path.relative_to(folder))
    return _read(rng, given)


def make_c3d(rng: Random, folder: Path) -> Command:
    """Spoil a C3D file, mostly in its header and parameters, and read it."""
    path = folder / OF_SEQUENCES
    if path.exists():
        data = path.read_bytes()
        head = C3D_HEAD if rng.random() < 0.7 else len(data)
        path.write_bytes(data[:head])
        spoil_bytes(rng, path)
        if rng.random() < 0.8:
            path.write_bytes(path.read_bytes() + data[head:])
    return _read(rng, path.name)


# Configs


COMMANDS = {
    "learn-dict": {
        "shapes": "shapes.h5",
        "output": "out.h5",
        "k": "3",
        "iterations": "2",
    },
    "project": {"shapes": "shapes.h5", "output": "out.h5"},
    "fit": {
        "landmarks": "views.h5",
        "dictionary": "dict.h5",
        "output": "out.h5",
        "threads": "1",
    },
    "eval": {
        "results": "result.h5",
        "truth": "shapes.h5",
        "output": "out",
        "plots": "none",
    },
    "view": {"files": "result.h5", "truth": "shapes.h5", "output": "out.html"},
}
"""A good config of each command."""

YAML_VALUES = (
    *NUMBERS,
    "[]",
    "{}",
    "[1]",
    "[a, b]",
    "{a: 1}",
    "[[1], 2]",
    "{a: {b: 1}}",
    "~",
    "*a",
    "&a 1",
    "!!int x",
    "!!python/object:os.system x",
    "!!binary aGk=",
    "2020-01-01",
    "yes",
    "no",
    "off",
    "|",
    ">",
    "'",
    '"',
    "[",
    "{",
    "- a",
    "? a",
    "<<: {a: 1}",
    "!!set {a}",
    '"\\ud800"',
    '"\\0"',
    "@a",
    "%a",
    "/",
    "/dev/null",
    "/dev/full",
    "-",
    ".",
    "shapes.h5",
    "dict.h5",
    "views.h5",
    "nowhere.h5",
    "'*.h5'",
    "result.h5",
    "[views.h5, views.csv]",
    "views.csv",
    "{m: result.h5}",
    "all",
    "auto",
    "[nose, neck, pelvis]",
    "item",
    "model",
    "weight",
    "none",
    "[0.3, 0.2]",
)

KEYS = (
    "method",
    "camera",
    "outliers",
    "save",
    "lambda",
    "seed",
    "rename",
    "mirror",
    "views",
    "k",
)
"""Keys that get any value, whether the command has them or not."""


def make_yaml(rng: Random, folder: Path) -> Command:
    """A good config with some values of any kind, spoiled as text."""
    command = rng.choice(list(COMMANDS))
    keys = rng.choices(KEYS, k=rng.choice((0, 1, 2)))
    settings = COMMANDS[command] | {key: str(rng.choice(YAML_VALUES)) for key in keys}
    text = "".join(f"{key}: {value}\n" for key, value in settings.items())
    for _ in range(rng.choice((0, 1, 1, 2))):
        text = _spoil_yaml(rng, text)
    (folder / "config.yaml").write_bytes(text.encode("utf-8", "surrogatepass"))
    return (command, "-c", "config.yaml")


def _spoil_yaml(rng: Random, text: str) -> str:
    marks = (*":-[]{}#&*!|>'\"%@`,?\t\n\0\r\x85\u2028", "[" * 10, "[" * 3000)
    letters = tuple(map(chr, (0xD800, 0xFEFF, 0x10FFFF, 0xE9, 7)))
    match rng.randrange(7):
        case 0:
            return text[: rng.randrange(len(text) + 1)]
        case 1:
            return text + rng.choice(text.splitlines() or [""]) + "\n"
        case 2:
            ends = ("\n  ", "\r", "\n---\n", "\n...\n", "\n\t")
            return text.replace("\n", rng.choice(ends))
        case 3:
            return text + aliases_of_aliases(rng.randrange(9))
        case 4:
            return "%YAML 1.1\n---\n" + text
        case _:
            return str(
                insert(rng, text, rng.choice((*marks, *letters, *YAML_VALUES, *NAMES)))
            )


def aliases_of_aliases(depth: int) -> str:
    """Return a key whose value is ten times the one before, so many times."""
    lists = ["&a [x,x,x,x,x,x,x,x,x,x]"]
    for number in range(depth):
        alias = "*" + chr(97 + number)
        lists.append(f"&{chr(98 + number)} [{','.join([alias] * 10)}]")
    return f"metrics: [{', '.join(lists)}]\n"


KINDS: Mapping[str, Make] = {
    "c3d": make_c3d,
    "detectors": make_detector,
    "ours": make_ours,
    "trackers": make_tracker,
    "yaml": make_yaml,
}
"""Kind -> what spoils the files of a folder and returns the command line that reads
them.
"""


# What once ended in an internal error, a crash, a hang or nonsense

PMP = ("fit", "views.h5", "-d", "bases.h5", "-o", "out.h5", "--set=method=pmp")
VIEW = ("view", "result.h5", "--truth", "shapes.h5", "-o", "out.html")
PROJECT = ("project", "shapes.h5", "-o", "out.h5")

Finding = tuple[str, Mapping[Any, Any], Command]

FINDINGS: Mapping[str, Finding] = {
    "items-that-nobody-wrote": (
        "shapes.h5",
        {
            **dict.fromkeys(
                ("sequence", "mesh_vertices", "mesh_faces", "weight", "model")
            ),
            "shapes": ((10**9, 15, 3), (1000, 15, 3)),
            "item": ((10**9,), (10**5,)),
        },
        PROJECT,
    ),
    "further-dataset-without-end": (
        "views.h5",
        {"further": ((10**10,), (10**4,))},
        FIT,
    ),
    "a-chunk-for-each-value": ("dict.h5", {"objective_trace": ((10**6,), (1,))}, FIT),
    "landmarks-whose-span-overflows": (
        "result.h5",
        {"landmarks": np.resize([1e308, -1e308], (8, 15, 2))},
        VIEW,
    ),
    "zero-byte-in-an-item": (
        "views.h5",
        {"item": np.array([f"a\0{i}".encode() for i in range(8)], "S4")},
        FIT,
    ),
    "dataset-whose-name-is-not-utf8": (
        "shapes.h5",
        {b"\xff\xfe": np.zeros(8)},
        PROJECT,
    ),
    "limbs-without-a-length": ("bases.h5", {"edges": np.array([[0, 0], [1, 1]])}, PMP),
    "aliases-of-aliases": (
        "config.yaml",
        {0: aliases_of_aliases(8)},
        ("eval", "-c", "config.yaml"),
    ),
    "table-without-end": (
        "",
        {},
        ("fit", "/dev/zero", "-d", "dict.h5", "-o", "out.h5"),
    ),
}
"""Name -> the file that is changed, its changes, and the command line that reads it."""


def edit(path: Path, changes: Mapping[Any, Any]) -> None:
    """Change lines of a text by their numbers, or datasets and `@attributes` of an HDF5
    file.

    None deletes a dataset, and a tuple (shape, chunks) is one that nobody wrote.
    """
    if path.suffix != ".h5":
        lines = path.read_text().splitlines() if path.exists() else [""]
        lines = [changes.get(number, line) for number, line in enumerate(lines)]
        path.write_text("\n".join(lines) + "\n")
        return
    with h5py.File(path, "r+") as file:
        for name, value in changes.items():
            if isinstance(name, str) and name.startswith("@"):
                file.attrs[name[1:]] = value
                continue
            if name in set(file):
                del file[name]
            if isinstance(value, tuple):
                shape, chunks = value
                kind = "S1" if name == "item" else "f8"
                file.create_dataset(name, shape, kind, chunks=chunks)
            elif value is not None:
                file[name] = value
