"""Generated pages say what the code says; links of all pages resolve."""

import importlib.util
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from pydantic import BaseModel

from shapefit.config import CONFIGS
from shapefit.config.model import field_keys, meaning, submodel

DOCS = Path(__file__).resolve().parents[1] / "docs"


@pytest.fixture(scope="module")
def pages() -> dict[Path, str]:
    spec = importlib.util.spec_from_file_location("generate", DOCS / "generate.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.pages()


def test_generated_pages_are_in_step(pages):
    assert {path.name for path in pages} == {"config.md", "commands.md"}
    for path, text in pages.items():
        assert path.read_text(encoding="utf-8") == text, "run `make docs`"


def fields(model: type[BaseModel], prefix: str = "") -> Iterator[tuple[str, str | None]]:
    for key, field in field_keys(model).items():
        yield prefix + key, meaning(model, key)
        inner = submodel(field)
        if inner is not None:
            yield from fields(inner, f"{prefix}{key}.")


def test_every_key_is_described():
    """A description is a sentence."""
    described = {
        f"{command}: {key}": description
        for command, model in CONFIGS.items()
        for key, description in fields(model)
    }
    assert len(described) > 100
    wrong = {key for key, text in described.items() if not (text or "").endswith(".")}
    assert wrong == set()


def test_every_command_is_on_the_page(pages):
    for command in CONFIGS:
        assert f"## `{command}`" in pages[DOCS / "commands.md"]
        assert f"## `{command}`" in pages[DOCS / "config.md"]


PROJECT = DOCS.parent
PAGES = sorted(
    path.relative_to(PROJECT)
    for pattern in ("*.md", "docs/*.md", "benchmarks/**/*.md", "sample_data/*.md")
    for path in PROJECT.glob(pattern)
)
CODE = re.compile(r"^```[\s\S]*?^```|^ {4,}.*$|`[^`\n]*`", re.MULTILINE)


def anchors(text: str) -> set[str]:
    """Return the anchors of the headings of a page, as GitHub makes them."""
    headings = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def broken_links(page: Path) -> Iterator[str]:
    """Yield the links of a page whose file or heading is not there."""
    text = CODE.sub("", (PROJECT / page).read_text(encoding="utf-8"))
    for link in re.findall(r"\]\(([^)\s]+)\)", text):
        target, _, anchor = link.partition("#")
        path = (PROJECT / page).parent / target if target else PROJECT / page
        if "://" in target:
            continue
        if not path.exists() or (anchor and anchor not in anchors(path.read_text("utf-8"))):
            yield f"{page} links to {link}"


def test_links_resolve():
    broken = [link for page in PAGES for link in broken_links(page)]
    assert not broken, "\n".join(broken)


def test_the_index_reaches_every_page():
    index = (DOCS / "README.md").read_text(encoding="utf-8")
    linked = set(re.findall(r"\]\(([\w.]+\.md)", index))
    assert {path.name for path in DOCS.glob("*.md")} - {"README.md"} == linked
