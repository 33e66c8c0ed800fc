"""Inputs that once ended in an internal error, a crash, a hang or nonsense, one by one.

Each is made from the good files of a folder, as the cases of the other kinds are, and judged as
they are.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from .kinds import FIT, LEARN, Command, aliases_of_aliases

BEYOND_INT64 = 10**20
PMP = ("fit", "views.h5", "-d", "bases.h5", "-o", "out.h5", "--set=method=pmp")
ALTERNATE = (*FIT, "--set=method=alternate")


def _edit(path: Path, delete: str = "", **datasets: Any) -> None:
    """Delete datasets, and put others in the place of what has their names.

    A tuple (shape, type, chunks) is a dataset that nobody wrote.
    """
    with h5py.File(path, "r+") as file:
        for name in {*delete.split(), *datasets} & {*file}:
            del file[name]
        for name, values in datasets.items():
            if isinstance(values, tuple):
                shape, kind, chunks = values
                file.create_dataset(name, shape, kind, chunks=chunks)
            else:
                file[name] = values


def _attribute(path: Path, name: str, value: Any) -> None:
    with h5py.File(path, "r+") as file:
        file.attrs[name] = value


def _landmarks(folder: Path) -> Any:
    with h5py.File(folder / "views.h5") as file:
        return file["landmarks"][()]


def _huge_coordinate(folder: Path) -> None:
    path = folder / "shapes.csv"
    lines = path.read_text().splitlines()
    lines[4] = ",".join([*lines[4].split(",")[:3], "1e160", *lines[4].split(",")[4:]])
    path.write_text("\n".join(lines) + "\n")


def _items_that_nobody_wrote(folder: Path) -> None:
    _edit(
        folder / "shapes.h5",
        "sequence mesh_vertices mesh_faces weight model",
        shapes=((10**9, 15, 3), "f8", (1000, 15, 3)),
        item=((10**9,), "S1", (10**5,)),
    )


def _own_sequences(folder: Path) -> None:
    head, *rows = (folder / "views.csv").read_text().splitlines()
    place = head.split(",").index("sequence")
    cells = [row.split(",") for row in rows]
    rows = [",".join((*row[:place], row[0], *row[place + 1 :])) for row in cells]
    (folder / "views.csv").write_text("\n".join((head, *rows)) + "\n")


def _forged_lines(folder: Path) -> None:
    points = _landmarks(folder)
    points[0] = np.nan
    items = [f"x\x1b[31mRED\rfit: 8 images in 0.0 s; wrote all {i}" for i in range(8)]
    _edit(folder / "views.h5", landmarks=points, item=items)


def _signalling_nan(folder: Path) -> None:
    points = _landmarks(folder).astype("f4")
    points.view("u4")[0, 0, 0] = 0x7F800001
    _edit(folder / "views.h5", landmarks=points)


def _beyond_single_precision(folder: Path) -> None:
    points = _landmarks(folder)
    points[0] *= 1e60
    _edit(folder / "views.h5", landmarks=points)


def _overflowing_span(folder: Path) -> None:
    points = np.zeros((8, 15, 2))
    points[:, 0], points[:, 1] = 1e308, -1e308
    _edit(folder / "result.h5", landmarks=points)


def _name_that_is_not_utf8(folder: Path) -> None:
    with h5py.File(folder / "shapes.h5", "r+") as file:
        file[b"\xff\xfe"] = np.zeros(8)


def _nothing(_: Path) -> None:
    """Leave the files as they are: the command is what is wrong."""


NOT_UTF8 = os.fsdecode(b"caf\xe9.csv")

Finding = tuple[Callable[[Path], object], Command]

FINDINGS: Mapping[str, Finding] = {
    "coordinate-whose-square-overflows": (
        _huge_coordinate, ("learn-dict", "shapes.csv", *LEARN)),
    "mesh-larger-than-memory": (
        lambda f: _edit(f / "shapes.h5", mesh_vertices=((8, 10**9, 3), "f8", (1, 1000, 3))),
        ("learn-dict", "shapes.h5", "-o", "out.h5", "--set=method=exemplars")),
    "items-that-nobody-wrote": (
        _items_that_nobody_wrote, ("project", "shapes.h5", "-o", "out.h5")),
    "further-dataset-without-end": (
        lambda f: _edit(f / "views.h5", further=((10**10,), "f8", (10**4,))), FIT),
    "path-that-is-not-utf8": (
        lambda f: shutil.copy(f / "views.csv", f / NOT_UTF8),
        ("fit", NOT_UTF8, "-d", "dict.h5", "-o", "out.h5", "--set=threads=1")),
    "half-a-letter-in-an-option": (
        _nothing, ("learn-dict", *LEARN, "--set", 'shapes="\\ud800"')),
    "format-that-is-no-text": (
        lambda f: _attribute(f / "views.h5", "format", h5py.Empty("f8")),
        ("view", "views.h5", "result.h5", "-o", "out.html")),
    "a-chunk-for-each-value": (
        lambda f: _edit(f / "dict.h5", objective_trace=((10**6,), "f8", (1,))), FIT),
    "mesh-beyond-single-precision": (
        _beyond_single_precision, (*FIT, "--set=export.folder=out_meshes")),
    "aliases-of-aliases": (
        lambda f: (f / "config.yaml").write_text(aliases_of_aliases(8)),
        ("eval", "-c", "config.yaml")),
    "depths-of-empty-shapes": (
        _own_sequences,
        ("fit", "views.csv", "-d", "dict.h5", "-o", "out.csv", "--set=temporal.depths=true",
         "--set=outliers=l1", "--set=lambda=5")),
    "zero-byte-in-an-item": (
        lambda f: _edit(
            f / "views.h5", item=np.array([f"a\0{i}".encode() for i in range(8)], "S4")),
        FIT),
    "dataset-whose-name-is-not-utf8": (
        _name_that_is_not_utf8,
        ("project", "shapes.h5", "-o", "out.h5")),
    "mean-shape-of-one-point": (
        lambda f: _edit(f / "bases.h5", mean_shape=np.full((15, 3), 0.5)), PMP),
    "mean-shape-whose-squares-overflow": (
        lambda f: _edit(f / "bases.h5", mean_shape=np.full((15, 3), 1e154)), PMP),
    "limbs-without-a-length": (
        lambda f: _edit(f / "bases.h5", edges=np.array([[0, 0], [1, 1]])), PMP),
    "iterations-beyond-64-bits": (
        _nothing, (*FIT, f"--set=solver.max_iterations={BEYOND_INT64}")),
    "views-beyond-64-bits": (
        _nothing, (*ALTERNATE, f"--set=alternation.views={BEYOND_INT64}")),
    "views-beyond-memory": (_nothing, (*ALTERNATE, "--set=alternation.views=3000000000")),
    "seconds-that-are-nan": (
        lambda f: _attribute(f / "result.h5", "solve_seconds", np.nan),
        ("eval", "result.h5", "--truth", "shapes.h5", "-o", "out", "--set=plots=false")),
    "item-that-forges-a-line": (_forged_lines, FIT),
    "signalling-nan": (_signalling_nan, FIT),
    "table-without-end": (_nothing, ("fit", "/dev/zero", "-d", "dict.h5", "-o", "out.h5")),
    "page-of-a-table-without-end": (_nothing, ("view", "/dev/full", "-o", "out.html")),
    "landmarks-whose-span-overflows": (
        _overflowing_span, ("view", "result.h5", "-o", "out.html")),
    "match-by-matrices": (
        _nothing,
        ("view", "result.h5", "--truth", "shapes.h5", "--set=match=true_rotation",
         "-o", "out.html")),
    "config-without-end": (_nothing, ("fit", "-c", "/dev/zero")),
}  # fmt: skip
"""Name -> what spoils the files of a folder, and the command line that reads them."""
