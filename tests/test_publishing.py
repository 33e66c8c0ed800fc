"""What a release says of itself agrees, and what runs elsewhere is well formed."""

import ast
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from ruamel.yaml import YAML

from shapefit import __version__


def load(path: Path) -> dict:
    return YAML(typ="safe").load(path.read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def package(project: Path) -> dict:
    return tomllib.loads((project / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def test_every_place_names_the_same_version(project: Path):
    newest = re.search(r"^## ([\d.]+) \(([\d-]+)\)", (project / "CHANGELOG.md").read_text(), re.M)
    citation = load(project / "CITATION.cff")
    assert newest.groups() == (__version__, str(citation["date-released"]))
    assert citation["version"] == __version__
    assert load(project / "building/recipe.yaml")["context"]["version"] == __version__


def test_the_conda_package_needs_what_the_wheel_needs(project: Path, package: dict):
    names = {"matplotlib": "matplotlib-base"}
    wanted = package["dependencies"] + package["optional-dependencies"]["plots"]
    recipe = load(project / "building/recipe.yaml")["requirements"]["run"]
    pairs = [re.fullmatch(r"([\w.-]+)>=(.*)", line).groups() for line in wanted]
    expected = {f"{names.get(name, name)} >={version}" for name, version in pairs}
    assert set(recipe) == expected | {f"python {package['requires-python']}"}


def test_a_commit_is_linted_by_the_pinned_ruff(project: Path):
    pinned = re.search(r"^ruff==\S+", (project / "constraints.txt").read_text(), re.M).group()
    (repository,) = load(project / ".pre-commit-config.yaml")["repos"]
    assert {tuple(hook["additional_dependencies"]) for hook in repository["hooks"]} == {(pinned,)}


def test_the_quick_tests_run_on_every_system_and_python(project: Path, package: dict):
    matrix = load(project / ".github/workflows/tests.yml")["jobs"]["quick"]["strategy"]["matrix"]
    assert matrix["python"] == ["3.11", "3.12", "3.13", "3.14"]
    assert f">={matrix['python'][0]}" == package["requires-python"]
    assert {name.split("-")[0] for name in matrix["system"]} == {"ubuntu", "macos", "windows"}


def test_docstrings_are_text_for_every_python(project: Path):
    """From Python 3.13 on, no module compiles with half of a surrogate pair in a docstring."""
    for path in (*project.glob("shapefit/**/*.py"), *project.glob("cli/*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
                (ast.get_docstring(node) or "").encode()


def test_commands_of_workflows_name_what_exists(project: Path):
    made = set(re.findall(r"^([\w-]+):", (project / "Makefile").read_text(), re.M))
    for path in (project / ".github/workflows").glob("*.yml"):
        text = path.read_text(encoding="utf-8")
        for targets in re.findall(r"run: make ([\w -]+)$", text, re.M):
            assert set(targets.split()) <= made, path.name
        for name in re.findall(r"(?:configs|sample_data)/[\w/.-]+", text):
            assert (project / name).exists(), f"{path.name}: {name}"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("schema", "pattern"),
    [
        ("github-workflows", ".github/workflows/*.yml"),
        ("github-issue-forms", ".github/ISSUE_TEMPLATE/[bf]*.yml"),
        ("github-issue-config", ".github/ISSUE_TEMPLATE/config.yml"),
        ("citation-file-format", "CITATION.cff"),
    ],
)
def test_files_for_the_host_of_the_code_are_well_formed(project: Path, schema: str, pattern: str):
    files = [str(path) for path in project.glob(pattern)]
    assert files
    check = [sys.executable, "-m", "check_jsonschema", "--builtin-schema", f"vendor.{schema}"]
    done = subprocess.run([*check, *files], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("system", ["linux", "macos", "windows"])
def test_wheels_for_two_interfaces_serve_all_pythons(project: Path, system: str):
    """3.11 has a wheel of its own; that of 3.12, in the stable ABI, serves all later versions."""
    command = [sys.executable, "-m", "cibuildwheel", "--print-build-identifiers"]
    done = subprocess.run(
        [*command, "--platform", system, str(project)], capture_output=True, text=True, check=True
    )
    assert {name.split("-")[0] for name in done.stdout.split()} == {"cp311", "cp312"}


@pytest.mark.slow
def test_no_link_of_the_site_leads_nowhere(project: Path):
    """The builder is strict: a page, an anchor or a picture that is absent ends it."""
    site = [sys.executable, str(project / "building/site.py")]
    done = subprocess.run(site, cwd=project, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    html = project / "build/site/html"
    assert "read_landmarks" in (html / "docs/api/index.html").read_text(encoding="utf-8")
    assert (html / "sample.html").stat().st_size > 10_000
    assert (html / "search/search_index.json").is_file()
