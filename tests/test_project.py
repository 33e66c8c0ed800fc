"""The release: pages in step, links, versions."""

import importlib.util
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
from ruamel.yaml import YAML

from shapefit import __version__
from shapefit.config import CONFIGS

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


@pytest.fixture(scope="module")
def generator():
    """The module of `tools/generate.py`."""
    path = PROJECT / "tools/generate.py"
    spec = importlib.util.spec_from_file_location("generate", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_generated_pages_are_in_step(generator):
    pages = generator.pages()
    assert {path.name for path in pages} == {"config.md", "commands.md"}
    for path, text in pages.items():
        assert path.read_text(encoding="utf-8") == text, "run `make docs`"


@pytest.mark.parametrize("command", CONFIGS)
def test_generated_pages_have_every_command(generator, command):
    for text in generator.pages().values():
        assert f"## `{command}`" in text


def broken_links(page: Path) -> Iterator[str]:
    """Yield the links of a page whose file or heading is not there."""
    without_code = CODE.sub("", text_of(page))
    for link in re.findall(r"\]\(([^)\s]+)\)", without_code):
        target, _, anchor = link.partition("#")
        if "://" in target:
            continue
        path = (PROJECT / page).parent / target if target else PROJECT / page
        if not path.exists() or (anchor and anchor not in anchors(path)):
            yield f"{page} links to {link}"


def anchors(path: Path) -> set[str]:
    """Return the anchors of the headings of a page, as GitHub makes them."""
    text = path.read_text(encoding="utf-8")
    found = set()
    for heading in re.findall(r"^#+ (.*)$", text, re.MULTILINE):
        words = re.sub(r"[^\w\- ]", "", heading.lower())
        found.add(words.replace(" ", "-"))
    return found


def test_links_resolve():
    broken = [link for page in PAGES for link in broken_links(page)]
    assert not broken, "\n".join(broken)


def test_the_index_reaches_every_page():
    linked = set(re.findall(r"\]\(([\w.-]+\.md)", text_of("docs/README.md")))
    pages = {path.name for path in DOCS.glob("*.md")}
    assert linked == pages - {"README.md"}


@pytest.fixture(scope="module")
def targets():
    """The targets of the Makefile."""
    return set(re.findall(r"^([\w-]+):", text_of("Makefile"), re.MULTILINE))


def test_the_readme_names_targets_that_exist(targets, readme_commands):
    in_text = set(re.findall(r"`make ([a-z-]+)", text_of("README.md")))
    makes = [line for line in readme_commands if line.startswith("make ")]
    assert in_text | {line.split()[1] for line in makes} <= targets


WORKFLOWS = sorted((PROJECT / ".github/workflows").glob("*.yml"))


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.name)
def test_workflows_name_targets_and_files_that_exist(targets, path):
    text = path.read_text(encoding="utf-8")
    for named in re.findall(r"run: make ([\w -]+)$", text, re.MULTILINE):
        assert set(named.split()) <= targets
    for name in re.findall(r"(?:configs|sample_data)/[\w/.-]+", text):
        assert (PROJECT / name).exists(), name


def test_every_place_names_the_same_version():
    release = r"^## ([\d.]+) \(([\d-]+)\)"
    version, date = re.search(release, text_of("CHANGELOG.md"), re.MULTILINE).groups()
    citation = load("CITATION.cff")
    recipe = load("tools/recipe.yaml")
    assert version == __version__
    assert date == str(citation["date-released"])
    assert citation["version"] == __version__
    assert recipe["context"]["version"] == __version__


CONDA_NAMES = {"matplotlib": "matplotlib-base"}


def test_the_recipe_needs_what_the_package_needs():
    package = tomllib.loads(text_of("pyproject.toml"))["project"]
    recipe = load("tools/recipe.yaml")
    needs = {f"python {package['requires-python']}"}
    for line in package["dependencies"] + package["optional-dependencies"]["plots"]:
        name, version = re.fullmatch(r"([\w.-]+)>=(.*)", line).groups()
        needs.add(f"{CONDA_NAMES.get(name, name)} >={version}")
    assert set(recipe["requirements"]["run"]) == needs


def test_hooks_have_the_versions_of_the_constraints():
    pinned = text_of("constraints.txt").splitlines()
    (repository,) = load(".pre-commit-config.yaml")["repos"]
    used = set()
    for hook in repository["hooks"]:
        used |= set(hook.get("additional_dependencies", []))
    names = {package.partition("==")[0] for package in used}
    assert names == {"ruff", "clang-format"}
    assert used <= set(pinned)


@pytest.mark.slow
def test_no_link_of_the_site_leads_nowhere():
    """The builder is strict: a page, an anchor or a picture that is absent ends it."""
    build = [sys.executable, str(PROJECT / "tools/site.py")]
    done = subprocess.run(
        build, cwd=PROJECT, capture_output=True, text=True, check=False
    )
    html = PROJECT / "build/site/html"
    assert done.returncode == 0, done.stderr
    assert "read_landmarks" in (html / "docs/api/index.html").read_text("utf-8")
    assert (html / "search/search_index.json").is_file()
