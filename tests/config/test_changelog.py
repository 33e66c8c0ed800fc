"""The changelog names every key that went."""

from __future__ import annotations

from pathlib import Path

import pytest

from shapefit.config.old_keys import OLD_KEYS, OLD_VALUES

CHANGES = Path(__file__).resolve().parents[2].joinpath("CHANGELOG.md").read_text(encoding="utf-8")

GONE = {key for gone in OLD_KEYS.values() for key in gone}
GONE |= {f"{key}: {value}" for gone in OLD_VALUES.values() for key, value in gone}


@pytest.mark.parametrize("name", sorted(GONE))
def test_the_changelog_names_what_went(name):
    named = CHANGES.replace("project.", "")
    assert any(f"`{name}{end}" in named for end in ("`", ".", ": true`")), name
