"""The tables of docs/files.md follow from the fields of the records."""

import ast
import inspect

import pytest

from shapefit.io.layout import LAYOUT_OF
from shapefit.records import Fit, Items, Landmarks, Shapes


def sentences_of(kind: type) -> dict[str, str]:
    """Return the sentence below each field of a class, those that it inherits first."""
    sentences: dict[str, str] = {}
    for base in (Items, kind):
        (tree,) = ast.parse(inspect.getsource(base)).body
        assert isinstance(tree, ast.ClassDef)
        for field, below in zip(tree.body, tree.body[1:], strict=False):
            if isinstance(field, ast.AnnAssign) and isinstance(below, ast.Expr):
                assert isinstance(field.target, ast.Name)
                sentences[field.target.id] = ast.literal_eval(below.value)
    return sentences


def table_of(kind: type, without: tuple[str, ...] = ()) -> str:
    """Return the table of the datasets of a class; what every file has is bold."""
    sentences = sentences_of(kind)
    lines = ["| dataset | axes | unit | holds |", "|---|---|---|---|"]
    for name, column in LAYOUT_OF[kind].columns.items():
        if name in without:
            continue
        code = f"`{name}`"
        shown = f"**{code}**" if column.required else code
        axes = ", ".join(map(str, column.axes))
        sentence = " ".join(sentences[column.field].split())
        lines.append(f"| {shown} | ({axes}) | {column.unit} | {sentence} |")
    return "\n".join(lines)


IN_ALL = ("landmark_names", "item", "sequence", "frame", "time", "edges")
"""Datasets of every record, which the first table has for all."""

TABLES = [(Landmarks, ()), (Shapes, IN_ALL), (Fit, IN_ALL)]


@pytest.mark.parametrize(("kind", "without"), TABLES)
def test_the_page_has_the_table_of_each_kind(project, kind, without):
    page = (project / "docs/files.md").read_text(encoding="utf-8")
    table = table_of(kind, without)
    assert table in page, f"docs/files.md needs this table:\n\n{table}"


@pytest.mark.parametrize("kind", [Landmarks, Shapes, Fit])
def test_every_field_has_its_sentence(kind):
    sentences = sentences_of(kind)
    for column in LAYOUT_OF[kind].columns.values():
        sentence = sentences[column.field].strip()
        assert sentence.endswith(".")
