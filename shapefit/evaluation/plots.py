"""The errors of all images, sorted, a line for each method: an SVG, written without a
library.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from html import escape

import numpy as np

from shapefit.arrays import Floats

# Okabe and Ito 2008: distinguishable with every common form of colour blindness.
COLOURS = (
    "#0072B2",
    "#E69F00",
    "#009E73",
    "#CC79A7",
    "#56B4E9",
    "#D55E00",
    "#000000",
    "#F0E442",
)
POINTS = 1000
"""Of a line, at most."""
WIDTH, HEIGHT, LEFT, TOP, LINE = 640, 400, 70, 40, 20
"""Pixels of the axes and their place, and of a line of the legend."""


def draw_errors(title: str, unit: str, errors: Mapping[str, Floats]) -> str:
    """Draw errors (n,) by method, nan = failed, sorted over the share of the images.

    Where images failed the line of their method ends early.
    """
    finite = {
        name: np.sort(values[~np.isnan(values)]) for name, values in errors.items()
    }
    largest = (
        max((values[-1] for values in finite.values() if len(values)), default=0.0)
        or 1.0
    )
    middle, below, label = TOP + HEIGHT / 2, TOP + HEIGHT + 60, f"error ({unit})"
    parts = [
        _text(LEFT, TOP - 14, escape(title), "start"),
        _text(LEFT + WIDTH / 2, TOP + HEIGHT + 38, "images (%), sorted by error"),
        (
            '<g transform="rotate(-90 18'
            f' {middle})">{_text(18, middle, escape(label))}</g>'
        ),
    ]
    for value in _ticks(largest):
        y = TOP + HEIGHT * (1 - value / largest)
        parts.append(f'<path d="M{LEFT} {y:.1f}h{WIDTH}" stroke="#ddd"/>')
        parts.append(_text(LEFT - 6, y + 4, f"{value:.6g}", "end"))
    for share in range(0, 101, 20):
        x = LEFT + WIDTH * share / 100
        parts.append(f'<path d="M{x:.1f} {TOP}v{HEIGHT}" stroke="#ddd"/>')
        parts.append(_text(x, TOP + HEIGHT + 18, str(share)))
    for number, (name, values) in enumerate(finite.items()):
        colour, y = COLOURS[number % len(COLOURS)], below + LINE * number
        every = np.unique(np.linspace(0, len(values) - 1, POINTS).astype(int))[
            : len(values)
        ]
        across = LEFT + WIDTH * (every + 0.5) / max(len(errors[name]), 1)
        down = TOP + HEIGHT * (1 - values[every] / largest)
        line = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(across, down, strict=True))
        parts.append(f'<polyline points="{line}" fill="none" stroke="{colour}"/>')
        parts.append(f'<path d="M{LEFT} {y}h24" stroke="{colour}" stroke-width="3"/>')
        parts.append(_text(LEFT + 32, y + 4, escape(name), "start"))
    size = f'width="{WIDTH + LEFT + 20}" height="{below + LINE * len(errors)}"'
    head = f'<svg xmlns="http://www.w3.org/2000/svg" {size} font-family="sans-serif"'
    back = '<rect width="100%" height="100%" fill="#fff"/>'
    return "\n".join([f'{head} font-size="12">', back, *parts, "</svg>\n"])


def _ticks(largest: float) -> Floats:
    """Return round numbers from 0 to the largest, five to ten of them."""
    power = 10.0 ** math.floor(math.log10(largest))
    step = next(
        power * part for part in (0.1, 0.2, 0.5, 1) if largest / (power * part) <= 10
    )
    return np.asarray(step * np.arange(int(largest / step * (1 + 1e-9)) + 1))


def _text(x: float, y: float, text: str, anchor: str = "middle") -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{text}</text>'
