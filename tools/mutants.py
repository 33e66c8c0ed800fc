"""Change the package in small ways, run the tests that reach each change, list what survives.

    python tools/mutants.py --count 300 --seed 1 [--only shapefit/geometry] [--seconds 60]

A mutant is one change of one expression: an operator, a constant, a sign, a term or factor left
out, an order, a condition turned round. Its tests are the quick ones that run its lines, as
`tools/reach.py` records once (anew where its folder, `build/reach`, is deleted): those of its
own folder first, the fastest first. A mutant survives when all of them pass, and where no test
reaches it. Functions are changed in the memory of a process that is forked from one that has read
all tests; what acts at import is changed in its file and put back, so the checkout must be clean.
"""

from __future__ import annotations

import argparse
import gc
import importlib
import inspect
import os
import random
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from types import CodeType, FunctionType
from typing import TextIO

import hypothesis
import pytest
from changes import Mutant, mutants
from reach import Reach, reach_of_tests, tests_of

PROJECT = Path(__file__).resolve().parents[1]

ROOMS = (
    *("lifting", "dictionary", "geometry", "convex", "evaluation", "verification", "io"),
    *("pipelines/fit", "pipelines/evaluate"),
)
"""Rooms whose files are changed, below `shapefit/`."""


def functions_by_file() -> dict[str, list[FunctionType]]:
    """Return the functions of the package that are in memory, by the file that defines them."""
    found: dict[str, list[FunctionType]] = {}
    for one in gc.get_objects():
        if isinstance(one, FunctionType) and (one.__module__ or "").startswith("shapefit"):
            found.setdefault(one.__code__.co_filename, []).append(one)
    return found


def codes(whole: CodeType) -> Iterator[CodeType]:
    """Yield the code of functions that are made when a module or a class body runs."""
    for one in whole.co_consts:
        if isinstance(one, CodeType):
            if one.co_flags & inspect.CO_NEWLOCALS and one.co_flags & inspect.CO_OPTIMIZED:
                yield one
            else:
                yield from codes(one)


def put_into_memory(mutant: Mutant, functions: list[FunctionType]) -> None:
    """Give the functions of the mutant's file the code that they have with the change."""
    now = compile(mutant.path.read_text("utf-8"), str(mutant.path), "exec", dont_inherit=True)
    then = compile(mutant.source, str(mutant.path), "exec", dont_inherit=True)
    other = dict(zip(codes(now), codes(then), strict=True))
    for function in functions:
        if function.__code__ in other:
            function.__code__ = other[function.__code__]


