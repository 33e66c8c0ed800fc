"""Options of the steps around a method, with their defaults, which the config takes from here."""

from __future__ import annotations

from dataclasses import dataclass

BETA = 0.1
"""Residual, for normalised landmarks, beyond which a robust loss judges a landmark an outlier."""

SEARCHED = 0.25
"""The same of a search before the fit, in units of the size of the shape."""


@dataclass(frozen=True, kw_only=True)
class PerspectiveOptions:
    """The options of `refine_perspective`; softness and ridge are in normalised units."""

    ridge: float = 0.3
    softness: float = 0.1
    max_rounds: int = 1000
    threads: int = 0
