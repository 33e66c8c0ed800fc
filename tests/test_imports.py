"""The rooms of CONTRIBUTING.md import one way, the package never prints, start-up stays light."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[1]

LIGHT = {*sys.stdlib_module_names, "click"}
LIGHT_OF_THE_PACKAGE = {"shapefit", "shapefit.__version__", "shapefit.errors.InputError"}
LIGHT_OF_THE_PACKAGE |= {"shapefit.errors.printable"}
"""With LIGHT, what `cli` and `shapefit/__init__.py` may import when they are loaded."""


def listed() -> list[str]:
    """Return rooms and the folders in them, as modules, in the order of the map."""
    text = (PROJECT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    found = re.findall(r"^\| `(shapefit/[\w/]+|cli)(?:/|\.py)` \|", text, re.MULTILINE)
    return ["shapefit.cli" if room == "cli" else room.replace("/", ".") for room in found]


def rooms() -> list[str]:
    """Return the rooms from the lowest, which imports nothing, to the command line."""
    return [room for room in reversed(listed()) if room.count(".") < 2]


ROOMS = rooms()
FACE = "shapefit.face"
"""The room whose names `shapefit/__init__.py` gives out."""


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
    """Return the imports of a lower room of the map from a higher one."""
    own = FACE if module == "shapefit" else room_of(module)
    wrong = []
    for line, name in imports(ast.parse(source), module, package=package):
        room = room_of(name)
        if room and (own is None or ROOMS.index(room) > ROOMS.index(own)):
            wrong.append(f"line {line}: {module} imports {name}")
    return wrong


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


PACKAGE = sorted((PROJECT / "shapefit").rglob("*.py"))
CLI = sorted((PROJECT / "cli").rglob("*.py"))


def assert_clean(paths: Iterable[Path], check: Callable[..., list[str]]) -> None:
    """Fail with all that a check of source and module name finds in these files."""
    findings = [
        finding
        for path in paths
        for finding in check(
            path.read_text("utf-8"), module_of(path), package=path.name == "__init__.py"
        )
    ]
    assert not findings, "\n".join(findings)


def room_name(folder: Path) -> str:
    return ".".join(folder.relative_to(PROJECT).parts)


def python_files(folder: Path) -> list[Path]:
    return [path for path in folder.glob("*.py") if path.name != "__init__.py"]


FOLDERS = sorted({path.parent for path in PACKAGE if len(python_files(path.parent))})

FEW_FILES = {
    "shapefit.core": "its sources are C++",
}
"""Folders with fewer files than a folder is worth, and why."""

SHORT = {
    "shapefit.__main__": "`python -m shapefit`",
    "shapefit.arrays": "three names that all rooms share",
}
"""Files of less than 20 lines, and why."""


def test_the_map_lists_every_room_and_folder():
    folders = {room_name(folder) for folder in FOLDERS}
    files = {"shapefit.errors", "shapefit.arrays", "shapefit.cli"}
    assert set(listed()) - files == folders - {"shapefit"}
    assert len(listed()) == len(set(listed()))
    assert ROOMS[0] == "shapefit.errors"
    assert ROOMS[-1] == "shapefit.cli"


def test_the_map_fits_one_page():
    text = (PROJECT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    lines = text.partition("## The map\n")[2].partition("\n## ")[0].splitlines()
    assert len(lines) <= 60
    assert max(map(len, lines)) <= 110


def test_folders_hold_some_three_to_fifteen_files():
    counts = {room_name(folder): len(python_files(folder)) for folder in FOLDERS}
    assert {name: count for name, count in counts.items() if count > 15} == {}
    assert {name for name, count in counts.items() if count < 3} == FEW_FILES.keys()


def test_files_hold_one_idea():
    lines = {
        module_of(path): len(path.read_text("utf-8").splitlines())
        for path in PACKAGE
        if path.name != "__init__.py"
    }
    assert {name: count for name, count in lines.items() if count > 400} == {}  # about 350
    assert {name for name, count in lines.items() if count < 20} == SHORT.keys()


def wrong_folder_imports(source: str, module: str, *, package: bool = False) -> list[str]:
    """Return the imports of a folder from one that the map lists above it in the same room."""
    order = listed()

    def folder_of(name: str) -> str | None:
        found = [each for each in order if name.startswith(f"{each}.") and each.count(".") == 2]
        return found[0] if found else None

    own, wrong = folder_of(module), []
    for line, name in imports(ast.parse(source), module, package=package):
        other = folder_of(name)
        same_room = own and other and room_of(own) == room_of(other)
        if own and other and same_room and order.index(other) < order.index(own):
            wrong.append(f"line {line}: {module} imports {name}")
    return wrong


def test_folders_of_a_room_import_one_way():
    assert_clean(PACKAGE, wrong_folder_imports)


def test_an_import_against_the_order_of_folders_is_seen():
    source = "def f():\n    from shapefit.io.kinds.opening import read_shapes"
    assert len(wrong_folder_imports(source, "shapefit.io.whole.atomic")) == 1
    assert wrong_folder_imports(source, "shapefit.pipelines.fit.run") == []


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


def test_rooms_import_one_way():
    # __main__ is the command line
    files = [path for path in PACKAGE + CLI if path.name != "__main__.py"]
    assert_clean(files, upward_imports)


def test_the_package_neither_prints_nor_knows_click():
    assert_clean(PACKAGE, talk)


def test_start_up_imports_nothing_heavy():
    assert_clean([*CLI, PROJECT / "shapefit/__init__.py"], heavy_imports)


NEEDED_TO_VERIFY = ("errors", "arrays", "geometry", "io", "verification")
"""What verification may import of the package: nothing that made what it checks."""


def imports_of_the_maker(source: str, module: str, *, package: bool = False) -> list[str]:
    """Return the imports of parts of the package that verification must not know."""
    allowed = tuple(f"shapefit.{room}" for room in NEEDED_TO_VERIFY)
    return [
        f"line {line}: {module} imports {name}"
        for line, name in imports(ast.parse(source), module, package=package)
        if name.split(".")[0] == "shapefit" and not name.startswith(allowed)
    ]


def test_verification_uses_nothing_of_the_solver():
    files = sorted((PROJECT / "shapefit/verification").rglob("*.py"))
    assert_clean(files, imports_of_the_maker)


def test_an_import_of_the_solver_is_seen():
    source = "def f():\n    from shapefit.convex.spectral_norm import nuclear_norm"
    assert len(imports_of_the_maker(source, "shapefit.verification.proofs.program")) == 1


def test_verification_loads_nothing_of_the_solver():
    modules = [
        module_of(path) for path in sorted((PROJECT / "shapefit/verification").glob("[a-z]*.py"))
    ]
    source = f"import sys, {', '.join(modules)}\nprint(*sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", source], capture_output=True, text=True, check=True
    )
    rooms = {name.split(".")[1] for name in done.stdout.split() if name.startswith("shapefit.")}
    assert not rooms & {"core", "convex", "lifting", "evaluation", "pipelines"}


AGAINST_THE_ORDER = [
    ("shapefit.errors", "from shapefit.geometry import rotations"),
    ("shapefit.geometry.rotations", "import shapefit.convex.problem"),
    ("shapefit.convex.newton", "def f():\n    from shapefit.dictionary.model import Dictionary"),
    ("shapefit.config.commands.fit", "from shapefit import io"),
    ("shapefit.config.commands.fit", "from ...io import records"),
    ("shapefit.io.hdf5", "from shapefit.pipelines.fit.run import run"),
    ("shapefit.pipelines.fit.run", "import shapefit.cli.main"),
]
ALONG_THE_ORDER = [
    ("shapefit.io.hdf5", "from shapefit.config import FitConfig\nimport shapefit.errors"),
    ("shapefit.io.hdf5", "from .records import ShapeSet\nfrom shapefit import __version__"),
    ("shapefit.cli.fit", "from .report import Report"),
]


def test_an_import_against_the_order_is_seen():
    assert [s for m, s in AGAINST_THE_ORDER if len(upward_imports(s, m)) != 1] == []
    assert [s for m, s in ALONG_THE_ORDER if upward_imports(s, m)] == []


def test_talk_is_seen():
    planted = ["print(1)", "import click", "from click import echo"]
    assert [s for s in planted if len(talk(s, "shapefit.io.hdf5")) != 1] == []


HEAVY = [
    "import numpy as np",
    "from shapefit.config import load_config",
    "from shapefit import config",
    "class A:\n    import scipy.linalg",
    "if x:\n    from tqdm import tqdm",
]
LET_THROUGH = [
    "import click\nimport importlib.metadata\nfrom collections.abc import Iterator",
    "from shapefit.errors import InputError\nfrom shapefit import __version__",
    "from .report import Report",
    "def f():\n    import numpy",
    "if TYPE_CHECKING:\n    from shapefit.config import FitConfig",
]


def test_a_heavy_import_is_seen():
    assert [s for s in HEAVY if len(heavy_imports(s, "shapefit.cli.fit")) != 1] == []
    assert [s for s in LET_THROUGH if heavy_imports(s, "shapefit.cli.fit")] == []