class Trial:
    """A plugin of pytest: after collection it tries every mutant, each in a copy of the process."""

    def __init__(self, mutants: list[Mutant], reach: Reach, seconds: float, out: TextIO) -> None:
        self.mutants, self.reach, self.seconds, self.out = mutants, reach, seconds, out
        self.red = ""
        self.sound: dict[str, bool] = {}

    def pytest_sessionstart(self) -> None:
        """Let Hypothesis take the same examples each time and shrink none."""
        phases = (hypothesis.Phase.explicit, hypothesis.Phase.generate)
        hypothesis.settings.register_profile(
            "mutants", database=None, deadline=None, derandomize=True, phases=phases
        )
        hypothesis.settings.load_profile("mutants")

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Remember a test that fails."""
        if report.failed:
            self.red = report.nodeid

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Try the mutants, and print what becomes of each."""
        session.config.pluginmanager.unregister(name="terminalreporter")
        for path in self.reach.contexts:
            inside = Path(path).relative_to(PROJECT).with_suffix("")
            with suppress(ImportError):  # of a library that is optional
                importlib.import_module(".".join(inside.parts).removesuffix(".__init__"))
        self.items = {item.nodeid: item for item in session.items}
        self.functions = functions_by_file()
        gc.freeze()
        began, alive = time.monotonic(), 0
        for mutant in self.mutants:
            found = self.verdict(mutant)
            alive += not found.startswith("killed")
            place = f"{mutant.path.relative_to(PROJECT)}:{mutant.lines[-1]}"
            print(found, place, mutant.before, mutant.after, sep="\t", file=self.out, flush=True)
        minutes = (time.monotonic() - began) / 60
        print(f"{alive} of {len(self.mutants)} survive ({minutes:.0f} min)", file=self.out)
        return True

    def verdict(self, mutant: Mutant) -> str:
        """Return "killed by" a test, "survives" or "not reached"."""
        tests, at_import = tests_of(mutant.path, mutant.lines, self.reach, self.seconds)
        tests = [test for test in tests if self.sound.get(test, True) and test in self.items]
        if not tests:
            return "not reached"
        if at_import:
            return on_disk(mutant, tests, self.seconds)
        red = self.red_of(tests, mutant)
        while red in self.items and not self.sound.setdefault(red, not self.red_of([red], None)):
            tests = tests[tests.index(red) + 1 :]  # it fails without the change, too
            red = self.red_of(tests, mutant)
        return f"killed by {red}" if red else "survives"

    def red_of(self, tests: list[str], mutant: Mutant | None) -> str:
        """Return the first of these tests that fails in a copy of this process; "" for none."""
        with tempfile.TemporaryDirectory() as folder:
            child = os.fork()
            if child == 0:
                answer = "what is not a test"
                try:
                    os.setpgid(0, 0)
                    resource.setrlimit(resource.RLIMIT_CPU, (int(4 * self.seconds + 60),) * 2)
                    answer = self.in_child(tests, mutant, Path(folder))
                finally:
                    Path(folder, "red").write_text(answer, encoding="utf-8")
                    os._exit(0)
            until = time.monotonic() + 10 * self.seconds + 120
            while not os.waitpid(child, os.WNOHANG)[0]:
                if time.monotonic() > until:
                    os.killpg(child, signal.SIGKILL)
                time.sleep(0.02)
            answered = Path(folder, "red")
            return answered.read_text("utf-8") if answered.exists() else "the time that it takes"

    def in_child(self, tests: list[str], mutant: Mutant | None, folder: Path) -> str:
        """Change the code and run tests until one fails; return its name."""
        items = [self.items[test] for test in tests]
        items[0].config._tmp_path_factory._basetemp = folder  # type: ignore[attr-defined]
        if mutant:
            put_into_memory(mutant, self.functions.get(str(mutant.path), []))
        self.red = ""
        for item, following in zip(items, [*items[1:], None], strict=True):
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
            if self.red:
                break
        return self.red


def on_disk(mutant: Mutant, tests: list[str], seconds: float) -> str:
    """Return the verdict on a change that acts at import: the file is changed, and put back."""
    original, status = mutant.path.read_bytes(), mutant.path.stat()
    command = [sys.executable, "-B", "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider"]
    try:
        mutant.path.write_text(mutant.source, encoding="utf-8")
        done = subprocess.run(
            [*command, *tests], cwd=PROJECT, capture_output=True, timeout=10 * seconds, check=False
        )
        return "killed at import" if done.returncode else "survives"
    except subprocess.TimeoutExpired:
        return "killed by the time that it takes"
    finally:
        mutant.path.write_bytes(original)
        os.utime(mutant.path, ns=(status.st_atime_ns, status.st_mtime_ns))


def files(only: str | None) -> list[Path]:
    """Return the files that are changed, those below `only` where it is given."""
    roots = [PROJECT / only] if only else [PROJECT / "shapefit" / room for room in ROOMS]
    found = {path for root in roots for path in ([root] if root.is_file() else root.rglob("*.py"))}
    return sorted(path for path in found if path.suffix == ".py" and path.exists())


def main() -> int:
    """Run the mutants and print what becomes of each; 2 where the checkout is not clean."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", help="a file or folder, from the top of the checkout")
    parser.add_argument("--seconds", type=float, default=60.0, help="of tests, per mutant")
    options = parser.parse_args()
    status = ["git", "status", "--porcelain", "shapefit"]
    if subprocess.run(status, cwd=PROJECT, capture_output=True, check=True).stdout:
        print("The checkout is not clean: commit first.", file=sys.stderr)
        return 2
    reached = reach_of_tests()
    sys.path.insert(0, str(PROJECT))
    os.chdir(PROJECT)
    every = [mutant for path in files(options.only) for mutant in mutants(path)]
    some = random.Random(options.seed).sample(every, min(options.count, len(every)))
    with os.fdopen(os.dup(1), "w", encoding="utf-8") as out:
        print(f"{len(some)} of {len(every)} mutants", file=out, flush=True)
        trial = Trial(some, reached, options.seconds, out)
        pytest.main(["-q", "-m", "not slow", "-p", "no:cacheprovider", "tests"], plugins=[trial])
    return 0


if __name__ == "__main__":
    sys.exit(main())
