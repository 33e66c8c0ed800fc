"""Formats of detectors of people: JSON and text."""

from __future__ import annotations

from shapefit.io.foreign.file_format import FileFormat

FORMATS: dict[str, FileFormat] = {}
