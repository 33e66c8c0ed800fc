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

NAMES_OF_ROOMS = [
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
    "evaluation",
    "meshes",
    "viewer",
    "config",
    "io",
    "verification",
    "pipelines",
    "api",
    "cli",
]
"""From the lowest, which imports nothing, to the command line."""


ROOMS = [f"shapefit.{room}" for room in NAMES_OF_ROOMS]
"""Their modules."""

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
    """Return the name of the module in a file."""
    parts = path.relative_to(PROJECT).with_suffix("").parts
    if parts[0] == "cli":
        parts = ("shapefit", *parts)
    if parts[-1] == "__init__":
        parts = parts[:-1]
    return ".".join(parts)


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
    """Return the room of a module, or None where it is of another package."""
    for room in ROOMS:
        if name == room or name.startswith(f"{room}."):
            return room
    return None


def upward_imports(source: str, module: str, *, package: bool = False) -> list[str]:
    """Return the imports of a lower room from a higher one."""
    own = PYTHON_FACE if module == "shapefit" else room_of(module)
    upward = []
    for name in imports(parse(source), module, package=package):
        room = room_of(name)
        if room is None:
            continue
        if own is None or ROOMS.index(room) > ROOMS.index(own):
            upward.append(f"{module} imports {name}")
    return upward


def talk(source: str, module: str, *, package: bool = False) -> list[str]:
    """Return the uses of print and click."""
    tree = parse(source)
    used = [*imports(tree, module, package=package)]
    used += [node.id for node in ast.walk(tree) if isinstance(node, ast.Name)]
    return [
        f"{module} uses {name}"
        for name in used
        if name == "print" or name.split(".")[0] == "click"
    ]


class RunTime(ast.NodeTransformer):
    """Takes out what is imported for type annotations alone."""

    def visit_If(self, node):
        is_typing = isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"
        return None if is_typing else self.generic_visit(node)


def findings(paths, check) -> list[str]:
    """Return all that a check of source and module name finds in these files."""
    found = []
    for path in paths:
        is_package = path.name == "__init__.py"
        found += check(path.read_text("utf-8"), module_of(path), package=is_package)
    return found


def loaded_by(modules: str) -> set[str]:
    """Return the modules that Python has loaded when it has imported these."""
    source = f"import sys, {modules}\nprint(*sys.modules)"
    command = [sys.executable, "-c", source]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return set(done.stdout.split())


def test_rooms_import_one_way():
    """But for `__main__`, which is the command line."""
    files = [path for path in PACKAGE + CLI if path.name != "__main__.py"]
    assert findings(files, upward_imports) == []


def test_no_modules_import_each_other_in_a_circle():
    paths = {module_of(path): path for path in PACKAGE if path.name != "__init__.py"}
    graph: dict[str, set[str]] = {}
    for module, path in paths.items():
        tree = RunTime().visit(ast.parse(path.read_text("utf-8")))
        names = set(imports(tree, module))
        names |= {name.rpartition(".")[0] for name in names}
        graph[module] = names & paths.keys() - {module}
    TopologicalSorter(graph).prepare()


def test_the_package_neither_prints_nor_knows_click():
    assert findings(PACKAGE, talk) == []


def test_start_up_imports_nothing_heavy():
    loaded = loaded_by(", ".join(map(module_of, CLI)))
    packages = {name.split(".")[0] for name in loaded}
    assert not packages & HEAVY


def test_verification_uses_nothing_of_the_solver():
    files = sorted((PROJECT / "shapefit/verification").rglob("*.py"))
    loaded = loaded_by(", ".join(map(module_of, files)))
    rooms = {name.split(".")[1] for name in loaded if name.startswith("shapefit.")}
    assert not rooms & SOLVER


def test_every_folder_is_a_room():
    folders = [path for path in (PROJECT / "shapefit").iterdir() if path.is_dir()]
    with_modules = [path.name for path in folders if any(path.rglob("*.py"))]
    assert set(with_modules) <= set(NAMES_OF_ROOMS)


def test_the_map_has_the_rooms_in_their_order():
    text = (PROJECT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    listed = re.findall(r"^\| `shapefit/(\w+)/` \|", text, re.MULTILINE)
    expected = [room for room in NAMES_OF_ROOMS if room in listed]
    assert listed[::-1] == expected


AGAINST_THE_ORDER = [
    ("shapefit.errors", "from shapefit.geometry import rotations"),
    ("shapefit.convex.newton", "def f():\n    from shapefit.dictionary import model"),
    ("shapefit.config.commands.fit", "from ...io import records"),
]
"""A module, and a source of it that imports upwards."""


def test_imports_against_the_order_are_seen():
    for module, source in AGAINST_THE_ORDER:
        assert len(upward_imports(source, module)) == 1, module


def test_imports_in_the_order_are_let_through():
    source = "from .records import Shapes\nimport shapefit"
    assert upward_imports(source, "shapefit.io.a") == []


def test_talking_modules_are_seen():
    for source in ("print(1)", "import click", "from click import echo"):
        assert len(talk(source, "shapefit.io.hdf5")) == 1


def test_modules_that_are_loaded_are_seen():
    assert "numpy" in loaded_by("shapefit.geometry.rotations")
