"""The smallest ratios that a run may have, by release before, instruction set and case."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path

FILE = Path(__file__).with_name("floors.toml")
HEADER = """\
# The ratio below which `make bench` fails, for each case, by the release before and the instruction
# set: a fifth under the median measured. Written by `make bench BENCH_OPTIONS=--write-floors`.
"""
MARGIN = 0.8

Floors = dict[str, dict[str, dict[str, float]]]


def read_floors() -> Floors:
    """Return floors by base, level and case."""
    return tomllib.loads(FILE.read_text(encoding="utf-8")) if FILE.is_file() else {}


def write_floors(base: str, level: str, ratios: Mapping[str, float]) -> None:
    """Set the floors of the cases measured against a base at a level; the others stay."""
    floors = read_floors()
    cases = floors.setdefault(base, {}).setdefault(level, {})
    cases |= {case: float(f"{MARGIN * ratio:.3g}") for case, ratio in ratios.items()}
    text = HEADER
    for name, levels in sorted(floors.items()):
        for rung, values in sorted(levels.items()):
            text += f'\n["{name}".{rung}]\n'
            text += "".join(f'"{case}" = {floor:g}\n' for case, floor in values.items())
    FILE.write_text(text, encoding="utf-8")
