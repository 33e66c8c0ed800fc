"""Change the package in small ways, run the nearest tests of each change, list what survives.

    python building/mutants.py --count 300 --seed 1 [--only shapefit/geometry] [--seconds 120]

A mutant is one change of one line: an operator, a constant, a sign, a term or factor left out, an
order, a condition turned round. The nearest tests are those that mirror its file, or its folder. A
mutant survives when all of them pass. Files are changed where they stand and put back, so the
checkout must be clean.
"""

from __future__ import annotations

import argparse
import ast
import copy
import random
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

PROJECT = Path(__file__).resolve().parents[1]

ROOMS = (
    *("lifting", "dictionary", "geometry", "convex", "evaluation", "verification", "io"),
    *("pipelines/fit", "pipelines/evaluate"),
)
"""Rooms whose files are changed, below `shapefit/`."""

THROUGH_A_COMMAND = {"evaluation": "pipelines/evaluate", "verification": "pipelines/verify"}
"""Rooms that are tested above all through a command, and the folder of those tests."""

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
    """One change: the file, the line, what it was and is, and the source with it."""

    path: Path
    line: int
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


def places(tree: ast.Module) -> Iterator[tuple[ast.AST, str, int | None]]:
    """Yield parent, field and index of the expressions that run and are no messages."""
    waiting: list[ast.AST] = [tree]
    while waiting:
        parent = waiting.pop()
        if isinstance(parent, ast.Raise | ast.JoinedStr | ast.Import | ast.ImportFrom | ast.Assert):
            continue
        if isinstance(parent, ast.If) and ast.unparse(parent.test) == "TYPE_CHECKING":
            continue
        for field, value in ast.iter_fields(parent):
            if field in ("annotation", "returns", "decorator_list", "type_params", "ctx"):
                continue
            for index, child in enumerate(value) if isinstance(value, list) else [(None, value)]:
                if isinstance(child, ast.AST):
                    waiting.append(child)
                if isinstance(child, ast.expr):
                    yield parent, field, index


def put(parent: ast.AST, field: str, index: int | None, node: ast.AST) -> None:
    """Put a node in its place below a parent."""
    if index is None:
        setattr(parent, field, node)
    else:
        getattr(parent, field)[index] = node


def mutants(path: Path) -> Iterator[Mutant]:
    """Yield every mutant of a file."""
    tree = ast.parse(path.read_text("utf-8"))
    for parent, field, index in list(places(tree)):
        value = getattr(parent, field)
        node = value if index is None else value[index]
        for new in changed(node):
            put(parent, field, index, new)
            source = ast.unparse(ast.fix_missing_locations(tree))
            put(parent, field, index, node)
            yield Mutant(path, node.lineno, ast.unparse(node), ast.unparse(new), source)


def nearest_tests(path: Path) -> list[str]:
    """Return the tests that mirror a file, and those beside them; else those of its room."""
    inside = path.relative_to(PROJECT / "shapefit").with_suffix("")
    folder = PROJECT / "tests" / inside.parent
    while not any(folder.rglob("test_*.py")):
        folder = folder.parent
    own = [*folder.glob(f"test_{inside.name}*.py")]
    if (PROJECT / "tests" / inside).is_dir():
        own.append(PROJECT / "tests" / inside)
    if inside.parts[0] in THROUGH_A_COMMAND:
        own.append(PROJECT / "tests" / THROUGH_A_COMMAND[inside.parts[0]])
    return [*map(str, own), str(folder)]


def survives(mutant: Mutant, seconds: float) -> bool:
    """Whether the nearest tests pass with the change; what takes too long has failed."""
    original = mutant.path.read_bytes()
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-n", "0", "-m", "not slow"]
    try:
        mutant.path.write_text(mutant.source, encoding="utf-8")
        done = subprocess.run(
            [*command, "-p", "no:cacheprovider", *nearest_tests(mutant.path)],
            cwd=PROJECT,
            capture_output=True,
            timeout=seconds,
            check=False,
        )
        return done.returncode == 0
    except subprocess.TimeoutExpired:
        return False
    finally:
        mutant.path.write_bytes(original)


def files(only: str | None) -> list[Path]:
    """Return the files that are changed, those below `only` where it is given."""
    roots = [PROJECT / only] if only else [PROJECT / "shapefit" / room for room in ROOMS]
    found = {path for root in roots for path in ([root] if root.is_file() else root.rglob("*.py"))}
    return sorted(path for path in found if path.suffix == ".py" and path.exists())


def main() -> int:
    """Run the mutants and print those that survive; 2 where the checkout is not clean."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", help="a file or folder, from the top of the checkout")
    parser.add_argument("--seconds", type=float, default=300.0, help="at most, per mutant")
    options = parser.parse_args()
    status = ["git", "status", "--porcelain", "shapefit"]
    if subprocess.run(status, cwd=PROJECT, capture_output=True, check=True).stdout:
        print("The checkout is not clean: commit first.", file=sys.stderr)
        return 2
    every = [mutant for path in files(options.only) for mutant in mutants(path)]
    some = random.Random(options.seed).sample(every, min(options.count, len(every)))
    print(f"{len(some)} of {len(every)} mutants", flush=True)
    began, alive = time.monotonic(), 0
    for number, mutant in enumerate(some, 1):
        if survives(mutant, options.seconds):
            alive += 1
            place = f"{mutant.path.relative_to(PROJECT)}:{mutant.line}"
            print(f"{place}: {mutant.before}  ->  {mutant.after}", flush=True)
        if number % 25 == 0 or number == len(some):
            minutes = (time.monotonic() - began) / 60
            print(f"{alive} of {number} survive ({minutes:.0f} min)", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
