"""The generated pages say what the code says, and leave nothing out."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from pathlib import Path

import pytest
from pydantic import BaseModel

from shapefit.config import CONFIGS
from shapefit.config.fields import field_keys, submodel

DOCS = Path(__file__).resolve().parents[1] / "docs"


@pytest.fixture(scope="module")
def pages() -> dict[Path, str]:
    spec = importlib.util.spec_from_file_location("generate", DOCS / "generate.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.pages()


@pytest.mark.parametrize("name", ["config.md", "commands.md"])
def test_a_generated_page_is_in_step(pages, name):
    path = DOCS / name
    assert path.read_text(encoding="utf-8") == pages[path], "run `make docs`"


def fields(model: type[BaseModel], prefix: str = "") -> Iterator[tuple[str, str | None]]:
    for key, field in field_keys(model).items():
        yield prefix + key, field.description
        inner = submodel(field)
        if inner is not None:
            yield from fields(inner, f"{prefix}{key}.")


KEYS = [(command, *entry) for command, model in CONFIGS.items() for entry in fields(model)]


@pytest.mark.parametrize(("command", "key", "description"), KEYS)
def test_every_key_is_described(command, key, description):
    assert description, f"{command}: {key} has no description"
    assert description.endswith("."), f"{command}: {key}: a description is a sentence"


def test_every_command_is_on_the_page(pages):
    for command in CONFIGS:
        assert f"## `{command}`" in pages[DOCS / "commands.md"]
        assert f"## `{command}`" in pages[DOCS / "config.md"]
