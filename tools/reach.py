"""Which of the quick tests run which lines of the package, recorded once."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

PROJECT = Path(__file__).resolve().parents[1]
FOLDER = PROJECT / "build/reach"

AT_MOST = 400
"""Tests of one change."""


class Reach(NamedTuple):
    """What the quick tests run: contexts by file and line, tests with their seconds and needs."""

    contexts: dict[str, dict[int, list[str]]]
    seconds: dict[str, float]
    needs: dict[str, set[str]]
    tests: list[str]


def record() -> None:
    """Run the quick tests once and keep which lines each of them runs."""
    FOLDER.mkdir(parents=True)
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-p",
        "reach_plugin",
        "-m",
        "not slow",
        "-n",
        "2",
    ]
    environment = {**os.environ, "PYTHONPATH": str(PROJECT / "tools")}
    subprocess.run(command, cwd=PROJECT, env=environment, check=False)


def reach_of_tests() -> Reach:
    """Return what `record` kept, of all its processes; record it where that was not done."""
    if not FOLDER.exists():
        record()
    import coverage

    data = coverage.CoverageData(str(FOLDER / "all"))
    for path in FOLDER.glob("lines.*"):
        part = coverage.CoverageData(str(path))
        part.read()
        data.update(part)
    contexts = {path: data.contexts_by_lineno(path) for path in data.measured_files()}
    found = [json.loads(path.read_text("utf-8")) for path in FOLDER.glob("tests-*.json")]
    seconds: dict[str, float] = {}
    needs: dict[str, set[str]] = {}
    for part in found:
        for name, value in part["seconds"].items():
            seconds[name] = max(value, seconds.get(name, 0.0))
        for name, some in part["needs"].items():
            needs.setdefault(name, set()).update(some)
    tests = sorted({test for part in found for test in part["passed"]})
    return Reach(contexts, seconds, {test: with_needs(test, needs) for test in tests}, tests)


def with_needs(name: str, needs: dict[str, set[str]]) -> set[str]:
    """Return a context and all that it needs, directly or through others."""
    found, waiting = {name}, [name]
    while waiting:
        new = needs.get(waiting.pop(), set()) - found
        found |= new
        waiting += new
    return found


def tests_of(path: Path, changed: range, reach: Reach, seconds: float) -> tuple[list[str], bool]:
    """Return tests that run lines of a file and take so long at most; whether they run at import.

    What runs at import counts for all tests that run a line of the file, and for those of its
    folder.
    """
    lines = reach.contexts.get(str(path), {})
    own = str(Path("tests") / path.parent.relative_to(PROJECT / "shapefit"))
    reached = {name for line in changed for name in lines.get(line, [])}
    at_import = changed[0] == 0 or "" in reached
    if at_import:
        reached = {name for some in lines.values() for name in some}
        reached |= {test for test in reach.tests if test.startswith(own)}
    reached -= {""}

    def order(test: str) -> tuple[bool, float]:
        return not test.startswith(own), sum(reach.seconds[name] for name in reach.needs[test])

    chosen: list[str] = []
    made: set[str] = set()
    for test in sorted((test for test in reach.tests if reach.needs[test] & reached), key=order):
        made |= reach.needs[test]
        if chosen and sum(reach.seconds[name] for name in made) > seconds:
            break
        chosen.append(test)
    return chosen[:AT_MOST], at_import
