"""Change the package in small ways, run the tests that reach each change, list what survives.

    python tools/mutants.py --count 300 --seed 1 [--rooms shapefit/geometry cli] [--seconds 60]

A mutant is one change of one expression (tools/changes.py). Its tests are the quick ones that run
its lines, as coverage records once for a commit, those of its own folder first, the fastest first.
What runs at import or in a fixture counts for the tests of its folder. A mutant survives when all
of them pass, and where no test reaches it. All this happens in a checkout of HEAD of its own, so
several may run at once.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import sysconfig
import tempfile
import time
import venv
from collections import defaultdict
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import coverage
from changes import Mutant, mutants

PROJECT = Path(__file__).resolve().parents[1]
PYTEST = ("-P", "-m", "pytest", "-q", "-p", "no:cacheprovider", "-m", "not slow")
COVERAGE = "[run]\nsource = shapefit,cli\ndynamic_context = test_function\ndata_file = {}\n"
COMMAND = "#!{}\nimport sys\nfrom shapefit.cli.main import main\nsys.exit(main())\n"


class Reach(NamedTuple):
    """Tests (contexts of coverage) by file and line, and of each test its name and seconds."""

    lines: dict[str, dict[int, list[str]]]
    names: dict[str, str]
    seconds: dict[str, float]


@contextmanager
def checkout() -> Iterator[Path]:
    """Make a checkout of HEAD with an environment that borrows all other packages and the core."""
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        place = Path(folder).resolve() / "checkout"
        git("worktree", "add", "--quiet", "--detach", str(place), "HEAD")
        try:
            installed = Path(sysconfig.get_path("purelib"))
            for core in (installed / "shapefit/core").glob("*.so"):
                shutil.copy(core, place / "shapefit/core")
            for name in ("cli", "configs"):  # where an installation has them
                (place / "shapefit" / name).symlink_to(place / name)
            venv.create(place / ".venv", symlinks=True)
            (packages,) = place.glob(".venv/lib/python*/site-packages")
            # Packages of a folder in a .pth file come last, and its editable installs do not count.
            (packages / "paths.pth").write_text(f"{place}\n{installed}\n", encoding="utf-8")
            command = place / ".venv/bin/shapefit"
            command.write_text(COMMAND.format(place / ".venv/bin/python"), encoding="utf-8")
            command.chmod(0o755)
            yield place
        finally:
            git("worktree", "remove", "--force", str(place))


def git(*arguments: str) -> str:
    """Run git in the project and return what it prints."""
    done = subprocess.run(["git", *arguments], cwd=PROJECT, stdout=subprocess.PIPE, check=True)
    return done.stdout.decode().strip()


def run(place: Path, arguments: list[str], seconds: float | None = None) -> int | None:
    """Run Python in a checkout; return its exit code, None where it takes longer than that."""
    path = os.pathsep.join([str(place / ".venv/bin"), os.environ.get("PATH", "")])
    process = subprocess.Popen(
        [place / ".venv/bin/python", *arguments],
        cwd=place,
        env={**os.environ, "PATH": path, "PYTHONDONTWRITEBYTECODE": "1"},
        stdout=(place / ".venv/log").open("w"),
        stderr=subprocess.STDOUT,
        start_new_session=True,
    )
    try:
        return process.wait(seconds)
    except BaseException as error:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        if isinstance(error, subprocess.TimeoutExpired):
            return None
        raise


def record(place: Path, tests: list[str]) -> Reach:
    """Return what the quick tests run; kept in build/reach for other runs on the same commit."""
    retained = (
        PROJECT
        / "build/reach"
        / f"{git('rev-parse', 'HEAD')} {' '.join(tests)}.json".replace("/", "-")
    )
    if retained.exists():
        lines, *rest = json.loads(retained.read_text("utf-8"))
        turned = {path: {int(n): some for n, some in of.items()} for path, of in lines.items()}
        return Reach(turned, *rest)
    settings, data, report = (
        place / ".venv" / name for name in ("coveragerc", "data", "tests.xml")
    )
    settings.write_text(COVERAGE.format(data), encoding="utf-8")
    options = ["-n", "0", "-o", "junit_family=xunit1", f"--junitxml={report}", *tests]
    run(place, ["-P", "-m", "coverage", "run", f"--rcfile={settings}", *PYTEST[1:], *options])
    if not report.exists():
        sys.exit(f"The tests do not run:\n{(place / '.venv/log').read_text('utf-8')}")
    found = coverage.CoverageData(str(data))
    found.read()
    lines = {
        str(Path(path).relative_to(place)): found.contexts_by_lineno(path)
        for path in found.measured_files()
    }
    reach = Reach(lines, *passing(ElementTree.parse(report).iter("testcase")))
    retained.parent.mkdir(parents=True, exist_ok=True)
    partial = retained.with_suffix(f".{os.getpid()}")
    partial.write_text(json.dumps(reach), encoding="utf-8")
    partial.replace(retained)
    return reach


def passing(cases: Iterable[ElementTree.Element]) -> tuple[dict[str, str], dict[str, float]]:
    """Return context -> name for pytest, and -> seconds, of the test functions that pass."""
    names: dict[str, str] = {}
    seconds: dict[str, float] = defaultdict(float)
    failing = set()
    for case in cases:
        function = case.attrib["name"].partition("[")[0]
        file = case.attrib.get("file", "")
        classes = case.attrib["classname"].removeprefix(file.removesuffix(".py").replace("/", "."))
        context = f"{case.attrib['classname']}.{function}"
        names[context] = "::".join([file, *classes.split(".")[1:], function])
        seconds[context] += float(case.attrib["time"])
        if case.find("failure") is not None or case.find("error") is not None:
            failing.add(context)
    return {context: names[context] for context in names if context not in failing}, dict(seconds)


def tests_of(path: Path, changed: range, reach: Reach, seconds: float) -> list[str]:
    """Return tests that run changed lines of a file and take so long at most."""
    lines = reach.lines.get(str(path), {})
    own = "tests/" + str(path.parent).removeprefix("shapefit/")
    reached = {context for line in changed for context in lines.get(line, [])}
    if "" in reached:  # at import or in a fixture
        every = {context for some in lines.values() for context in some}
        reached |= {context for context in reach.names if context in every}
        reached |= {context for context, name in reach.names.items() if name.startswith(own)}

    def order(context: str) -> tuple[bool, float]:
        return not reach.names[context].startswith(own), reach.seconds[context]

    chosen: list[str] = []
    total = 0.0
    for context in sorted(reached & reach.names.keys(), key=order):
        total += reach.seconds[context]
        if chosen and total > seconds:
            break
        chosen.append(reach.names[context])
    return chosen


def verdict(place: Path, mutant: Mutant, tests: list[str], seconds: float) -> str:
    """Return "killed", "survives" or "not reached"; the file is changed, and put back."""
    if not tests:
        return "not reached"
    original = mutant.path.read_bytes()
    try:
        mutant.path.write_bytes(mutant.source)
        code = run(place, [*PYTEST, "-x", "-n", "0", *tests], 60 + 5 * seconds)
    finally:
        mutant.path.write_bytes(original)
    return (
        "survives"
        if code == 0
        else "killed by the time that it takes"
        if code is None
        else "killed"
    )


def main() -> None:
    """Try mutants and print what becomes of each."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--rooms", nargs="+", default=["shapefit", "cli"], help="files or folders")
    parser.add_argument("--seconds", type=float, default=60.0, help="of tests, per mutant")
    parser.add_argument("--tests", nargs="+", default=["tests"], help="tests that are run")
    options = parser.parse_args()
    began, alive = time.monotonic(), 0
    with checkout() as place:
        reach = record(place, options.tests)
        roots = [place / room for room in options.rooms]
        files = {f for root in roots for f in ([root] if root.is_file() else root.rglob("*.py"))}
        every = [mutant for path in sorted(files) for mutant in mutants(path)]
        some = random.Random(options.seed).sample(every, min(options.count, len(every)))
        print(f"{len(some)} of {len(every)} mutants", flush=True)
        for mutant in some:
            path = mutant.path.relative_to(place)
            tests = tests_of(path, mutant.lines, reach, options.seconds)
            found = verdict(place, mutant, tests, options.seconds)
            alive += not found.startswith("killed")
            where = f"{path}:{mutant.lines[-1]}"
            print(found, where, mutant.before, mutant.after, sep="\t", flush=True)
    minutes = (time.monotonic() - began) / 60
    print(f"{alive} of {len(some)} survive ({minutes:.0f} min)")


if __name__ == "__main__":
    main()
