"""What the stages of lifting, and those around it, have in common."""

from __future__ import annotations

from collections.abc import Callable

from shapefit.dictionary.model import Dictionary
from shapefit.io import LandmarkSet
from shapefit.lifting.lift import Lifting

Lifter = Callable[[LandmarkSet, Dictionary], Lifting]
"""Lifts images, whose landmarks are those of the dictionary."""
