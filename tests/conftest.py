"""Fixtures shared by all tests."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path

import numpy as np
import pytest

PROJECT = Path(__file__).resolve().parents[1]
REAL_DATA = Path(os.environ.get("SHAPEFIT_REAL_DATA", PROJECT.parent / "shared" / "data"))


@pytest.fixture(scope="session")
def project() -> Path:
    return PROJECT


@pytest.fixture(scope="session")
def readme_commands() -> list[str]:
    text = (PROJECT / "README.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```console\n(.*?)```", text, re.DOTALL)
    return [line[2:] for block in blocks for line in block.splitlines() if line.startswith("$ ")]


@pytest.fixture(scope="session")
def real_data() -> Path:
    if not REAL_DATA.is_dir():
        reason = f"real data not found at {REAL_DATA}; set SHAPEFIT_REAL_DATA to its folder"
        if os.environ.get("SHAPEFIT_REQUIRE_REAL_DATA") == "1":
            pytest.fail(reason)
        pytest.skip(reason)
    return REAL_DATA


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20150607)


@pytest.fixture
def without_pyarrow(monkeypatch) -> None:
    """Make pyarrow a library that is not installed."""
    for name in [name for name in sys.modules if name.startswith("shapefit.io.parquet.")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "pyarrow", None)
