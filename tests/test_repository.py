"""What no linter sees: generated pages, links, and what several files say of one release."""

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


def test_generated_pages_are_in_step():
    spec = importlib.util.spec_from_file_location("generate", DOCS.parent / "tools/generate.py")
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
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_links_resolve_and_the_index_reaches_every_page():
    broken = [link for page in PAGES for link in broken_links(page)]
    assert not broken, "\n".join(broken)
    linked = set(re.findall(r"\]\(([\w.-]+\.md)", text_of("docs/README.md")))
    assert {path.name for path in DOCS.glob("*.md")} - {"README.md"} == linked


def test_commands_of_readme_and_workflows_name_what_exists(readme_commands):
    targets = set(re.findall(r"^([\w-]+):", text_of("Makefile"), re.MULTILINE))
    wanted = set(re.findall(r"`make ([a-z-]+)", text_of("README.md")))
    wanted |= {command.split()[1] for command in readme_commands if command.startswith("make ")}
    assert wanted <= targets
    for path in (PROJECT / ".github/workflows").glob("*.yml"):
        text = path.read_text(encoding="utf-8")
        for named in re.findall(r"run: make ([\w -]+)$", text, re.MULTILINE):
            assert set(named.split()) <= targets, path.name
        for name in re.findall(r"(?:configs|sample_data)/[\w/.-]+", text):
            assert (PROJECT / name).exists(), f"{path.name}: {name}"


def test_every_place_names_the_same_version_and_the_same_needs():
    newest = re.search(r"^## ([\d.]+) \(([\d-]+)\)", text_of("CHANGELOG.md"), re.MULTILINE)
    citation, recipe = load("CITATION.cff"), load("tools/recipe.yaml")
    assert newest.groups() == (__version__, str(citation["date-released"]))
    assert citation["version"] == recipe["context"]["version"] == __version__
    package = tomllib.loads(text_of("pyproject.toml"))["project"]
    wanted = package["dependencies"] + package["optional-dependencies"]["plots"]
    pairs = [re.fullmatch(r"([\w.-]+)>=(.*)", line).groups() for line in wanted]
    names = {"matplotlib": "matplotlib-base"}
    needs = {f"{names.get(name, name)} >={version}" for name, version in pairs}
    needs.add(f"python {package['requires-python']}")
    assert set(recipe["requirements"]["run"]) == needs
    pinned = re.search(r"^ruff==\S+", text_of("constraints.txt"), re.MULTILINE).group()
    (repository,) = load(".pre-commit-config.yaml")["repos"]
    assert {tuple(hook["additional_dependencies"]) for hook in repository["hooks"]} == {(pinned,)}


@pytest.mark.slow
def test_no_link_of_the_site_leads_nowhere():
    """The builder is strict: a page, an anchor or a picture that is absent ends it."""
    site = [sys.executable, str(PROJECT / "tools/site.py")]
    done = subprocess.run(site, cwd=PROJECT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    html = PROJECT / "build/site/html"
    assert "read_landmarks" in (html / "docs/api/index.html").read_text(encoding="utf-8")
    assert (html / "search/search_index.json").is_file()
