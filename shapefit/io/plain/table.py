"""Formats of points that no tool stands for: tables, arrays and lists."""

from __future__ import annotations

from shapefit.io.foreign.file_format import FileFormat

_ROOM = "shapefit.io.plain"

FORMATS: dict[str, FileFormat] = {
    "table": FileFormat(
        title="a table of landmarks",
        suffixes=(".csv", ".tsv", ".txt"),
        recogniser=f"{_ROOM}.any_table:is_table",
        recorder=f"{_ROOM}.any_table:record",
        records=("landmarks", "shapes"),
        states_y_axis=False,
    ),
    "arrays": FileFormat(
        title="an array of landmarks",
        suffixes=(".npy", ".npz"),
        recogniser=f"{_ROOM}.arrays:is_array",
        recorder=f"{_ROOM}.arrays:record",
        records=("landmarks",),
        states_y_axis=False,
    ),
    "mediapipe": FileFormat(
        title="a file of MediaPipe's landmarks",
        suffixes=(".json",),
        recogniser=f"{_ROOM}.mediapipe:is_mediapipe",
        recorder=f"{_ROOM}.mediapipe:record",
        records=("landmarks",),
    ),
}
