"""Rooms import one way, the package never prints, start-up stays light, files are chapters."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[1]

ROOMS = [
    f"shapefit.{room}"
    for room in (
        *("errors", "arrays", "core", "geometry", "convex", "dictionary", "lifting"),
        *("evaluation", "meshes", "viewer", "stores", "config", "io", "verification"),
        "pipelines",
        *("api", "cli"),
    )
]
"""From the lowest, which imports nothing, to the command line."""

PYTHON_FACE = ROOMS[-2]
"""The room whose names `shapefit/__init__.py` gives out."""

LIGHT = {*sys.stdlib_module_names, "click"}
LIGHT_OF_THE_PACKAGE = {
    *("shapefit", "shapefit.__version__"),
    *("shapefit.errors.InputError", "shapefit.errors.printable"),
}
"""With LIGHT, what `cli` and `shapefit/__init__.py` may import when they are loaded."""

NEEDED_TO_VERIFY = ("errors", "arrays", "geometry", "io", "verification")
"""What verification may import of the package: nothing that made what it checks."""

LONGEST = 650
"""Lines of a file."""

PACKAGE = sorted((PROJECT / "shapefit").rglob("*.py"))
CLI = sorted((PROJECT / "cli").rglob("*.py"))

Check = Callable[..., list[str]]


def module_of(path: Path) -> str:
    parts = path.relative_to(PROJECT).with_suffix("").parts
    parts = ("shapefit", *parts) if parts[0] == "cli" else parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports(tree: ast.AST, module: str, *, package: bool = False) -> Iterator[tuple[int, str]]:
    """Yield line and name of each import under `tree`; `from a import b` counts as `a.b`."""
    base = module.split(".") if package else module.split(".")[:-1]
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = base[: len(base) - node.level + 1] if node.level else []
            origin = [*above, *([node.module] if node.module else [])]
            yield from ((node.lineno, ".".join([*origin, alias.name])) for alias in node.names)


def room_of(name: str) -> str | None:
    return next((room for room in ROOMS if name == room or name.startswith(f"{room}.")), None)


def upward_imports(source: str, module: str, *, package: bool = False) -> list[str]:
    """Return the imports of a lower room from a higher one."""
    own = PYTHON_FACE if module == "shapefit" else room_of(module)
    return [
        f"line {line}: {module} imports {name}"
        for line, name in imports(ast.parse(source), module, package=package)
        if (room := room_of(name)) and (own is None or ROOMS.index(room) > ROOMS.index(own))
    ]


def talk(source: str, module: str, *, package: bool = False) -> list[str]:
    """Return the uses of print and click."""
    tree = ast.parse(source)
    used = [*imports(tree, module, package=package)]
    used += [(node.lineno, node.id) for node in ast.walk(tree) if isinstance(node, ast.Name)]
    return [
        f"line {line}: {module} uses {name}"
        for line, name in used
        if name == "print" or name.split(".")[0] == "click"
    ]


class RunTime(ast.NodeTransformer):
    """Takes out what is imported for type annotations alone."""

    def visit_If(self, node):
        is_typing = isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"
        return None if is_typing else self.generic_visit(node)


class ModuleLevel(RunTime):
    """Takes out the bodies of functions, too, which do not run on import."""

    def visit_FunctionDef(self, _node):
        return None

    visit_AsyncFunctionDef = visit_FunctionDef


def heavy_imports(source: str, module: str, *, package: bool = False) -> list[str]:
    """Return the imports at module level of anything that is not light."""
    tree = ModuleLevel().visit(ast.parse(source))
    return [
        f"line {line}: {module} imports {name}"
        for line, name in imports(tree, module, package=package)
        if name.split(".")[0] not in LIGHT
        and name not in LIGHT_OF_THE_PACKAGE
        and not name.startswith("shapefit.cli.")
    ]


def imports_of_the_solver(source: str, module: str, *, package: bool = False) -> list[str]:
    """Return the imports of parts of the package that verification must not know."""
    allowed = tuple(f"shapefit.{room}" for room in NEEDED_TO_VERIFY)
    return [
        f"line {line}: {module} imports {name}"
        for line, name in imports(ast.parse(source), module, package=package)
        if name.split(".")[0] == "shapefit" and not name.startswith(allowed)
    ]


def assert_clean(paths: Iterable[Path], check: Check) -> None:
    """Fail with all that a check of source and module name finds in these files."""
    findings = [
        finding
        for path in paths
        for finding in check(
            path.read_text("utf-8"), module_of(path), package=path.name == "__init__.py"
        )
    ]
    assert not findings, "\n".join(findings)


def circles(graph: Mapping[str, set[str]]) -> list[str]:
    """Return the modules that import themselves by way of others."""

    def reached(start: str) -> set[str]:
        found: set[str] = set()
        waiting = list(graph[start])
        while waiting:
            name = waiting.pop()
            if name not in found:
                found.add(name)
                waiting += graph[name]
        return found

    return [name for name in graph if name in reached(name)]


def test_rooms_import_one_way():
    # __main__ is the command line
    assert_clean([p for p in PACKAGE + CLI if p.name != "__main__.py"], upward_imports)


def test_no_modules_import_each_other_in_a_circle():
    paths = {module_of(path): path for path in PACKAGE if path.name != "__init__.py"}
    graph: dict[str, set[str]] = {}
    for module, path in paths.items():
        tree = RunTime().visit(ast.parse(path.read_text("utf-8")))
        names = {name for _, name in imports(tree, module)}
        names |= {name.rpartition(".")[0] for name in names}
        graph[module] = names & paths.keys() - {module}
    assert circles(graph) == []
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"b"}}) == ["b", "c"]


def test_the_package_neither_prints_nor_knows_click():
    assert_clean(PACKAGE, talk)


def test_start_up_imports_nothing_heavy():
    assert_clean([*CLI, PROJECT / "shapefit/__init__.py"], heavy_imports)


def test_verification_uses_nothing_of_the_solver():
    files = sorted((PROJECT / "shapefit/verification").rglob("*.py"))
    assert_clean(files, imports_of_the_solver)
    source = f"import sys, {', '.join(map(module_of, files))}\nprint(*sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", source], capture_output=True, text=True, check=True
    )
    rooms = {name.split(".")[1] for name in done.stdout.split() if name.startswith("shapefit.")}
    assert not rooms & {"core", "convex", "lifting", "evaluation", "pipelines"}


def test_every_folder_is_a_room_and_on_the_map():
    rooms = {
        path.relative_to(PROJECT).parts[1] for path in PACKAGE if path.parent.name != "shapefit"
    }
    assert {f"shapefit.{room}" for room in rooms if (PROJECT / "shapefit" / room).is_dir()} <= set(
        ROOMS
    )
    text = (PROJECT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    listed = re.findall(r"^\| `shapefit/(\w+)/` \|", text, re.MULTILINE)
    order = [f"shapefit.{room}" for room in reversed(listed)]
    assert order == [room for room in ROOMS if room in order]


def test_a_file_is_a_chapter():
    lines = {module_of(path): path.read_text("utf-8").count("\n") for path in PACKAGE + CLI}
    assert {name: count for name, count in lines.items() if count > LONGEST} == {}


def test_faults_are_seen():
    """Each check finds what is planted, and lets the rest through."""
    against = [
        ("shapefit.errors", "from shapefit.geometry import rotations"),
        ("shapefit.convex.solver", "def f():\n    from shapefit.dictionary import model"),
        ("shapefit.config.commands.fit", "from ...io import records"),
        ("shapefit.io.hdf5", "from shapefit.pipelines.fit import run"),
    ]
    along = [
        ("shapefit.io.hdf5", "from shapefit.config import FitConfig\nimport shapefit.errors"),
        ("shapefit.io.hdf5", "from .records import ShapeSet\nfrom shapefit import __version__"),
    ]
    assert [s for m, s in against if len(upward_imports(s, m)) != 1] == []
    assert [s for m, s in along if upward_imports(s, m)] == []
    for source in ("print(1)", "import click", "from click import echo"):
        assert len(talk(source, "shapefit.io.hdf5")) == 1
    for source in ("import numpy as np", "class A:\n    import scipy.linalg"):
        assert len(heavy_imports(source, "shapefit.cli.fit")) == 1
    assert not heavy_imports("def f():\n    import numpy", "shapefit.cli.fit")
    source = "def f():\n    from shapefit.convex.transforms import nuclear_norm"
    assert len(imports_of_the_solver(source, "shapefit.verification.program")) == 1
