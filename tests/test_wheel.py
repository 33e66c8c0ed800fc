"""The wheel: what is in it, and that it needs nothing else."""

import os
import shlex
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path, PurePosixPath

import pytest

PACKAGES = {
    "shapefit": "shapefit",
    "shapefit/configs": "configs",
    "shapefit/cli": "cli",
    "shapefit/sample_data/openpose": "sample_data/openpose",
}
"""Folder in the wheel -> folder here."""


SOURCES = {".cpp", ".hpp"}


IMPORT_ALL = """
import importlib, pkgutil, shapefit
for module in pkgutil.walk_packages(shapefit.__path__, shapefit.__name__ + "."):
    importlib.import_module(module.name)
print(shapefit.__file__)
"""


@pytest.fixture(scope="module")
def wheel(project: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the wheel where the editable install was built, so that nothing compiles
    twice.
    """
    folder = tmp_path_factory.mktemp("wheel")
    build = [
        sys.executable,
        "-m",
        "pip",
        "wheel",
        "--quiet",
        "--disable-pip-version-check",
        "--no-deps",
        "--no-build-isolation",
        "-C",
        "build-dir=build/{wheel_tag}",
        "--wheel-dir",
        str(folder),
        str(project),
    ]
    subprocess.run(build, check=True)
    (built,) = folder.glob("shapefit-*.whl")
    return built


@pytest.fixture(scope="module")
def environment(project: Path, wheel: Path) -> dict[str, str]:
    """Variables of an environment with the wheel in it, and nothing else on the
    path.
    """
    folder = wheel.with_name("environment")
    programs = str(folder / "bin")
    install = str(project / "tools/second_install.py")
    subprocess.run([sys.executable, install, str(folder), str(wheel)], check=True)
    assert not shutil.which("c++", path=programs)
    variables = {"PATH": programs}
    for name in ("HOME", "LANG"):
        if name in os.environ:
            variables[name] = os.environ[name]
    return variables


def files_of_the_project(project: Path) -> set[str]:
    """Return where the files of PACKAGES stand in the wheel, but for sources of the
    core.
    """
    found = set()
    for name, source in PACKAGES.items():
        folder = project / source
        for path in folder.rglob("*"):
            is_source = path.suffix in SOURCES or path.name == "CMakeLists.txt"
            if path.is_file() and not is_source and "__pycache__" not in path.parts:
                found.add(f"{name}/{path.relative_to(folder).as_posix()}")
    return found


def run(command: list[str], environment: dict[str, str], folder: Path) -> str:
    program = shutil.which(command[0], path=environment["PATH"])
    assert program, f"no {command[0]} in the environment"
    done = subprocess.run(
        [program, *command[1:]],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, f"{shlex.join(command)}\n{done.stderr}"
    return done.stdout


@pytest.mark.slow
def test_the_wheel_has_every_file_but_the_sources_of_the_core(
    project: Path, wheel: Path
):
    here = files_of_the_project(project)
    packed = [PurePosixPath(name) for name in zipfile.ZipFile(wheel).namelist()]
    is_metadata = [name.parts[0].endswith(".dist-info") for name in packed]
    installed = {
        str(name)
        for name, of_package in zip(packed, is_metadata, strict=True)
        if not of_package
    }
    modules = {name.partition(".")[0] for name in installed - here}
    assert "shapefit/core/_processor" in modules
    for name in modules:
        assert name.startswith(("shapefit/core/_processor", "shapefit/core/_core_"))
    assert not sorted(here - installed)


@pytest.mark.slow
def test_names_stand_for_the_installed_configs(
    project: Path, environment, tmp_path: Path
):
    for name in ("cars.h5", "cars_views.h5"):
        shutil.copy(project / "sample_data" / name, tmp_path)
    learn = "shapefit learn-dict -c cars cars.h5 -o out/atoms.h5"
    fit = "fit -c cars cars_views.h5 -d out/atoms.h5 -o out/shapes.csv"
    run(shlex.split(learn), environment, tmp_path)
    run(shlex.split(f"python -P -m shapefit {fit}"), environment, tmp_path)
    names = sorted(path.name for path in tmp_path.iterdir())
    table = (tmp_path / "out/shapes.csv").read_text(encoding="utf-8")
    assert names == ["cars.h5", "cars_views.h5", "out"]
    assert table.count("\n") > 108


@pytest.mark.slow
def test_the_demo_needs_the_wheel_alone(environment, tmp_path: Path):
    run(["shapefit", "demo", "-q"], environment, tmp_path)
    made = sorted(path.name for path in (tmp_path / "shapefit-demo").iterdir())
    assert made == ["openpose", "walk.h5", "walk.html"]


@pytest.mark.slow
def test_samples_in_the_wheel_are_small(wheel: Path):
    packed = zipfile.ZipFile(wheel).infolist()
    sizes = [file.compress_size for file in packed if "sample_data" in file.filename]
    assert len(sizes) == 36
    assert sum(sizes) < 500_000


@pytest.mark.slow
def test_every_module_imports_from_the_wheel(wheel: Path, environment, tmp_path: Path):
    command = ["python", "-P", "-c", IMPORT_ALL]
    (path,) = run(command, environment, tmp_path).splitlines()
    assert Path(path).is_relative_to(wheel.parent)
