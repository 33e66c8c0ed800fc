"""Fixtures shared by all tests."""

import fcntl
import os
import re
from collections.abc import Callable
from itertools import count
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings

from shapefit.config import load_config
from shapefit.pipelines.learn_dict import run as learn_dict
from tests.world import World

_numbers = count()

settings.register_profile("any machine", deadline=None)  # a busy one is no fault
settings.load_profile("any machine")

PROJECT = Path(__file__).resolve().parents[1]
REAL_DATA = Path(
    os.environ.get("SHAPEFIT_REAL_DATA", PROJECT.parent / "shared" / "data")
)


MORE_THAN_THE_QUICK_SET_UP = {"browser"}
"""Fixtures whose libraries `make test` does not install."""

LONG = ("test_the_paper_s_table_on_motion_capture", "test_outputs_of_all_commands")
"""Tests that begin first, so that no process of a run is left alone with one at the
end.
"""


@pytest.hookimpl(tryfirst=True)  # before pytest looks at -m
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if MORE_THAN_THE_QUICK_SET_UP & set(getattr(item, "fixturenames", ())):
            item.add_marker(pytest.mark.slow)
    items.sort(key=lambda item: not item.name.startswith(LONG))


@pytest.fixture(scope="session")
def project() -> Path:
    return PROJECT


@pytest.fixture(scope="session")
def readme_commands() -> list[str]:
    text = (PROJECT / "README.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```console\n(.*?)```", text, re.DOTALL)
    return [
        line[2:]
        for block in blocks
        for line in block.splitlines()
        if line.startswith("$ ")
    ]


@pytest.fixture(scope="session")
def real_data() -> Path:
    if not REAL_DATA.is_dir():
        reason = (
            f"real data not found at {REAL_DATA}; set SHAPEFIT_REAL_DATA to its folder"
        )
        if os.environ.get("SHAPEFIT_REQUIRE_REAL_DATA") == "1":
            pytest.fail(reason)
        pytest.skip(reason)
    return REAL_DATA


@pytest.fixture(scope="session")
def make_once(tmp_path_factory) -> Callable[[str, Callable[[Path], object]], Path]:
    """Return what makes a file once for all processes of a run; the others wait for
    it.
    """
    own = tmp_path_factory.getbasetemp()
    shared = own.parent if "PYTEST_XDIST_WORKER" in os.environ else own

    def once(name: str, make: Callable[[Path], object]) -> Path:
        path = shared / name
        part = shared / f"part-{name}"
        with (shared / f"{name}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not path.exists():
                make(part)
                part.rename(path)
        return path

    return once


@pytest.fixture(scope="session")
def world(make_once) -> World:
    """People, cars and a dog, with dictionaries and fits that are made once."""
    return World(make_once)


@pytest.fixture(scope="session")
def people_of_86(real_data, make_once) -> Path:
    """The dictionary of `configs/people/learn-dict.yaml`: subject 86, with a prior."""

    def learn(path: Path) -> None:
        shapes = [str(real_data / "mocap" / "subject86_24fps.h5")]
        arguments = {"shapes": shapes, "output": str(path)}
        config = PROJECT / "configs/people/learn-dict.yaml"
        list(
            learn_dict.learn_dictionary(
                load_config("learn-dict", config, arguments=arguments)
            )
        )

    return make_once("people_of_86.h5", learn)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20150607)
