"""Change the package in small ways, run the tests that reach each change, list what survives.

    python building/mutants.py --count 300 --seed 1 [--only shapefit/geometry] [--seconds 60]

A mutant is one change of one expression: an operator, a constant, a sign, a term or factor left
out, an order, a condition turned round. Its tests are the quick ones that run its lines, as
`building/reach.py` records once (anew where its folder, `build/reach`, is deleted): those of its
own folder first, the fastest first. A mutant survives when all of them pass, and where no test
reaches it. Files are changed where they stand and put back, so the checkout must be clean.
"""

from __future__ import annotations

import argparse
import ast
import copy
import importlib
import os
import random
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from reach import Reach, reach_of_tests, tests_of

PROJECT = Path(__file__).resolve().parents[1]

ROOMS = (
    *("lifting", "dictionary", "geometry", "convex", "evaluation", "verification", "io"),
    *("pipelines/fit", "pipelines/evaluate"),
)
"""Rooms whose files are changed, below `shapefit/`."""

LIBRARIES = ("h5py", "hypothesis", "pydantic", "pytest", "ruamel.yaml", "scipy.optimize", "tqdm")
"""Imported once: each mutant runs in a copy of this process, which has not imported the package."""

COMPARISONS: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
}
OPERATORS: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.Mod: ast.FloorDiv,
    ast.FloorDiv: ast.Mod,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
}
NAMES = {
    "min": "max",
    "max": "min",
    "any": "all",
    "all": "any",
    "mean": "median",
    "median": "mean",
    "argmin": "argmax",
    "argmax": "argmin",
    "minimum": "maximum",
    "maximum": "minimum",
    "zeros": "ones",
    "ones": "zeros",
    "nanmean": "nanmedian",
    "nansum": "nanmax",
    "sum": "max",
}
"""Functions and methods, and what is called in their place."""

UNWRAPPED = {"sqrt", "abs", "exp", "log", "sorted", "clip"}
"""Functions whose first argument is taken in their place."""


class Mutant(NamedTuple):
    """One change: the file, the lines of its statement up to it (from 0 where that runs at import),
    what it was and is, and the source with it.
    """

    path: Path
    lines: range
    before: str
    after: str
    source: str


def is_text(node: ast.expr) -> bool:
    """Whether an expression is plainly a string."""
    return isinstance(node, ast.JoinedStr) or (
        isinstance(node, ast.Constant) and isinstance(node.value, str)
    )


def changed(node: ast.AST) -> Iterator[ast.expr]:
    """Yield what an expression could be in its place."""
    match node:
        case ast.Compare(ops=[operator], comparators=[_]) if type(operator) in COMPARISONS:
            new = copy.copy(node)
            new.ops = [COMPARISONS[type(operator)]()]
            yield new
        case ast.BoolOp(values=[first, *_]):
            turned = copy.copy(node)
            turned.op = ast.Or() if isinstance(node.op, ast.And) else ast.And()
            yield turned
            yield first
        case ast.BinOp(left=left, right=right, op=operator) if type(operator) in OPERATORS:
            if not is_text(left) and not is_text(right):
                swapped = copy.copy(node)
                swapped.op = OPERATORS[type(operator)]()
                yield swapped
                yield left
        case ast.UnaryOp(op=ast.USub() | ast.Not(), operand=operand):
            yield operand
        case ast.Constant(value=bool(value)):
            yield ast.Constant(not value)
        case ast.Constant(value=int(value)):
            yield ast.Constant(value + 1)
        case ast.Constant(value=float(value)) if value not in (float("inf"),):
            yield ast.Constant(2 * value if value else 1.0)
        case ast.Call(func=ast.Name(id=name) | ast.Attribute(attr=name)) if name in NAMES:
            called = copy.deepcopy(node)
            if isinstance(called.func, ast.Name):
                called.func.id = NAMES[name]
            elif isinstance(called.func, ast.Attribute):
                called.func.attr = NAMES[name]
            yield called
        case ast.Call(func=ast.Name(id=name) | ast.Attribute(attr=name), args=[first, *_]):
            if name in UNWRAPPED:
                yield first
            elif name == "argsort":
                yield ast.parse(f"np.arange(len({ast.unparse(first)}))", mode="eval").body
        case ast.IfExp(body=body, orelse=other):
            yield ast.IfExp(node.test, other, body)


