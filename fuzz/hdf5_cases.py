"""HDF5 files with wrong datasets, types, shapes, values, attributes, links and bytes."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from random import Random
from typing import Any

import h5py
import numpy as np

from .csv_cases import loss
from .texts import NAMES

Change = Callable[[Random, Any], object]

NUMBERS = (
    *(0.0, -0.0, 1.0, -1.0, 0.5, 1e-320, 1e-160, 1e100, 1e149, 1e151, 1e154, 1e160, 1e308, -1e308),
    *(np.nan, np.inf, -np.inf, 2.0**63, 95.0),
)
TYPES = ("f2", "f4", "f8", "g", "i1", "u1", "i8", "u8", ">f8", ">i4", "?", "c16", "S3", "V4")


MOST_VALUES = 10**6
"""Of a dataset that is changed: one made sparse before it would take all memory."""


def _dataset(rng: Random, file: Any) -> Any:
    """Choose a dataset that can be read."""
    nodes = [file.get(name) for name in file]
    datasets = [node for node in nodes if isinstance(node, h5py.Dataset)]
    return rng.choice([one for one in datasets if (one.size or 0) <= MOST_VALUES])


def _read(dataset: Any) -> Any:
    """Return the values as an array, a single text too."""
    return np.asarray(dataset[()])


def _put(file: Any, name: str, values: Any, **keys: Any) -> None:
    """Put a dataset in the place of what has its name."""
    if name in file:
        del file[name]
    with suppress(TypeError, ValueError, OSError):
        file.create_dataset(name, data=values, **keys)


def _delete(rng: Random, file: Any) -> None:
    del file[_dataset(rng, file).name]


def _values(rng: Random, file: Any) -> None:
    dataset = _dataset(rng, file)
    values = _read(dataset)
    if values.size and values.dtype.kind in "fiu":
        flat = values.reshape(-1)
        with np.errstate(all="ignore"):
            for _ in range(rng.choice((1, 1, 3, flat.size))):
                flat[rng.randrange(flat.size)] = np.float64(rng.choice(NUMBERS)).astype(flat.dtype)
        _put(file, dataset.name, values)


def _fill(rng: Random, file: Any) -> None:
    dataset = _dataset(rng, file)
    if dataset.dtype.kind in "fiu":
        with np.errstate(all="ignore"):
            number = np.float64(rng.choice(NUMBERS)).astype(dataset.dtype)
        _put(file, dataset.name, np.full(dataset.shape, number))


def _scale(rng: Random, file: Any) -> None:
    dataset = _dataset(rng, file)
    if dataset.dtype.kind == "f":
        with np.errstate(all="ignore"):
            _put(file, dataset.name, _read(dataset) * 10.0 ** rng.uniform(-320, 300))


def _bits(rng: Random, file: Any) -> None:
    dataset = _dataset(rng, file)
    if dataset.dtype.kind in "fiu" and dataset.size:
        data = bytearray(_read(dataset).tobytes())
        for _ in range(rng.choice((1, 2, 8))):
            data[rng.randrange(len(data))] = rng.randrange(256)
        _put(file, dataset.name, np.frombuffer(bytes(data), dataset.dtype).reshape(dataset.shape))


def _texts(rng: Random, file: Any) -> None:
    dataset = _dataset(rng, file)
    if dataset.dtype.kind == "O" and dataset.ndim == 1:
        texts = [text.encode() for text in dataset.asstr()[()]]
        for _ in range(rng.choice((1, 2, len(texts)))):
            if texts:
                name = rng.choice((*NAMES, "\udcff", str(texts[0], "utf-8", "ignore")))
                texts[rng.randrange(len(texts))] = name.encode(
                    "utf-8", "surrogateescape" if name == "\udcff" else "surrogatepass"
                )
        fixed = np.array(texts, "S")
        _put(file, dataset.name, fixed)
        if rng.random() < 0.5:
            _put(
                file,
                dataset.name,
                [text.replace(b"\0", b"") for text in texts],
                dtype=h5py.string_dtype(),
            )


def _type(rng: Random, file: Any) -> None:
    dataset = _dataset(rng, file)
    with np.errstate(all="ignore"), suppress(TypeError, ValueError):
        _put(
            file,
            dataset.name,
            np.zeros(dataset.shape, rng.choice(TYPES))
            if rng.random() < 0.3
            else _read(dataset).astype(rng.choice(TYPES)),
        )


def _shape(rng: Random, file: Any) -> None:
    dataset = _dataset(rng, file)
    values = _read(dataset)
    changed = rng.choice(
        (
            lambda: values[..., :-1] if values.ndim else values,
            lambda: values[1:] if values.ndim else values,
            lambda: values[:0] if values.ndim else values,
            lambda: values[None],
            lambda: values.ravel(),
            lambda: values.T,
            lambda: np.concatenate([values, values]) if values.ndim else values,
            lambda: values.reshape(-1)[0] if values.size else values,
            lambda: h5py.Empty("f8"),
        )
    )()
    text = dataset.dtype.kind == "O"
    _put(file, dataset.name, changed, **({"dtype": h5py.string_dtype()} if text else {}))


def _sparse(rng: Random, file: Any) -> None:
    dataset = _dataset(rng, file)
    name, rank = dataset.name, dataset.ndim
    if not rank or dataset.dtype.kind == "O":
        return
    shape = (10 ** rng.randrange(5, 12), *dataset.shape[1:])
    del file[name]
    with suppress(ValueError, OSError):
        file.create_dataset(name, shape, "f8", chunks=(1,) * rank)


def _extra(rng: Random, file: Any) -> None:
    name = rng.choice(
        ("further", b"\xff\xfe", "deep/er", "outliers", "bounding_box", "camera_matrix", "a\nb")
    )
    values = rng.choice(
        (
            np.zeros(8),
            np.zeros((3, 3)),
            "text",
            [b"\xff"],
            np.zeros(0),
            h5py.Empty("f4"),
            np.zeros((8, 15), "?"),
        )
    )
    with suppress(ValueError, TypeError, RuntimeError, OSError):
        file[name] = values


def _link(rng: Random, file: Any) -> None:
    name = _dataset(rng, file).name
    del file[name]
    file[name] = rng.choice(
        (
            h5py.SoftLink("/nowhere"),
            h5py.SoftLink(name),
            h5py.SoftLink("/"),
            h5py.ExternalLink("shapes.h5", "/shapes"),
            h5py.ExternalLink("nowhere.h5", "/"),
        )
    )


def _group(rng: Random, file: Any) -> None:
    name = _dataset(rng, file).name
    del file[name]
    file.create_group(name)


def _attribute(rng: Random, file: Any) -> None:
    names = [
        *file.attrs,
        "y_axis",
        "unit",
        "frame_rate",
        "solve_seconds",
        "config",
        "kind",
        "method",
    ]
    name = rng.choice(names)
    values = (
        np.nan,
        np.inf,
        -1,
        2,
        "text",
        "",
        "\x1b[2J",
        b"\xff",
        [1, 2],
        np.zeros((2, 2)),
        10**18,
        h5py.Empty("f8"),
        True,
    )
    with suppress(TypeError, ValueError, OSError, RuntimeError):
        if name in file.attrs:
            del file.attrs[name]
        if rng.random() < 0.8:
            file.attrs[name] = rng.choice(values)


CHANGES: tuple[Change, ...] = (
    *(_delete, _values, _values, _fill, _scale, _bits, _texts, _texts, _type, _shape, _sparse),
    *(_extra, _link, _group, _attribute),
)


def spoil_bytes(rng: Random, path: Path) -> None:
    """Cut a file off, or change some of its bytes."""
    data = bytearray(path.read_bytes())
    match rng.randrange(4):
        case 0:
            data = data[: rng.randrange(len(data))]
        case 1:
            for _ in range(rng.choice((1, 4, 32))):
                data[rng.randrange(len(data))] = rng.randrange(256)
        case 2:
            start = rng.randrange(len(data))
            data[start : start + rng.randrange(500)] = bytes(rng.randrange(500))
        case _:
            data[:0] = rng.randbytes(512)
    path.write_bytes(data)


def spoiled_hdf5(rng: Random, path: Path) -> None:
    """Spoil an HDF5 file."""
    with h5py.File(path, "a") as file:
        for _ in range(rng.choice((1, 1, 2, 3))):
            with suppress(IndexError, KeyError, TypeError, ValueError, RuntimeError, OSError):
                rng.choice(CHANGES)(rng, file)
    if rng.random() < 0.15:
        spoil_bytes(rng, path)


FITS = (
    *(
        "temporal.depths=true",
        "export.folder=out_meshes",
        "rotations=orthogonal",
        "transforms=true",
    ),
    *("leave_out=model", "outliers.method=ransac", "camera={model: perspective, focal: 1000}"),
    *("lambda=auto", "noise=0.1", "rotations=per-atom", "strict=true", "solver.max_iterations=2"),
)


def _others(rng: Random, name: str) -> tuple[str, ...]:
    """Read landmarks or a dictionary by a command other than `fit`."""
    if name == "views.h5":
        verify = ("verify", "result.h5", "-d", "dict.h5", "--landmarks", name)
        return rng.choice((verify, ("view", name, "-o", "out.html")))
    verify = ("verify", "result.h5", "-d", name)
    return rng.choice((verify, ("view", "result.h5", "-d", name, "-o", "out.html")))


def make(rng: Random, folder: Path) -> tuple[str, ...]:
    """Spoil one of the HDF5 files, and read it."""
    names = (
        *("views.h5", "dict.h5", "exemplars.h5", "bases.h5", "shapes.h5"),
        *("result.h5", "result.h5", "refined.h5"),
    )
    name = rng.choice(names)
    spoiled_hdf5(rng, folder / name)
    out = rng.choice(("out.h5", "out.csv"))
    if name == "shapes.h5":
        return rng.choice(
            (
                ("learn-dict", name, "-o", "out.h5", "--set", "k=3", "--set", "iterations=2"),
                ("learn-dict", name, "-o", "out.h5", "--set", "method=exemplars"),
                ("learn-dict", name, "-o", "out.h5", "--set", "method=pca-bases"),
                ("project", name, "-o", out, "--set", "hidden=0.2"),
                ("eval", "result.h5", "--truth", name, "-o", "out", "--set", "plots=false"),
            )
        )
    if name in ("result.h5", "refined.h5"):
        return rng.choice(
            (
                ("eval", name, "--truth", "shapes.h5", "-o", "out", "--set", "plots=false"),
                ("verify", name, "-d", "dict.h5"),
                ("verify", name, "-d", "dict.h5", "--landmarks", "views.h5"),
                ("view", name, "-o", "out.html"),
                ("view", "views.h5", name, "--truth", "shapes.h5", "-o", "out.html"),
            )
        )
    if rng.random() < 0.1:
        return _others(rng, name)
    dictionary = "dict.h5" if name == "views.h5" else name
    further = ("--set", rng.choice(FITS)) if rng.random() < 0.4 else ()
    chosen = "method=pmp" if name == "bases.h5" else loss(rng)
    return (
        "fit",
        "views.h5",
        "-d",
        dictionary,
        "-o",
        out,
        "--set=threads=1",
        "--set",
        chosen,
        *further,
    )
