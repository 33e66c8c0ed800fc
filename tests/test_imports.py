"""Rooms import one way, the package never prints, start-up stays light."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[1]

ROOMS = [
    f"shapefit.{room}"
    for room in (
        *(
            "errors",
            "arrays",
            "timeline",
            "core",
            "threads",
            "geometry",
            "records",
            "convex",
            "dictionary",
            "lifting",
        ),
        *("evaluation", "meshes", "viewer", "config", "io", "verification"),
        "pipelines",
        *("api", "cli"),
    )
]
"""From the lowest, which imports nothing, to the command line."""

PYTHON_FACE = ROOMS[-2]
"""The room whose names `shapefit/__init__.py` gives out."""

HEAVY = {
    "numpy",
    "scipy",
    "h5py",
    "pydantic",
    "ruamel",
    "trimesh",
    "orjson",
    "tqdm",
    "matplotlib",
}
"""What the command line does not load before it knows what is asked."""

SOLVER = {"core", "convex", "lifting", "evaluation", "pipelines"}
"""What verification does not load: nothing that made what it checks."""

PACKAGE = sorted((PROJECT / "shapefit").rglob("*.py"))
CLI = sorted((PROJECT / "cli").rglob("*.py"))


parse = cache(ast.parse)
"""Trees that nobody changes."""


def module_of(path: Path) -> str:
    parts = path.relative_to(PROJECT).with_suffix("").parts
    parts = ("shapefit", *parts) if parts[0] == "cli" else parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports(tree: ast.AST, module: str, *, package: bool = False) -> Iterator[str]:
    """Yield the name of each import under `tree`; `from a import b` counts as `a.b`."""
    base = module.split(".") if package else module.split(".")[:-1]
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = base[: len(base) - node.level + 1] if node.level else []
            origin = [*above, *([node.module] if node.module else [])]
            yield from (".".join([*origin, alias.name]) for alias in node.names)


def room_of(name: str) -> str | None:
    return next(
        (room for room in ROOMS if name == room or name.startswith(f"{room}.")), None
    )


def upward_imports(source: str, module: str, *, package: bool = False) -> list[str]:
    """Return the imports of a lower room from a higher one."""
    own = PYTHON_FACE if module == "shapefit" else room_of(module)
    return [
        f"{module} imports {name}"
        for name in imports(parse(source), module, package=package)
        if (room := room_of(name))
        and (own is None or ROOMS.index(room) > ROOMS.index(own))
    ]


def talk(source: str, module: str, *, package: bool = False) -> list[str]:
    """Return the uses of print and click."""
    tree = parse(source)
    used = [*imports(tree, module, package=package)]
    used += [node.id for node in ast.walk(tree) if isinstance(node, ast.Name)]
    return [
        f"{module} uses {n}" for n in used if n == "print" or n.split(".")[0] == "click"
    ]


class RunTime(ast.NodeTransformer):
    """Takes out what is imported for type annotations alone."""

    def visit_If(self, node):
        is_typing = isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"
        return None if is_typing else self.generic_visit(node)


def findings(paths, check) -> list[str]:
    """Return all that a check of source and module name finds in these files."""
    return [
        finding
        for path in paths
        for finding in check(
            path.read_text("utf-8"), module_of(path), package=path.name == "__init__.py"
        )
    ]


def loaded_by(modules: str) -> set[str]:
    """Return the modules that Python has loaded when it has imported these."""
    source = f"import sys, {modules}\nprint(*sys.modules)"
    command = [sys.executable, "-c", source]
    return set(
        subprocess.run(
            command, capture_output=True, text=True, check=True
        ).stdout.split()
    )


def test_rooms_import_one_way():
    # __main__ is the command line
    assert (
        findings([p for p in PACKAGE + CLI if p.name != "__main__.py"], upward_imports)
        == []
    )


def test_no_modules_import_each_other_in_a_circle():
    paths = {module_of(path): path for path in PACKAGE if path.name != "__init__.py"}
    graph: dict[str, set[str]] = {}
    for module, path in paths.items():
        names = set(
            imports(RunTime().visit(ast.parse(path.read_text("utf-8"))), module)
        )
        names |= {name.rpartition(".")[0] for name in names}
        graph[module] = names & paths.keys() - {module}
    TopologicalSorter(graph).prepare()


def test_the_package_neither_prints_nor_knows_click():
    assert findings(PACKAGE, talk) == []


def test_start_up_imports_nothing_heavy():
    modules = ", ".join(map(module_of, CLI))
    assert not {name.split(".")[0] for name in loaded_by(modules)} & HEAVY


def test_verification_uses_nothing_of_the_solver():
    files = sorted((PROJECT / "shapefit/verification").rglob("*.py"))
    loaded = loaded_by(", ".join(map(module_of, files)))
    assert (
        not {name.split(".")[1] for name in loaded if name.startswith("shapefit.")}
        & SOLVER
    )


def test_every_folder_is_a_room_and_on_the_map():
    rooms = {
        path.relative_to(PROJECT).parts[1]
        for path in PACKAGE
        if path.parent.name != "shapefit"
    }
    assert {
        f"shapefit.{room}" for room in rooms if (PROJECT / "shapefit" / room).is_dir()
    } <= set(ROOMS)
    text = (PROJECT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    listed = re.findall(r"^\| `shapefit/(\w+)/` \|", text, re.MULTILINE)
    order = [f"shapefit.{room}" for room in reversed(listed)]
    assert order == [room for room in ROOMS if room in order]


def test_faults_are_seen():
    """Each check finds what is planted, and lets the rest through."""
    against = [
        ("shapefit.errors", "from shapefit.geometry import rotations"),
        (
            "shapefit.convex.newton",
            "def f():\n    from shapefit.dictionary import model",
        ),
        ("shapefit.config.commands.fit", "from ...io import records"),
    ]
    assert [s for m, s in against if len(upward_imports(s, m)) != 1] == []
    assert (
        upward_imports("from .records import Shapes\nimport shapefit", "shapefit.io.a")
        == []
    )
    for source in ("print(1)", "import click", "from click import echo"):
        assert len(talk(source, "shapefit.io.hdf5")) == 1
    assert "numpy" in loaded_by("shapefit.geometry.rotations")