def places(tree: ast.Module) -> Iterator[tuple[ast.AST, str, int | None, int]]:
    """Yield parent, field and index of the expressions that run and are no messages, and the line
    where their statement begins; 0 where it runs at import.
    """
    waiting: list[tuple[ast.AST, int, bool]] = [(tree, 0, False)]
    while waiting:
        parent, first, inside = waiting.pop()
        if isinstance(parent, ast.Raise | ast.JoinedStr | ast.Import | ast.ImportFrom | ast.Assert):
            continue
        if isinstance(parent, ast.If) and ast.unparse(parent.test) == "TYPE_CHECKING":
            continue
        function = isinstance(parent, ast.FunctionDef | ast.Lambda)
        for field, value in ast.iter_fields(parent):
            if field in ("annotation", "returns", "decorator_list", "type_params", "ctx"):
                continue
            within = inside or (function and field == "body")
            for index, child in enumerate(value) if isinstance(value, list) else [(None, value)]:
                if isinstance(child, ast.AST):
                    line = child.lineno if isinstance(child, ast.stmt) else first
                    waiting.append((child, line, within))
                if isinstance(child, ast.expr):
                    yield parent, field, index, first if within else 0


def put(parent: ast.AST, field: str, index: int | None, node: ast.AST) -> None:
    """Put a node in its place below a parent."""
    if index is None:
        setattr(parent, field, node)
    else:
        getattr(parent, field)[index] = node


def mutants(path: Path) -> Iterator[Mutant]:
    """Yield every mutant of a file."""
    tree = ast.parse(path.read_text("utf-8"))
    for parent, field, index, first in list(places(tree)):
        value = getattr(parent, field)
        node = value if index is None else value[index]
        for new in changed(node):
            put(parent, field, index, new)
            source = ast.unparse(ast.fix_missing_locations(tree))
            put(parent, field, index, node)
            lines = range(first, (node.end_lineno or node.lineno) + 1)
            yield Mutant(path, lines, ast.unparse(node), ast.unparse(new), source)


class WithoutShrinking:
    """A plugin of pytest: Hypothesis takes the same examples each time and shrinks none."""

    def pytest_sessionstart(self) -> None:
        """Choose so before tests are read."""
        from hypothesis import Phase, settings

        phases = (Phase.explicit, Phase.generate)
        settings.register_profile("mutants", database=None, derandomize=True, phases=phases)
        settings.load_profile("mutants")


def code_of(tests: list[str], seconds: float) -> int:
    """Run tests in a copy of this process and return its exit code; -1 where it takes too long."""
    child = os.fork()
    if child == 0:
        code = 1
        try:
            os.setpgid(0, 0)
            resource.setrlimit(resource.RLIMIT_CPU, (int(4 * seconds + 60),) * 2)
            for stream in (0, 1, 2):
                os.dup2(os.open(os.devnull, os.O_RDWR), stream)
            options = ["-q", "-x", "-p", "no:cacheprovider", "-p", "no:xdist"]
            code = importlib.import_module("pytest").main(options + tests, [WithoutShrinking()])
        finally:
            os._exit(int(code))
    until = time.monotonic() + 10 * seconds + 120
    while time.monotonic() < until:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.02)
    os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return -1


def verdict(mutant: Mutant, reach: Reach, seconds: float) -> str:
    """Return "killed", "survives" or "not reached"; what takes too long is killed."""
    tests = tests_of(mutant.path, mutant.lines, reach, seconds)
    if not tests:
        return "not reached"
    original, status = mutant.path.read_bytes(), mutant.path.stat()
    try:
        mutant.path.write_text(mutant.source, encoding="utf-8")
        code = code_of(tests, seconds)
        if code == 4:  # a test has another name with the change, or the package no longer loads
            code = code_of(sorted({test.partition("::")[0] for test in tests}), seconds)
        return "killed" if code else "survives"
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
    sys.dont_write_bytecode = True  # a changed file leaves nothing behind
    sys.path.insert(0, str(PROJECT))
    os.chdir(PROJECT)
    for name in LIBRARIES:
        importlib.import_module(name)
    every = [mutant for path in files(options.only) for mutant in mutants(path)]
    some = random.Random(options.seed).sample(every, min(options.count, len(every)))
    print(f"{len(some)} of {len(every)} mutants", flush=True)
    began, alive = time.monotonic(), 0
    for mutant in some:
        found = verdict(mutant, reached, options.seconds)
        alive += found != "killed"
        place = f"{mutant.path.relative_to(PROJECT)}:{mutant.lines[-1]}"
        print(found, place, mutant.before, mutant.after, sep="\t", flush=True)
    minutes = (time.monotonic() - began) / 60
    print(f"{alive} of {len(some)} survive ({minutes:.0f} min)", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
