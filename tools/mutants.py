"""Change the package in small ways, run the tests that reach each change, list what
survives.

    python tools/mutants.py --count 300 --seed 1 [--rooms shapefit/geometry cli]
    [--seconds 60]

A mutant is one change of one expression: an operator, a constant, an order, a
condition, a guard. Its tests are the quick ones that run its lines, as coverage
records, those of its own folder first, the fastest first. What runs at import or in a
fixture counts for the tests of its folder. A mutant survives when all of them pass, and
where no test reaches it. All this happens in a checkout of HEAD of its own, so several
may run at once.
"""

from __future__ import annotations

import argparse
import ast
import copy
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
from typing import Any, NamedTuple
from xml.etree import ElementTree

import coverage

PROJECT = Path(__file__).resolve().parents[1]
PYTEST = ("-P", "-m", "pytest", "-q", "-p", "no:cacheprovider", "-m", "not slow")
COVERAGE = (
    "[run]\nsource = shapefit,cli\ndynamic_context = test_function\ndata_file = {}\n"
)
COMMAND = "#!{}\nimport sys\nfrom shapefit.cli.main import main\nsys.exit(main())\n"


class Reach(NamedTuple):
    """Which tests reach each line: file -> line -> tests, as contexts of coverage; and
    test -> its name for pytest and seconds.
    """

    lines: dict[str, dict[int, list[str]]]
    names: dict[str, str]
    seconds: dict[str, float]


@contextmanager
def checkout() -> Iterator[Path]:
    """Yield a temporary checkout of HEAD, with an environment that borrows all other
    packages and the compiled core.
    """
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
            # Packages of a folder in a .pth file come last, and its editable installs
            # do not count.
            (packages / "paths.pth").write_text(
                f"{place}\n{installed}\n", encoding="utf-8"
            )
            command = place / ".venv/bin/shapefit"
            command.write_text(
                COMMAND.format(place / ".venv/bin/python"), encoding="utf-8"
            )
            command.chmod(0o755)
            yield place
        finally:
            git("worktree", "remove", "--force", str(place))


def git(*arguments: str) -> str:
    """Run git in the project and return what it prints."""
    done = subprocess.run(
        ["git", *arguments], cwd=PROJECT, stdout=subprocess.PIPE, check=True
    )
    return done.stdout.decode().strip()


def run(place: Path, arguments: list[str], seconds: float | None = None) -> int | None:
    """Run Python with arguments in a checkout; return its exit code, or None where it
    is killed after so many seconds.
    """
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


def record_reach(place: Path, tests: list[str]) -> Reach:
    """Run the quick ones of some tests in a checkout under coverage; return which lines
    each reaches.
    """
    settings, data, report = (
        place / ".venv" / name for name in ("coveragerc", "data", "tests.xml")
    )
    settings.write_text(COVERAGE.format(data), encoding="utf-8")
    options = ["-n", "0", "-o", "junit_family=xunit1", f"--junitxml={report}", *tests]
    run(
        place,
        ["-P", "-m", "coverage", "run", f"--rcfile={settings}", *PYTEST[1:], *options],
    )
    if not report.exists():
        sys.exit(f"The tests do not run:\n{(place / '.venv/log').read_text('utf-8')}")
    found = coverage.CoverageData(str(data))
    found.read()
    lines = {
        str(Path(path).relative_to(place)): found.contexts_by_lineno(path)
        for path in found.measured_files()
    }
    return Reach(lines, *passed_tests(ElementTree.parse(report).iter("testcase")))


def passed_tests(
    cases: Iterable[ElementTree.Element],
) -> tuple[dict[str, str], dict[str, float]]:
    """Read a JUnit report: the test functions that pass, and the seconds of all.

    Returns context -> name as pytest takes it, of functions that pass, and context ->
    seconds, of all. A context is the name by which coverage calls a function.
    """
    names: dict[str, str] = {}
    seconds: dict[str, float] = defaultdict(float)
    failing = set()
    for case in cases:
        function = case.attrib["name"].partition("[")[0]
        file = case.attrib.get("file", "")
        classes = case.attrib["classname"].removeprefix(
            file.removesuffix(".py").replace("/", ".")
        )
        context = f"{case.attrib['classname']}.{function}"
        names[context] = "::".join([file, *classes.split(".")[1:], function])
        seconds[context] += float(case.attrib["time"])
        if case.find("failure") is not None or case.find("error") is not None:
            failing.add(context)
    return {
        context: names[context] for context in names if context not in failing
    }, dict(seconds)


