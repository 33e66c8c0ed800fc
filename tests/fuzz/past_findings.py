"""Inputs that once ended in an internal error, a crash, a hang or nonsense, one by one.

Each is made from the good files of a folder, as the cases of the other kinds are, and judged as
they are.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from .kinds import FIT, Command, aliases_of_aliases

PMP = ("fit", "views.h5", "-d", "bases.h5", "-o", "out.h5", "--set=method=pmp")
VIEW = ("view", "result.h5", "--truth", "shapes.h5", "-o", "out.html")
PROJECT = ("project", "shapes.h5", "-o", "out.h5")
FORGED = "x\x1b[31mRED\rfit: 8 images in 0.0 s; wrote all {}"

Finding = tuple[str, Mapping[Any, Any], Command]

FINDINGS: Mapping[str, Finding] = {
    "coordinate-whose-square-overflows": ("shapes.csv", {4: "a,head,1,1e160,1"}, ("learn-dict",
        "shapes.csv", "-o", "out.h5")),
    "mesh-larger-than-memory": ("shapes.h5", {"mesh_vertices": ((8, 10**9, 3), (1, 1000, 3))},
        ("learn-dict", "shapes.h5", "-o", "out.h5", "--set=method=exemplars")),
    "items-that-nobody-wrote": ("shapes.h5",
        {**dict.fromkeys(("sequence", "mesh_vertices", "mesh_faces", "weight", "model")),
         "shapes": ((10**9, 15, 3), (1000, 15, 3)), "item": ((10**9,), (10**5,))}, PROJECT),
    "further-dataset-without-end": ("views.h5", {"further": ((10**10,), (10**4,))}, FIT),
    "a-chunk-for-each-value": ("dict.h5", {"objective_trace": ((10**6,), (1,))}, FIT),
    "mesh-beyond-single-precision": ("views.h5", {"landmarks": np.full((8, 15, 2), 1e60)},
        (*FIT, "--set=export.folder=out_meshes")),
    "signalling-nan": ("views.h5",
        {"landmarks": np.full((8, 15, 2), 0x7F800001, np.uint32).view(np.float32)}, FIT),
    "landmarks-whose-span-overflows": ("result.h5",
        {"landmarks": np.resize([1e308, -1e308], (8, 15, 2))}, VIEW),
    "zero-byte-in-an-item": ("views.h5",
        {"item": np.array([f"a\0{i}".encode() for i in range(8)], "S4")}, FIT),
    "item-that-forges-a-line": ("views.h5", {"landmarks": np.full((8, 15, 2), np.nan),
        "item": [FORGED.format(i) for i in range(8)]}, FIT),
    "dataset-whose-name-is-not-utf8": ("shapes.h5", {b"\xff\xfe": np.zeros(8)}, PROJECT),
    "format-that-is-no-text": ("views.h5", {"@format": h5py.Empty("f8")},
        ("view", "views.h5", "result.h5", "-o", "out.html")),
    "seconds-that-are-nan": ("result.h5", {"@solve_seconds": np.nan},
        ("eval", "result.h5", "--truth", "shapes.h5", "-o", "out", "--set=plots=false")),
    "mean-shape-of-one-point": ("bases.h5", {"mean_shape": np.full((15, 3), 0.5)}, PMP),
    "mean-shape-whose-squares-overflow": ("bases.h5", {"mean_shape": np.full((15, 3), 1e154)}, PMP),
    "limbs-without-a-length": ("bases.h5", {"edges": np.array([[0, 0], [1, 1]])}, PMP),
    "match-by-matrices": ("", {}, (*VIEW, "--set=match=true_rotation")),
    "aliases-of-aliases": ("config.yaml", {0: aliases_of_aliases(8)}, ("eval", "-c",
        "config.yaml")),
    "table-without-end": ("", {}, ("fit", "/dev/zero", "-d", "dict.h5", "-o", "out.h5")),
    "config-without-end": ("", {}, ("fit", "-c", "/dev/zero")),
}  # fmt: skip
"""Name -> the file that is changed, its changes, and the command line that reads it."""


def edit(path: Path, changes: Mapping[Any, Any]) -> None:
    """Change lines of a text by their numbers, or datasets and `@attributes` of an HDF5 file.

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
