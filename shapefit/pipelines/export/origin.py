"""What a result says of the fit that made it: its config, and where its dictionary is."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from shapefit.dictionary.model import Dictionary
from shapefit.errors import InputError
from shapefit.io import digest, read_dictionary
from shapefit.stores import location


def fit_config(attributes: Mapping[str, Any]) -> dict[str, Any]:
    """Return the config of the fit, as far as the attributes of the result say."""
    try:
        config = json.loads(str(attributes.get("config", "{}")))
    except ValueError:
        return {}
    return config if isinstance(config, dict) else {}


def fit_dictionary(attributes: Mapping[str, Any]) -> tuple[Path | None, Dictionary | str]:
    """Return where the dictionary of the fit is, and it, or "" or words why it cannot be had."""
    stated = fit_config(attributes).get("dictionary")
    if not isinstance(stated, str):
        return None, ""
    path = location(stated)
    try:
        if digest(path) in str(attributes.get("inputs", "")):
            return path, read_dictionary(path)
        return path, "has changed since the fit"
    except (InputError, OSError):
        return path, "no longer exists"
