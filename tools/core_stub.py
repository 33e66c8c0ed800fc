"""Write the signatures of the compiled core, as nanobind.stubgen reads them from the module.

Usage: python tools/core_stub.py > shapefit/core/_core.pyi
"""

from __future__ import annotations

from typing import Any

from nanobind.stubgen import StubGen

from shapefit import core

HEAD = """\
# ruff: noqa: E501
# fmt: off
\"\"\"Signatures of the extension module, written by tools/core_stub.py.\"\"\"

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
Indices = NDArray[np.int64]
States = NDArray[np.uint64]

STRETCH: int
"""


def stub() -> str:
    """Return the text of the stub."""
    return "\n".join([HEAD, *functions(core._core), ""])


def functions(module: Any) -> list[str]:
    """Return one line for each function of a module, in the order of their names."""
    generator = StubGen(module, recursive=False)
    generator.put(module)
    return [line for line in generator.get().splitlines() if line.startswith("def ")]


if __name__ == "__main__":
    print(stub(), end="")
