"""Small changes of a Python file: an operator, a constant, a sign, a term left out, an order."""

from __future__ import annotations

import ast
import copy
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

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
    """One change: its file, the lines of its statement up to it (from 0 where it runs at import),
    what was there and is, and where that is in the tree of the file.
    """

    path: Path
    lines: range
    before: str
    after: str
    tree: ast.Module
    place: tuple[ast.AST, str, int | None]
    new: ast.expr

    @property
    def source(self) -> str:
        """The source of the file with the change."""
        parent, field, index = self.place
        value = getattr(parent, field)
        old = value if index is None else value[index]
        put(*self.place, self.new)
        source = ast.unparse(ast.fix_missing_locations(self.tree))
        put(*self.place, old)
        return source


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
        lines = range(first, (node.end_lineno or node.lineno) + 1)
        for new in changed(node):
            words = ast.unparse(node), ast.unparse(new)
            yield Mutant(path, lines, *words, tree, (parent, field, index), new)
