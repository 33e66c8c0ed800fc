"""What the linker could mix up: the objects of the levels, as they lie in the build folder.

The linker keeps one of several equal weak symbols. An inline function that two levels compile under
one name would run with the instructions of the wrong level, on processors that lack them too.
"""

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from shapefit import core

LEVEL_FOLDER = re.compile(r"CMakeFiles/(x86_64_v\d|plain)\.dir/")


@pytest.fixture(scope="module")
def build_folder(project: Path) -> Path:
    folders = [path.parent for path in project.glob("build/*/compile_commands.json")]
    if not folders:
        pytest.skip("the core was not built in this checkout")
    return max(folders, key=lambda folder: (folder / "compile_commands.json").stat().st_mtime)


@pytest.fixture(scope="module")
def compiled(build_folder: Path) -> dict[Path, str]:
    """Return the objects of the kernels, each with its command."""
    entries = json.loads((build_folder / "compile_commands.json").read_text(encoding="utf-8"))
    ours = {build_folder / entry["output"]: entry["command"] for entry in entries}
    return {path: command for path, command in ours.items() if LEVEL_FOLDER.search(str(path))}


def level_of(path: Path) -> str:
    found = LEVEL_FOLDER.search(str(path))
    assert found
    return found[1]


def test_every_level_has_objects(compiled):
    assert set(map(level_of, compiled)) >= set(core.LEVELS)


def test_each_level_defines_names_of_its_own_only(compiled):
    nm = shutil.which("nm")
    if nm is None:
        pytest.skip("no nm")
    seen = 0
    for path in compiled:
        level = level_of(path)
        own = f"8shapefit{len(level)}{level}"  # as C++ compilers write shapefit::<level>
        command = [nm, "--extern-only", "--defined-only", "--format=posix", str(path)]
        listed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
        names = [line.split()[0] for line in listed.splitlines()]
        seen += len(names)
        # DW.ref: where exceptions find the runtime's handler, the same data in every object
        foreign = [name for name in names if own not in name and not name.startswith("DW.ref.")]
        shown = subprocess.run(["c++filt", *foreign], capture_output=True, text=True).stdout
        assert not foreign, f"{path.name} of {level} defines\n{shown}"
    assert seen >= len(compiled)


def test_each_level_has_its_instructions_and_none_those_of_this_machine(compiled):
    for path, command in compiled.items():
        level = level_of(path)
        wanted = [] if level == "plain" else [f"-march={level.replace('_', '-')}"]
        assert re.findall(r"-march=\S+|-mcpu=\S+|-mtune=native", command) == wanted
