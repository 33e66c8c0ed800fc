"""The errors of all images, sorted, a line for each method: an SVG, written by hand."""

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

MAX_LINE_POINTS = 1000
"""Of a line."""

# In pixels.

AXES_WIDTH = 640
AXES_HEIGHT = 400

AXES_LEFT = 70
"""Left border of the axes."""

AXES_TOP = 40
"""Upper border of the axes."""

LEGEND_TOP = AXES_TOP + AXES_HEIGHT + 60
"""Middle of the first line of the legend."""

LEGEND_LINE = 20
"""Height of a line of the legend."""


def draw_errors(title: str, unit: str, errors: Mapping[str, Floats]) -> str:
    """Return an SVG of the sorted errors (n,) of each method, nan for failed images.

    Errors lie over the share of the images. Where images failed the line of their
    method ends early.
    """
    finite = {
        name: np.sort(values[~np.isnan(values)]) for name, values in errors.items()
    }
    worst = [values[-1] for values in finite.values() if len(values)]
    largest = max(worst, default=0.0) or 1.0
    parts = _axis_labels(title, f"error ({unit})") + _grid(largest)
    for number, (name, values) in enumerate(finite.items()):
        colour = COLOURS[number % len(COLOURS)]
        line = _line(values, len(errors[name]), largest)
        parts.append(f'<polyline points="{line}" fill="none" stroke="{colour}"/>')
        y = LEGEND_TOP + LEGEND_LINE * number
        parts.append(
            f'<path d="M{AXES_LEFT} {y}h24" stroke="{colour}" stroke-width="3"/>'
        )
        parts.append(_text(AXES_LEFT + 32, y + 4, escape(name), "start"))
    width = AXES_WIDTH + AXES_LEFT + 20
    height = LEGEND_TOP + LEGEND_LINE * len(errors)
    size = f'width="{width}" height="{height}"'
    head = f'<svg xmlns="http://www.w3.org/2000/svg" {size} font-family="sans-serif"'
    back = '<rect width="100%" height="100%" fill="#fff"/>'
    return "\n".join([f'{head} font-size="12">', back, *parts, "</svg>\n"])


def _axis_labels(title: str, label: str) -> list[str]:
    """Return the SVG elements of the title and of the names of both axes."""
    below = AXES_TOP + AXES_HEIGHT + 38
    middle = AXES_TOP + AXES_HEIGHT / 2
    beside = _text(18, middle, escape(label))
    return [
        _text(AXES_LEFT, AXES_TOP - 14, escape(title), "start"),
        _text(AXES_LEFT + AXES_WIDTH / 2, below, "images (%), sorted by error"),
        f'<g transform="rotate(-90 18 {middle})">{beside}</g>',
    ]


def _grid(largest: float) -> list[str]:
    """Return the SVG elements of the grid and its numbers, up to the largest error."""
    parts = []
    for value in _ticks(largest):
        y = AXES_TOP + AXES_HEIGHT * (1 - value / largest)
        parts.append(f'<path d="M{AXES_LEFT} {y:.1f}h{AXES_WIDTH}" stroke="#ddd"/>')
        parts.append(_text(AXES_LEFT - 6, y + 4, f"{value:.6g}", "end"))
    for share in range(0, 101, 20):
        x = AXES_LEFT + AXES_WIDTH * share / 100
        parts.append(f'<path d="M{x:.1f} {AXES_TOP}v{AXES_HEIGHT}" stroke="#ddd"/>')
        parts.append(_text(x, AXES_TOP + AXES_HEIGHT + 18, str(share)))
    return parts


def _line(values: Floats, images: int, largest: float) -> str:
    """Return the points of a method's line, "x,y x,y", for a polyline of SVG.

    values: its sorted errors; images: how many it has, those that failed included;
    largest: the error at the top.
    """
    places = np.linspace(0, len(values) - 1, MAX_LINE_POINTS).astype(int)
    some = np.unique(places)[: len(values)]  # none where there are no errors
    across = AXES_LEFT + AXES_WIDTH * (some + 0.5) / max(images, 1)
    down = AXES_TOP + AXES_HEIGHT * (1 - values[some] / largest)
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in zip(across, down, strict=True))


def _ticks(largest: float) -> Floats:
    """Return round numbers from 0 to the largest, five to ten of them."""
    power = 10.0 ** math.floor(math.log10(largest))
    steps = [power * part for part in (0.1, 0.2, 0.5, 1)]
    step = next(step for step in steps if largest / step <= 10)
    return np.asarray(step * np.arange(int(largest / step * (1 + 1e-9)) + 1))


def _text(x: float, y: float, text: str, anchor: str = "middle") -> str:
    """Return the SVG element of a text, which must be escaped already."""
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{text}</text>'
