"""The release: pages in step, links, versions, the sample data, the gallery and the
wheel.
"""

import importlib.util
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
import zipfile
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

import numpy as np
import pytest
import trimesh
from ruamel.yaml import YAML

from shapefit import __version__
from shapefit.config import CONFIGS
from shapefit.io import read_shapes
from tests.io.files import load as load_records

PROJECT = Path(__file__).resolve().parents[1]
DOCS = PROJECT / "docs"
PAGES = sorted(
    path.relative_to(PROJECT)
    for pattern in ("*.md", "docs/*.md", "benchmarks/**/*.md", "sample_data/*.md")
    for path in PROJECT.glob(pattern)
)
CODE = re.compile(r"^```[\s\S]*?^```|^ {4,}.*$|`[^`\n]*`", re.MULTILINE)


def load(name: str) -> dict:
    return YAML(typ="safe").load((PROJECT / name).read_text(encoding="utf-8"))


def text_of(name: str | Path) -> str:
    return (PROJECT / name).read_text(encoding="utf-8")


def test_generated_pages_are_in_step():
    spec = importlib.util.spec_from_file_location(
        "generate", DOCS.parent / "tools/generate.py"
    )
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    pages = module.pages()
    assert {path.name for path in pages} == {"config.md", "commands.md"}
    for path, text in pages.items():
        assert path.read_text(encoding="utf-8") == text, "run `make docs`"
        assert all(f"## `{command}`" in text for command in CONFIGS)


def broken_links(page: Path) -> Iterator[str]:
    """Yield the links of a page whose file or heading is not there."""
    for link in re.findall(r"\]\(([^)\s]+)\)", CODE.sub("", text_of(page))):
        target, _, anchor = link.partition("#")
        path = (PROJECT / page).parent / target if target else PROJECT / page
        if "://" in target:
            continue
        if not path.exists() or (anchor and anchor not in anchors(path)):
            yield f"{page} links to {link}"


def anchors(path: Path) -> set[str]:
    """Return the anchors of the headings of a page, as GitHub makes them."""
    headings = re.findall(r"^#+ (.*)$", path.read_text(encoding="utf-8"), re.MULTILINE)
    return {
        re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")
        for heading in headings
    }


def test_links_resolve_and_the_index_reaches_every_page():
    broken = [link for page in PAGES for link in broken_links(page)]
    assert not broken, "\n".join(broken)
    linked = set(re.findall(r"\]\(([\w.-]+\.md)", text_of("docs/README.md")))
    assert {path.name for path in DOCS.glob("*.md")} - {"README.md"} == linked


def test_commands_of_readme_and_workflows_name_what_exists(readme_commands):
    targets = set(re.findall(r"^([\w-]+):", text_of("Makefile"), re.MULTILINE))
    wanted = set(re.findall(r"`make ([a-z-]+)", text_of("README.md")))
    wanted |= {
        command.split()[1] for command in readme_commands if command.startswith("make ")
    }
    assert wanted <= targets
    for path in (PROJECT / ".github/workflows").glob("*.yml"):
        text = path.read_text(encoding="utf-8")
        for named in re.findall(r"run: make ([\w -]+)$", text, re.MULTILINE):
            assert set(named.split()) <= targets, path.name
        for name in re.findall(r"(?:configs|sample_data)/[\w/.-]+", text):
            assert (PROJECT / name).exists(), f"{path.name}: {name}"


def test_every_place_names_the_same_version_and_the_same_needs():
    newest = re.search(
        r"^## ([\d.]+) \(([\d-]+)\)", text_of("CHANGELOG.md"), re.MULTILINE
    )
    citation = load("CITATION.cff")
    recipe = load("tools/recipe.yaml")
    assert newest.groups() == (__version__, str(citation["date-released"]))
    assert citation["version"] == recipe["context"]["version"] == __version__
    package = tomllib.loads(text_of("pyproject.toml"))["project"]
    wanted = package["dependencies"] + package["optional-dependencies"]["plots"]
    pairs = [re.fullmatch(r"([\w.-]+)>=(.*)", line).groups() for line in wanted]
    names = {"matplotlib": "matplotlib-base"}
    needs = {f"{names.get(name, name)} >={version}" for name, version in pairs}
    needs.add(f"python {package['requires-python']}")
    assert set(recipe["requirements"]["run"]) == needs
    pinned = text_of("constraints.txt").splitlines()
    (repository,) = load(".pre-commit-config.yaml")["repos"]
    used = {
        package
        for hook in repository["hooks"]
        for package in hook.get("additional_dependencies", [])
    }
    assert {package.partition("==")[0] for package in used} == {"ruff", "clang-format"}
    assert used <= set(pinned)


