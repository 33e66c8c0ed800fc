"""The wheel: complete, and at work without a compiler and without the checkout."""

import os
import shlex
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path, PurePosixPath

import pytest

PACKAGES = {"shapefit": "shapefit", "shapefit/configs": "configs", "shapefit/cli": "cli"}
"""Folder in the wheel -> folder here."""
SOURCES = {".cpp", ".hpp"}

pytestmark = pytest.mark.slow

IMPORT_ALL = """
import importlib, pkgutil, shapefit
for module in pkgutil.walk_packages(shapefit.__path__, shapefit.__name__ + "."):
    importlib.import_module(module.name)
print(shapefit.__file__)
"""


@pytest.fixture(scope="module")
def wheel(project: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the wheel where the editable install was built, so that nothing compiles twice."""
    folder = tmp_path_factory.mktemp("wheel")
    subprocess.run(
        [sys.executable, "-m", "pip", "wheel", "--quiet", "--disable-pip-version-check",
         "--no-deps", "--no-build-isolation", "-C", "build-dir=build/{wheel_tag}",
         "--wheel-dir", str(folder), str(project)],
        check=True,
    )  # fmt: skip
    (built,) = folder.glob("shapefit-*.whl")
    return built


@pytest.fixture(scope="module")
def environment(project: Path, wheel: Path) -> dict[str, str]:
    """Variables of an environment with the wheel in it, and nothing else on the path."""
    folder = wheel.with_name("environment")
    install = str(project / "tools/second_install.py")
    subprocess.run([sys.executable, install, str(folder), str(wheel)], check=True)
    retained = {name: os.environ[name] for name in ("HOME", "LANG") if name in os.environ}
    assert not shutil.which("c++", path=str(folder / "bin"))
    return {**retained, "PATH": str(folder / "bin")}


def run(command: list[str], environment: dict[str, str], folder: Path) -> str:
    program = shutil.which(command[0], path=environment["PATH"])
    assert program, f"no {command[0]} in the environment"
    done = subprocess.run(
        [program, *command[1:]], cwd=folder, env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, f"{shlex.join(command)}\n{done.stderr}"
    return done.stdout


def test_the_wheel_has_every_file_but_the_sources_of_the_core(project: Path, wheel: Path):
    here = {
        (target / path.relative_to(project / source)).as_posix()
        for target, source in ((Path(name), folder) for name, folder in PACKAGES.items())
        for path in (project / source).rglob("*")
        if path.is_file() and path.suffix not in SOURCES and path.name != "CMakeLists.txt"
        if "__pycache__" not in path.parts
    }
    packed = {PurePosixPath(name) for name in zipfile.ZipFile(wheel).namelist()}
    installed = {str(name) for name in packed if not name.parts[0].endswith(".dist-info")}
    modules = {name.partition(".")[0] for name in installed - here}
    assert "shapefit/core/_processor" in modules
    assert all(
        name.startswith(("shapefit/core/_processor", "shapefit/core/_core_")) for name in modules
    )
    assert not sorted(here - installed)


def test_names_stand_for_the_installed_configs(project: Path, environment, tmp_path: Path):
    for name in ("cars.h5", "cars_views.h5"):
        shutil.copy(project / "sample_data" / name, tmp_path)
    line = "shapefit learn-dict -c cars cars.h5 -o out/atoms.h5"
    run(shlex.split(line), environment, tmp_path)
    line = "python -P -m shapefit fit -c cars cars_views.h5 -d out/atoms.h5 -o out/shapes.csv"
    run(shlex.split(line), environment, tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["cars.h5", "cars_views.h5", "out"]
    assert (tmp_path / "out/shapes.csv").read_text(encoding="utf-8").count("\n") > 108


def test_every_module_imports_from_the_wheel(wheel: Path, environment, tmp_path: Path):
    (where,) = run(["python", "-P", "-c", IMPORT_ALL], environment, tmp_path).splitlines()
    assert Path(where).is_relative_to(wheel.parent)
