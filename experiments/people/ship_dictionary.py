"""Make a dictionary small enough for the package: single precision, compressed, without
folders.

Usage: python -m experiments.people.ship_dictionary LEARNED.h5 shapefit/data/NAME.h5

The shares of the prior stay as they are, since they must add up to 1. What the
objective was in each round of learning is left out. Of every path in the attributes
only the name is kept.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from shapefit.io import read_dictionary

ORIGIN = {
    "source": (
        "CMU Motion Capture Database, mocap.cs.cmu.edu: subjects 01, 02, 03, 10, 64,"
        " 86, 118 and 124"
    ),
    "licence": (
        "Free for all uses; may be part of products, but may not be resold directly,"
        " even in converted form."
    ),
    "acknowledgement": (
        "The data used in this project was obtained from mocap.cs.cmu.edu. The "
        "database was created with funding from NSF EIA-0196217."
    ),
    "suits": "people sequences",
}
"""What the attributes of `people` say of its shapes, and the configs that suit it."""
LEFT_OUT = ("objective_trace",)
EXACT = ("prior_weights",)


def main() -> None:
    """Read a learned dictionary, write it smaller, and check that it can be read."""
    source, target = map(Path, sys.argv[1:])
    with h5py.File(source) as learned, h5py.File(target, "w") as shipped:
        for name, dataset in learned.items():
            if name not in LEFT_OUT:
                write_dataset(shipped, name, dataset[()])
        attributes = dict(learned.attrs) | ORIGIN
        attributes["config"] = json.dumps(
            without_folders(json.loads(attributes["config"]))
        )
        digests = json.loads(attributes["inputs"])
        attributes["inputs"] = json.dumps(
            {Path(key).name: text for key, text in digests.items()}
        )
        # Written once: what an attribute held before would stay in the bytes of the
        # file.
        for name, value in attributes.items():
            shipped.attrs[name] = value
    read_dictionary(target)
    print(f"{target}: {target.stat().st_size:,} bytes")


def write_dataset(file: Any, name: str, values: Any) -> None:
    """Write the values of a dataset to an HDF5 file, floats compressed and, unless they
    must stay exact, in single precision.
    """
    numbers = isinstance(values, np.ndarray) and values.dtype.kind == "f"
    if numbers and name not in EXACT:
        values = values.astype(np.float32)
    small = (
        {"compression": "gzip", "compression_opts": 9, "shuffle": True}
        if numbers
        else {}
    )
    file.create_dataset(name, data=values, **small)


def without_folders(value: Any) -> Any:
    """Return a value of JSON with the file name alone of each absolute path in it."""
    if isinstance(value, dict):
        return {key: without_folders(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [without_folders(inner) for inner in value]
    return (
        Path(value).name if isinstance(value, str) and value.startswith("/") else value
    )


if __name__ == "__main__":
    main()