@pytest.mark.slow
def test_no_link_of_the_site_leads_nowhere():
    """The builder is strict: a page, an anchor or a picture that is absent ends it."""
    site = [sys.executable, str(PROJECT / "tools/site.py")]
    done = subprocess.run(
        site, cwd=PROJECT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    html = PROJECT / "build/site/html"
    assert "read_landmarks" in (html / "docs/api/index.html").read_text(
        encoding="utf-8"
    )
    assert (html / "search/search_index.json").is_file()


ROUNDING = 1e-5
FOCAL_LENGTH, PRINCIPAL_POINT = 1600.0, np.array([640.0, 480.0])


@pytest.fixture(scope="module")
def samples(project):
    return project / "sample_data"


@pytest.fixture(scope="module")
def cars(samples):
    return read_shapes([samples / "cars.h5"])


def test_every_mesh_is_closed_and_wound_outward(cars):
    assert cars.mesh_vertices.shape[1] >= 1000
    for vertices in cars.mesh_vertices:
        mesh = trimesh.Trimesh(vertices, cars.mesh_faces, process=False)
        assert np.isfinite(mesh.vertices).all()
        assert mesh.is_watertight
        assert mesh.is_winding_consistent
        assert mesh.area_faces.min() > 1e-7
        parts = mesh.split(only_watertight=False)
        assert len(parts) == 9  # the body, four wheels, two mirrors, two plates
        assert all(part.volume > 0 for part in parts)
        assert 5 < mesh.volume < 15


def test_views_are_pictures_of_the_cars_under_their_true_rotation(samples, cars):
    views = load_records(samples / "cars_views.h5")
    assert len(views) == 108
    assert views.unit == "px"
    assert views.y_axis == "down"
    assert views.landmark_names == cars.landmark_names
    centre = np.append(PRINCIPAL_POINT, 1)
    expected = np.diag([FOCAL_LENGTH, FOCAL_LENGTH, 0]) + np.outer(centre, [0, 0, 1])
    np.testing.assert_allclose(views.column("camera_matrix"), expected)
    R = views.column("true_rotation").astype(float)
    np.testing.assert_allclose(np.linalg.det(R), 1, atol=1e-5)
    for view, model in enumerate(views.column("true_model")):
        x, y, z = R[view] @ cars.as_columns()[cars.items.index(model)]
        u, v = (views.as_columns()[view] - PRINCIPAL_POINT[:, None]) / FOCAL_LENGTH
        visible = np.isfinite(u)
        # u (z + tz) = x + tx and v (z + tz) = y + ty, linear in the translation (tx,
        # ty, tz).
        one = np.ones(visible.sum())
        zero = np.zeros(visible.sum())
        A = np.concatenate(
            [
                np.stack([one, zero, -u[visible]], axis=1),
                np.stack([zero, one, -v[visible]], axis=1),
            ]
        )
        b = np.concatenate([(u * z - x)[visible], (v * z - y)[visible]])
        translation = np.linalg.lstsq(A, b, rcond=None)[0]
        assert 8.5 < translation[2] < 15.5
        told = views.column("true_translation")[view]
        np.testing.assert_allclose(translation, told, atol=0.01 * translation[2])
        pixels = FOCAL_LENGTH * (A @ translation - b) / translation[2]
        assert np.sqrt((pixels**2).mean()) < 1


WRITTEN = {
    "openpose_to_opensim.sh": ["walk_person_1.trc", "walk_person_2.mot", "page.html"],
    "animal_from_deeplabcut.sh": ["walk.h5", "report/report.html", "page.html"],
    "mediapipe.py": ["walk.h5", "left_ankle.csv"],
    "cars_to_blender.sh": ["meshes/sedan_1/view_1.glb", "sheet.png", "page.html"],
    "python_arrays.py": ["ankles.png"],
}
"""Script -> some of the files that it writes."""


def test_every_script_has_a_picture(project):
    from PIL import Image

    folder = project / "docs/gallery"
    others = {"README.md", "notebook.ipynb"}
    assert {path.name for path in folder.iterdir()} == {*WRITTEN, *others}
    for script in WRITTEN:
        picture = project / "docs/images/gallery" / f"{script.partition('.')[0]}.webp"
        assert Image.open(picture).width == 1000
        assert picture.stat().st_size < 200_000


@pytest.mark.slow
@pytest.mark.parametrize("script", WRITTEN)
def test_a_script_runs(script, tmp_path):
    from tools.page_pictures import run_script

    run_script(script, tmp_path)
    for name in WRITTEN[script]:
        assert (tmp_path / name).stat().st_size > 0


@pytest.mark.slow
def test_the_notebook_runs_and_shows_a_fit_a_plot_and_a_page(project, tmp_path):
    """As the site shows it; the clone has it without outputs."""
    import nbformat

    from tools.site import run_notebook

    source = project / "docs/gallery/notebook.ipynb"
    cells = nbformat.read(source, as_version=4).cells
    assert not any(cell.get("outputs") for cell in cells)
    run_notebook(source, tmp_path / "run.ipynb")
    outputs = {
        cell.id: [output.get("data", {}) for output in cell.outputs]
        for cell in nbformat.read(tmp_path / "run.ipynb", as_version=4).cells
        if cell.cell_type == "code"
    }
    assert "<svg" in outputs["fit"][-1]["text/html"]
    assert "image/png" in outputs["plot"][-1]
    assert "image/png" in outputs["ankles"][-1]
    assert "<th>trusted</th>" in outputs["table"][-1]["text/html"]
    assert outputs["view"][-1]["text/html"].startswith('<iframe sandbox="allow-scripts')


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
    subprocess.run(
        [
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
        ],
        check=True,
    )
    (built,) = folder.glob("shapefit-*.whl")
    return built


@pytest.fixture(scope="module")
def environment(project: Path, wheel: Path) -> dict[str, str]:
    """Variables of an environment with the wheel in it, and nothing else on the
    path.
    """
    folder = wheel.with_name("environment")
    install = str(project / "tools/second_install.py")
    subprocess.run([sys.executable, install, str(folder), str(wheel)], check=True)
    retained = {
        name: os.environ[name] for name in ("HOME", "LANG") if name in os.environ
    }
    assert not shutil.which("c++", path=str(folder / "bin"))
    return {**retained, "PATH": str(folder / "bin")}


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
    here = {
        (target / path.relative_to(project / source)).as_posix()
        for target, source in (
            (Path(name), folder) for name, folder in PACKAGES.items()
        )
        for path in (project / source).rglob("*")
        if path.is_file()
        and path.suffix not in SOURCES
        and path.name != "CMakeLists.txt"
        if "__pycache__" not in path.parts
    }
    packed = {PurePosixPath(name) for name in zipfile.ZipFile(wheel).namelist()}
    installed = {
        str(name) for name in packed if not name.parts[0].endswith(".dist-info")
    }
    modules = {name.partition(".")[0] for name in installed - here}
    assert "shapefit/core/_processor" in modules
    assert all(
        name.startswith(("shapefit/core/_processor", "shapefit/core/_core_"))
        for name in modules
    )
    assert not sorted(here - installed)


@pytest.mark.slow
def test_names_stand_for_the_installed_configs(
    project: Path, environment, tmp_path: Path
):
    for name in ("cars.h5", "cars_views.h5"):
        shutil.copy(project / "sample_data" / name, tmp_path)
    line = "shapefit learn-dict -c cars cars.h5 -o out/atoms.h5"
    run(shlex.split(line), environment, tmp_path)
    line = (
        "python -P -m shapefit fit -c cars cars_views.h5 -d out/atoms.h5 -o"
        " out/shapes.csv"
    )
    run(shlex.split(line), environment, tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "cars.h5",
        "cars_views.h5",
        "out",
    ]
    assert (tmp_path / "out/shapes.csv").read_text(encoding="utf-8").count("\n") > 108


@pytest.mark.slow
def test_the_demo_needs_the_wheel_alone(wheel: Path, environment, tmp_path: Path):
    run(["shapefit", "demo", "-q"], environment, tmp_path)
    made = sorted(path.name for path in (tmp_path / "shapefit-demo").iterdir())
    assert made == ["openpose", "walk.h5", "walk.html"]
    samples = [
        packed.compress_size
        for packed in zipfile.ZipFile(wheel).infolist()
        if "sample_data" in packed.filename
    ]
    assert len(samples) == 36
    assert sum(samples) < 500_000


@pytest.mark.slow
def test_every_module_imports_from_the_wheel(wheel: Path, environment, tmp_path: Path):
    (where,) = run(
        ["python", "-P", "-c", IMPORT_ALL], environment, tmp_path
    ).splitlines()
    assert Path(where).is_relative_to(wheel.parent)
