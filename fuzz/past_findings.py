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

Finding = Callable[[Path], Command]

BEYOND_INT64 = 10**20


def _change(path: Path, **datasets: Any) -> None:
    """Put datasets in the place of what has their names."""
    with h5py.File(path, "r+") as file:
        for name, values in datasets.items():
            if name in file:
                del file[name]
            file[name] = values


def _sparse(path: Path, name: str, items: int) -> None:
    """Make a dataset of so many items that nobody wrote."""
    with h5py.File(path, "r+") as file:
        shape = (items, *file[name].shape[1:])
        del file[name]
        file.create_dataset(name, shape, "f8", chunks=(1000, *shape[1:]))


def _coordinate_whose_square_overflows(folder: Path) -> Command:
    path = folder / "shapes.csv"
    lines = path.read_text().splitlines()
    cells = lines[4].split(",")
    cells[3] = "1e160"
    lines[4] = ",".join(cells)
    path.write_text("\n".join(lines) + "\n")
    return ("learn-dict", "shapes.csv", *LEARN)


def _mesh_larger_than_memory(folder: Path) -> Command:
    with h5py.File(folder / "shapes.h5", "r+") as file:
        del file["mesh_vertices"]
        file.create_dataset("mesh_vertices", (8, 10**9, 3), "f8", chunks=(1, 1000, 3))
    return ("learn-dict", "shapes.h5", "-o", "out.h5", "--set=method=exemplars")


def _items_that_nobody_wrote(folder: Path) -> Command:
    _sparse(folder / "shapes.h5", "shapes", 10**9)
    with h5py.File(folder / "shapes.h5", "r+") as file:
        for name in ("item", "sequence", "mesh_vertices", "mesh_faces", "weight", "model"):
            del file[name]
        file.create_dataset("item", (10**9,), "S1", chunks=(10**5,), fillvalue=b"a")
    return ("project", "shapes.h5", "-o", "out.h5")


def _further_dataset_without_end(folder: Path) -> Command:
    with h5py.File(folder / "views.h5", "r+") as file:
        file.create_dataset("further", (10**10,), "f8", chunks=(10**4,))
    return FIT


def _path_that_is_not_utf8(folder: Path) -> Command:
    name = os.fsdecode(b"caf\xe9.csv")
    shutil.copy(folder / "views.csv", folder / name)
    return ("fit", name, "-d", "dict.h5", "-o", "out.h5", "--set=threads=1")


def _format_that_is_no_text(folder: Path) -> Command:
    with h5py.File(folder / "views.h5", "r+") as file:
        file.attrs["format"] = h5py.Empty("f8")
    return ("view", "views.h5", "result.h5", "-o", "out.html")


def _a_chunk_for_each_value(folder: Path) -> Command:
    with h5py.File(folder / "dict.h5", "r+") as file:
        del file["objective_trace"]
        file.create_dataset("objective_trace", (10**6,), "f8", chunks=(1,))
    return FIT


def _mesh_beyond_single_precision(folder: Path) -> Command:
    with h5py.File(folder / "views.h5", "r+") as file:
        file["landmarks"][0] = file["landmarks"][0] * 1e60
    return (*FIT, "--set=export.folder=out_meshes")


def _half_a_letter_in_an_option(_folder: Path) -> Command:
    return ("learn-dict", *LEARN, "--set", 'shapes="\\ud800"')


def _aliases_of_aliases(folder: Path) -> Command:
    (folder / "config.yaml").write_text(aliases_of_aliases(8))
    return ("eval", "-c", "config.yaml")


def _depths_of_empty_shapes(folder: Path) -> Command:
    path = folder / "views.csv"
    head, *rows = path.read_text().splitlines()
    place = head.split(",").index("sequence")
    cells = [row.split(",") for row in rows]
    rows = [",".join((*row[:place], row[0], *row[place + 1 :])) for row in cells]
    path.write_text("\n".join((head, *rows)) + "\n")
    settings = ("--set=temporal.depths=true", "--set=outliers.method=l1", "--set=lambda=5")
    return ("fit", "views.csv", "-d", "dict.h5", "-o", "out.csv", *settings)


def _zero_byte_in_an_item(folder: Path) -> Command:
    _change(folder / "views.h5", item=np.array([f"a\0{i}".encode() for i in range(8)], "S4"))
    return FIT