def choose_tests(path: Path, changed: range, reach: Reach, seconds: float) -> list[str]:
    """Return names of tests that reach changed lines of a file, as many as take so many
    seconds together, one at least.
    """
    lines = reach.lines.get(str(path), {})
    own = "tests/" + str(path.parent).removeprefix("shapefit/")
    reached = {context for line in changed for context in lines.get(line, [])}
    if "" in reached:  # at import or in a fixture
        every = {context for some in lines.values() for context in some}
        reached |= {context for context in reach.names if context in every}
        reached |= {
            context for context, name in reach.names.items() if name.startswith(own)
        }

    def sort_key(context: str) -> tuple[bool, float]:
        """Return a key that sorts tests of the file's folder first, then by seconds."""
        return not reach.names[context].startswith(own), reach.seconds[context]

    chosen: list[str] = []
    total = 0.0
    for context in sorted(reached & reach.names.keys(), key=sort_key):
        total += reach.seconds[context]
        if chosen and total > seconds:
            break
        chosen.append(reach.names[context])
    return chosen


def judge_mutant(place: Path, mutant: Mutant, tests: list[str], seconds: float) -> str:
    """Run tests, which take so many seconds without it, on a mutant; return "killed"
    and how, "survives", or "not reached" where there are no tests.

    Its file in the checkout is changed, and put back.
    """
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


PAIRS = (
    *(
        "Lt LtE",
        "GtE Gt",
        "Lt Gt",
        "Eq NotEq",
        "In NotIn",
        "Is IsNot",
        "Add Sub",
        "Mult Div",
    ),
    *("Mod FloorDiv", "BitAnd BitOr", "sum max", "min max", "any all", "mean median"),
    *("argmin argmax", "minimum maximum", "zeros ones", "nansum nanmax"),
)
NAMES = dict(pair.split()[::step] for step in (-1, 1) for pair in PAIRS)
"""Operators, functions and methods, and what is put in their place."""

UNWRAPPED = {"sqrt", "abs", "exp", "log", "sorted", "clip"}
"""Functions whose first argument is taken in their place."""

UNCHANGED = (
    ast.Raise,
    ast.JoinedStr,
    ast.Import,
    ast.ImportFrom,
    ast.Assert,
    ast.pattern,
)
NOT_RUN = {"annotation", "returns", "decorator_list", "type_params", "ctx"}


class Mutant(NamedTuple):
    """A change of one expression: its file, the lines of its statement up to its end,
    the text before and after, and its place in the bytes of the file.
    """

    path: Path
    lines: range
    before: str
    after: str
    place: slice

    @property
    def source(self) -> bytes:
        """Return the bytes of the file with the change."""
        source = self.path.read_bytes()
        after = f"({self.after})".encode()
        return source[: self.place.start] + after + source[self.place.stop :]


def mutants(path: Path) -> Iterator[Mutant]:
    """Yield every mutant of a Python file."""
    source = path.read_bytes()
    starts = [0, 0]
    for line in source.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    for node, parent, first in expressions(ast.parse(source)):
        last = node.end_lineno or node.lineno
        place = slice(
            starts[node.lineno] + node.col_offset,
            starts[last] + (node.end_col_offset or 0),
        )
        for new in changes(node, parent):
            yield Mutant(
                path, range(first, last + 1), ast.unparse(node), ast.unparse(new), place
            )


def expressions(tree: ast.Module) -> Iterator[tuple[ast.expr, ast.AST, int]]:
    """Yield each expression that runs and is no message, its parent, and the line where
    its statement begins.
    """
    waiting: list[tuple[ast.AST, int]] = [(tree, 1)]
    while waiting:
        parent, first = waiting.pop()
        if isinstance(parent, ast.If) and ast.unparse(parent.test) == "TYPE_CHECKING":
            continue
        for field, value in ast.iter_fields(parent):
            for child in value if isinstance(value, list) else [value]:
                if field in NOT_RUN or isinstance(child, UNCHANGED):
                    continue
                if isinstance(child, ast.AST):
                    waiting.append(
                        (child, child.lineno if isinstance(child, ast.stmt) else first)
                    )
                if isinstance(child, ast.expr):
                    yield child, parent, first


