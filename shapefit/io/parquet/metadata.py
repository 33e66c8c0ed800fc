"""The metadata of a Parquet file: layout, unit, names, and all that is not per item."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from shapefit.io.layout import PLAIN_ATTRIBUTES, VERSION, Layout, stored_name
from shapefit.io.stored.writer import Array

NAMES = "landmark_names"

ATTRIBUTES, DATASETS = "attributes", "datasets"
"""As JSON: what a fit says of itself; the datasets that are not per item, but for the names."""

NUMBERS = ("version", "frame_rate")

OF_PANDAS = "PANDAS_ATTRS"
"""Where pandas puts `DataFrame.attrs`, as JSON."""


def file_metadata(form: Layout, record: Any, whole: Mapping[str, Array]) -> dict[str, str]:
    """Return the metadata of a file; `record` has what is not per item, `whole` what is beside."""
    datasets = {
        dataset.name: np.asarray(value)
        for dataset in form.datasets
        if not dataset.grows and (value := getattr(record, dataset.attribute)) is not None
    }
    names = datasets.pop(NAMES)
    said = {
        "format": form.name,
        "version": str(VERSION),
        "unit": record.unit,
        NAMES: json.dumps(names.tolist(), ensure_ascii=False),
    }
    if getattr(record, "y_axis", None) is not None:
        said["y_axis"] = record.y_axis
    if record.frame_rate is not None:
        said["frame_rate"] = repr(float(record.frame_rate))
    stored = {name: _to_json(values) for name, values in {**datasets, **whole}.items()}
    if stored:
        said[DATASETS] = json.dumps(stored, ensure_ascii=False)
    return said


def attribute_metadata(attributes: Mapping[str, str | float | int]) -> dict[str, str]:
    """Return the metadata that says what a fit says of itself."""
    plain = {name: _plain(value) for name, value in attributes.items()}
    return {ATTRIBUTES: json.dumps(plain, ensure_ascii=False)} if plain else {}


def read_metadata(stored: Mapping[bytes, bytes] | None) -> dict[str, str]:
    """Return the metadata of a file, as texts; what pandas keeps of a table is in it, too.

    Raises ValueError for what is not UTF-8.
    """
    plain = {key.decode(): value.decode() for key, value in (stored or {}).items()}
    table = _mapping(plain.get(OF_PANDAS, "{}"))
    texts = {
        key: value if isinstance(value, str) else json.dumps(value) for key, value in table.items()
    }
    return texts | plain


def root_attributes(stored: Mapping[str, str]) -> dict[str, Any]:
    """Return unit, y_axis and the like, and the attributes of a fit, as HDF5 has them.

    Numbers that are none stay texts. Raises ValueError for attributes that are no JSON.
    """
    root: dict[str, Any] = {name: stored[name] for name in PLAIN_ATTRIBUTES if name in stored}
    for name in NUMBERS:
        if name in root:
            try:
                root[name] = json.loads(root[name])
            except ValueError:
                continue
    attributes = _mapping(stored.get(ATTRIBUTES, "{}"))
    return root | {stored_name(name): value for name, value in attributes.items()}


def whole_datasets(stored: Mapping[str, str]) -> dict[str, Array]:
    """Return the datasets that are not per item.

    Raises ValueError, TypeError or KeyError for what is none.
    """
    return {
        name: _from_json(values) for name, values in _mapping(stored.get(DATASETS, "{}")).items()
    }


def _mapping(text: str) -> dict[str, Any]:
    found = json.loads(text)
    if not isinstance(found, dict):
        raise ValueError(f"found {text[:40]!r} in place of a JSON object")
    return found


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value


def _to_json(values: Array) -> dict[str, Any]:
    kind = "text" if values.dtype.kind in "OU" else values.dtype.newbyteorder("=").name
    flat = np.stack([values.real, values.imag], axis=-1) if values.dtype.kind == "c" else values
    return {"type": kind, "shape": list(values.shape), "values": flat.ravel().tolist()}


def _from_json(stored: Mapping[str, Any]) -> Array:
    shape, values = tuple(stored["shape"]), stored["values"]
    if stored["type"] == "text":
        texts = np.empty(len(values), object)
        texts[:] = [str(text) for text in values]
        return texts.reshape(shape)
    kind = np.dtype(stored["type"])
    if kind.kind not in "biufc":
        raise ValueError(f"{kind} is no type of numbers")
    if kind.kind == "c":
        pairs = np.array(values, kind.type(0).real.dtype)
        return pairs.view(kind).reshape(shape)
    return np.array(values, kind).reshape(shape)
