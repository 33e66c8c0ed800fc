"""A plugin of pytest that records which tests run which lines of the package, for `reach.py`.

It writes to `build/reach`: lines by context (coverage's own files), and for each context its
seconds and the contexts that it needs. A context is a test, or what several tests share: a fixture
of wider scope, a file of tests/world.py.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import coverage
import pytest
from reach import FOLDER, PROJECT

measured = coverage.Coverage(
    data_file=str(FOLDER / "lines"),
    data_suffix=True,
    source=[str(PROJECT / "shapefit")],
    config_file=False,
)
seconds: dict[str, float] = {}
needs: dict[str, set[str]] = {}
passed: set[str] = set()
open_contexts: list[str] = [""]


@contextmanager
def context(name: str) -> Iterator[None]:
    """Count lines and seconds inside as those of a context, which the one around it needs."""
    outer = open_contexts[-1]
    needs.setdefault(outer, set()).add(name)
    needs.setdefault(name, set())
    open_contexts.append(name)
    measured.switch_context(name)
    began = sum(os.times()[:4])
    try:
        yield
    finally:
        taken = sum(os.times()[:4]) - began
        seconds[name] = seconds.get(name, 0.0) + taken
        seconds[outer] = seconds.get(outer, 0.0) - taken
        open_contexts.pop()
        measured.switch_context(outer)


def fixture_context(definition: Any) -> str:
    """Return the context of a fixture that several tests share."""
    return f"{definition.baseid}|{definition.argname}"


measured.start()  # before conftest.py imports the package


def pytest_collection_finish() -> None:
    """Make each file of the world a context."""
    from tests.world import World

    make = World._make

    def make_in_context(self: Any, what: str, run: Any, command: str, arguments: Any) -> Path:
        with context(f"world|{what} {json.dumps(arguments, sort_keys=True)}"):
            return make(self, what, run, command, arguments)

    World._make = make_in_context  # type: ignore[method-assign]


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: Any) -> Iterator[None]:
    """Make each test a context, which needs the fixtures that it shares with others."""
    with context(item.nodeid):
        found = item._fixtureinfo.name2fixturedefs.values()
        needs[item.nodeid] |= {fixture_context(d[-1]) for d in found if d[-1].scope != "function"}
        return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_fixture_setup(fixturedef: Any) -> Iterator[None]:
    """Make each fixture that several tests share a context."""
    if fixturedef.scope == "function":
        return (yield)
    with context(fixture_context(fixturedef)):
        return (yield)


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Keep what passed: a test that fails or is skipped without a change tells nothing of it."""
    if report.when == "call" and report.passed:
        passed.add(report.nodeid)


def pytest_sessionfinish() -> None:
    """Write what was found."""
    measured.stop()
    measured.save()
    found = {
        "seconds": seconds,
        "needs": {name: sorted(some) for name, some in needs.items() if name},
        "passed": sorted(passed),
    }
    (FOLDER / f"tests-{os.getpid()}.json").write_text(json.dumps(found), encoding="utf-8")
