"""Formats of 3D points and motion."""

from __future__ import annotations

from shapefit.io.foreign.file_format import FileFormat

FORMATS: dict[str, FileFormat] = {}