def changes(node: ast.expr, parent: ast.AST) -> Iterator[ast.expr]:
    """Yield the expressions that mutants have in the place of an expression."""
    if isinstance(parent, ast.If | ast.While | ast.IfExp) and node is parent.test:
        yield ast.UnaryOp(ast.Not(), node)
        ends = ast.Raise | ast.Return | ast.Continue | ast.Break
        if isinstance(parent, ast.If) and isinstance(parent.body[-1], ends):
            yield ast.Constant(False)  # the guard is gone
    match node:
        case ast.Compare(ops=[operator], comparators=[_]):
            yield with_fields(node, ops=[partner_of(operator)])
        case ast.BoolOp(op=operator, values=[first, *_]):
            yield with_fields(
                node, op=ast.Or() if isinstance(operator, ast.And) else ast.And()
            )
            yield first
        case ast.BinOp(left=left, right=right, op=operator) if (
            type(operator).__name__ in NAMES
        ):
            if not is_text(left) and not is_text(right):
                yield with_fields(node, op=partner_of(operator))
                yield left
        case ast.UnaryOp(op=ast.USub() | ast.Not(), operand=operand):
            yield operand
        case ast.Constant(value=bool(value)):
            yield ast.Constant(not value)
        case ast.Constant(value=int(value)):
            yield ast.Constant(value + 1)
        case ast.Constant(value=float(value)) if value != float("inf"):
            yield ast.Constant(2 * value if value else 1.0)
        case ast.Call():
            yield from changes_of_call(node)


def changes_of_call(node: ast.Call) -> Iterator[ast.expr]:
    """Yield the expressions that mutants have in the place of a call: another function,
    its first argument alone, two arguments swapped, a keyword left out.
    """
    match node.func:
        case ast.Name(id=name) if name in NAMES:
            yield with_fields(node, func=ast.Name(NAMES[name]))
        case ast.Attribute(value=value, attr=name) if name in NAMES:
            yield with_fields(node, func=ast.Attribute(value, NAMES[name]))
        case ast.Name(id=name) | ast.Attribute(attr=name) if (
            name in UNWRAPPED and node.args
        ):
            yield node.args[0]
    match node.args:
        case [first, second, *rest] if not any(
            isinstance(a, ast.Starred) for a in node.args
        ):
            yield with_fields(node, args=[second, first, *rest])
    for index in range(len(node.keywords)):
        others = node.keywords[:index] + node.keywords[index + 1 :]
        yield with_fields(node, keywords=others)


def partner_of(operator: ast.operator | ast.cmpop) -> Any:
    """Return the operator that mutants have in the place of an operator, by NAMES."""
    return getattr(ast, NAMES[type(operator).__name__])()


def with_fields(node: ast.expr, **fields: Any) -> ast.expr:
    """Return a copy of a node in which these fields are replaced."""
    new = copy.copy(node)
    for name, value in fields.items():
        setattr(new, name, value)
    return new


def is_text(node: ast.expr) -> bool:
    """Whether an expression is a string or an f-string."""
    return isinstance(node, ast.JoinedStr) or (
        isinstance(node, ast.Constant) and isinstance(node.value, str)
    )


def main() -> None:
    """Try random mutants of the package; print whether the tests kill each."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--rooms", nargs="+", default=["shapefit", "cli"], help="files or folders"
    )
    parser.add_argument(
        "--seconds", type=float, default=60.0, help="of tests, per mutant"
    )
    parser.add_argument(
        "--tests", nargs="+", default=["tests"], help="tests that are run"
    )
    options = parser.parse_args()
    began, alive = time.monotonic(), 0
    with checkout() as place:
        reach = record_reach(place, options.tests)
        roots = [place / room for room in options.rooms]
        files = {
            f
            for root in roots
            for f in ([root] if root.is_file() else root.rglob("*.py"))
        }
        every = [mutant for path in sorted(files) for mutant in mutants(path)]
        some = random.Random(options.seed).sample(every, min(options.count, len(every)))
        print(f"{len(some)} of {len(every)} mutants", flush=True)
        for mutant in some:
            path = mutant.path.relative_to(place)
            tests = choose_tests(path, mutant.lines, reach, options.seconds)
            found = judge_mutant(place, mutant, tests, options.seconds)
            alive += not found.startswith("killed")
            where = f"{path}:{mutant.lines[-1]}"
            print(found, where, mutant.before, mutant.after, sep="\t", flush=True)
    minutes = (time.monotonic() - began) / 60
    print(f"{alive} of {len(some)} survive ({minutes:.0f} min)")


if __name__ == "__main__":
    main()
