"""Small changes of Python source: an operator, a constant, an order, a condition, a guard."""

from __future__ import annotations

import ast
import copy
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

COMPARISONS: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.LtE, ast.Gt),
    ast.LtE: (ast.Lt, ast.GtE),
    ast.Gt: (ast.GtE, ast.Lt),
    ast.GtE: (ast.Gt, ast.LtE),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
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
PAIRS = "sum max,min max,any all,mean median,argmin argmax,minimum maximum,zeros ones,nansum nanmax"
NAMES = dict(pair.split()[::step] for step in (-1, 1) for pair in PAIRS.split(","))
"""Functions and methods, and what is called in their place."""

UNWRAPPED = {"sqrt", "abs", "exp", "log", "sorted", "clip"}
"""Functions whose first argument is taken in their place."""

UNCHANGED = (ast.Raise, ast.JoinedStr, ast.Import, ast.ImportFrom, ast.Assert, ast.pattern)
NOT_RUN = {"annotation", "returns", "decorator_list", "type_params", "ctx"}


class Mutant(NamedTuple):
    """One change: its file, the lines of its statement up to it, what was there and what is, and
    where that is in the bytes of the file.
    """

    path: Path
    lines: range
    before: str
    after: str
    place: slice

    @property
    def source(self) -> bytes:
        """The source of the file with the change."""
        source = self.path.read_bytes()
        after = f"({self.after})".encode()
        return source[: self.place.start] + after + source[self.place.stop :]


def mutants(path: Path) -> Iterator[Mutant]:
    """Yield every mutant of a file."""
    source = path.read_bytes()
    starts = [0, 0]
    for line in source.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    for node, parent, first in expressions(ast.parse(source)):
        last = node.end_lineno or node.lineno
        place = slice(
            starts[node.lineno] + node.col_offset, starts[last] + (node.end_col_offset or 0)
        )
        for new in changes(node, parent):
            yield Mutant(path, range(first, last + 1), ast.unparse(node), ast.unparse(new), place)


def expressions(tree: ast.Module) -> Iterator[tuple[ast.expr, ast.AST, int]]:
    """Yield the expressions that run and are no messages, with their parent and the line where
    their statement begins.
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
                    waiting.append((child, child.lineno if isinstance(child, ast.stmt) else first))
                if isinstance(child, ast.expr):
                    yield child, parent, first


def changes(node: ast.expr, parent: ast.AST) -> Iterator[ast.expr]:
    """Yield what an expression could be in its place."""
    if isinstance(parent, ast.If | ast.While | ast.IfExp) and node is parent.test:
        yield ast.UnaryOp(ast.Not(), node)
        ends = ast.Raise | ast.Return | ast.Continue | ast.Break
        if isinstance(parent, ast.If) and isinstance(parent.body[-1], ends):
            yield ast.Constant(False)  # the guard is gone
    match node:
        case ast.Compare(ops=[operator], comparators=[_]):
            yield from (changed(node, ops=[new()]) for new in COMPARISONS[type(operator)])
        case ast.BoolOp(op=operator, values=[first, *_]):
            yield changed(node, op=ast.Or() if isinstance(operator, ast.And) else ast.And())
            yield first
        case ast.BinOp(left=left, right=right, op=operator) if type(operator) in OPERATORS:
            if not is_text(left) and not is_text(right):
                yield changed(node, op=OPERATORS[type(operator)]())
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
    """Yield a call of another function, with two arguments swapped, without each keyword."""
    match node.func:
        case ast.Name(id=name) if name in NAMES:
            yield changed(node, func=ast.Name(NAMES[name]))
        case ast.Attribute(value=value, attr=name) if name in NAMES:
            yield changed(node, func=ast.Attribute(value, NAMES[name]))
        case ast.Name(id=name) | ast.Attribute(attr=name) if name in UNWRAPPED and node.args:
            yield node.args[0]
    match node.args:
        case [first, second, *rest] if not any(isinstance(a, ast.Starred) for a in node.args):
            yield changed(node, args=[second, first, *rest])
    for index in range(len(node.keywords)):
        yield changed(node, keywords=node.keywords[:index] + node.keywords[index + 1 :])


def changed(node: ast.expr, **fields: Any) -> ast.expr:
    """Return a copy of a node with other fields."""
    new = copy.copy(node)
    for name, value in fields.items():
        setattr(new, name, value)
    return new


def is_text(node: ast.expr) -> bool:
    """Whether an expression is plainly a string."""
    return isinstance(node, ast.JoinedStr) or (
        isinstance(node, ast.Constant) and isinstance(node.value, str)
    )
