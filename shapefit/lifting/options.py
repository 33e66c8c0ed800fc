"""Options of the steps around a method, with their defaults, which the config takes from here."""

from __future__ import annotations

from dataclasses import dataclass

BETA = 0.1
"""Residual, for normalised landmarks, beyond which a robust loss judges a landmark an outlier."""


@dataclass(frozen=True, kw_only=True)
class PerspectiveOptions:
    """The options of `refine_perspective`; softness and ridge are in normalised units."""

    ridge: float = 0.3
    softness: float = 0.1
    max_rounds: int = 1000
    threads: int = 0


@dataclass(frozen=True, kw_only=True)
class DepthOptions:
    """How depths are refined along a sequence, in units of the size of its landmarks.

    smoothness and rigidity weigh the terms of temporal.py beside the estimates, `tolerance` is the
    size beyond which a difference from an estimate counts as gross.
    """

    smoothness: float = 10.0
    rigidity: float = 100.0
    tolerance: float = 0.01
    max_rounds: int = 100