def _dataset_whose_name_is_not_utf8(folder: Path) -> Command:
    with h5py.File(folder / "shapes.h5", "r+") as file:
        file[b"\xff\xfe"] = np.zeros(8)
    return ("project", "shapes.h5", "-o", "out.h5")


def _mean_shape_of_one_point(folder: Path) -> Command:
    _change(folder / "bases.h5", mean_shape=np.full((15, 3), 0.5))
    return ("fit", "views.h5", "-d", "bases.h5", "-o", "out.h5", "--set=method=pmp")


def _mean_shape_whose_squares_overflow(folder: Path) -> Command:
    _change(folder / "bases.h5", mean_shape=np.full((15, 3), 1e154))
    return ("fit", "views.h5", "-d", "bases.h5", "-o", "out.h5", "--set=method=pmp")


def _limbs_without_a_length(folder: Path) -> Command:
    _change(folder / "bases.h5", edges=np.array([[0, 0], [1, 1]]))
    return ("fit", "views.h5", "-d", "bases.h5", "-o", "out.h5", "--set=method=pmp")


def _iterations_beyond_64_bits(_folder: Path) -> Command:
    return (*FIT, f"--set=solver.max_iterations={BEYOND_INT64}")


def _views_beyond_64_bits(_folder: Path) -> Command:
    return (*FIT, "--set=method=alternate", f"--set=alternation.views={BEYOND_INT64}")


def _views_beyond_memory(_folder: Path) -> Command:
    return (*FIT, "--set=method=alternate", "--set=alternation.views=3000000000")


def _seconds_that_are_nan(folder: Path) -> Command:
    with h5py.File(folder / "result.h5", "r+") as file:
        file.attrs["solve_seconds"] = np.nan
    return ("eval", "result.h5", "--truth", "shapes.h5", "-o", "out", "--set=plots=false")


def _item_that_forges_a_line(folder: Path) -> Command:
    with h5py.File(folder / "views.h5", "r+") as file:
        points = file["landmarks"][()]
    points[0] = np.nan
    items = [f"x\x1b[31mRED\rfit: 8 images in 0.0 s; wrote all {i}" for i in range(8)]
    _change(folder / "views.h5", landmarks=points, item=items)
    return FIT


def _signalling_nan(folder: Path) -> Command:
    with h5py.File(folder / "views.h5", "r+") as file:
        points = file["landmarks"][()].astype("f4")
    points.view("u4")[0, 0, 0] = 0x7F800001
    _change(folder / "views.h5", landmarks=points)
    return FIT


def _table_without_end(_folder: Path) -> Command:
    return ("fit", "/dev/zero", "-d", "dict.h5", "-o", "out.h5")


def _page_of_a_table_without_end(_folder: Path) -> Command:
    return ("view", "/dev/full", "-o", "out.html")


def _landmarks_whose_span_overflows(folder: Path) -> Command:
    points = np.zeros((8, 15, 2))
    points[:, 0], points[:, 1] = 1e308, -1e308
    _change(folder / "result.h5", landmarks=points)
    return ("view", "result.h5", "-o", "out.html")


def _match_by_matrices(_folder: Path) -> Command:
    truth = ("--truth", "shapes.h5", "--set=match=true_rotation")
    return ("view", "result.h5", *truth, "-o", "out.html")


def _config_without_end(_folder: Path) -> Command:
    return ("fit", "-c", "/dev/zero")


FINDINGS: Mapping[str, Finding] = {
    finding.__name__.strip("_").replace("_", "-"): finding
    for finding in (
        _coordinate_whose_square_overflows,
        _mesh_larger_than_memory,
        _items_that_nobody_wrote,
        _further_dataset_without_end,
        _path_that_is_not_utf8,
        _half_a_letter_in_an_option,
        _format_that_is_no_text,
        _a_chunk_for_each_value,
        _mesh_beyond_single_precision,
        _aliases_of_aliases,
        _depths_of_empty_shapes,
        _zero_byte_in_an_item,
        _dataset_whose_name_is_not_utf8,
        _mean_shape_of_one_point,
        _mean_shape_whose_squares_overflow,
        _limbs_without_a_length,
        _iterations_beyond_64_bits,
        _views_beyond_64_bits,
        _views_beyond_memory,
        _seconds_that_are_nan,
        _item_that_forges_a_line,
        _signalling_nan,
        _table_without_end,
        _page_of_a_table_without_end,
        _landmarks_whose_span_overflows,
        _match_by_matrices,
        _config_without_end,
    )
}
"""Name -> what spoils the files of a folder and returns the command line that reads them."""
