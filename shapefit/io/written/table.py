"""Formats that are written for other tools; those of them that can be read have an entry there."""

from __future__ import annotations

from typing import Any

from shapefit.io.foreign.table import EITHER, FileFormat


def _motion(title: str, suffixes: tuple[str, ...], writer: str, **further: Any) -> FileFormat:
    """Return the entry of files in metres; the writer is named below `shapefit.io.written`."""
    return FileFormat(
        title=title,
        suffixes=suffixes,
        writer=f"shapefit.io.written.{writer}",
        writes=("shapes", "result"),
        in_metres=True,
        by_sequence=True,
        **further,
    )


FORMATS: dict[str, FileFormat] = {
    "bvh": _motion("a BVH file", (".bvh",), "bvh:bvh_output"),
    "c3d": _motion("a C3D file", (".c3d",), "c3d:c3d_output"),
    "coco": FileFormat(
        title="a JSON file",
        suffixes=(".json",),
        writer="shapefit.io.written.coco_json:json_output",
        writes=(*EITHER, "result"),
        points_only=False,
    ),
    "deeplabcut-3d": _motion("a DeepLabCut 3D CSV", (), "point_tables:table_output"),
    "glb": _motion("a GLB file", (".glb",), "glb:glb_output", atom_meshes=True),
    "trc": _motion("a TRC file", (".trc",), "point_tables:trc_output"),
}
