"""Formats that are written for other tools; those of them that can be read have an entry there."""

from __future__ import annotations

from shapefit.io.foreign.table import FileFormat

_ROOM = "shapefit.io.written"

FORMATS: dict[str, FileFormat] = {
    "bvh": FileFormat(
        title="a BVH file",
        suffixes=(".bvh",),
        writer=f"{_ROOM}.bvh:bvh_output",
        writes=("shapes", "result"),
        in_metres=True,
        by_sequence=True,
    ),
    "c3d": FileFormat(
        title="a C3D file",
        suffixes=(".c3d",),
        writer=f"{_ROOM}.c3d:c3d_output",
        writes=("shapes", "result"),
        in_metres=True,
        by_sequence=True,
    ),
    "coco": FileFormat(
        title="a JSON file",
        suffixes=(".json",),
        writer=f"{_ROOM}.coco_json:json_output",
        writes=("landmarks", "shapes", "result"),
        points_only=False,
    ),
    "deeplabcut-3d": FileFormat(
        title="a DeepLabCut 3D CSV",
        suffixes=(),
        writer=f"{_ROOM}.deeplabcut_3d:table_output",
        writes=("shapes", "result"),
        in_metres=True,
        by_sequence=True,
    ),
    "glb": FileFormat(
        title="a GLB file",
        suffixes=(".glb",),
        writer=f"{_ROOM}.glb:glb_output",
        writes=("shapes", "result"),
        in_metres=True,
        atom_meshes=True,
        by_sequence=True,
    ),
    "trc": FileFormat(
        title="a TRC file",
        suffixes=(".trc",),
        writer=f"{_ROOM}.trc:trc_output",
        writes=("shapes", "result"),
        in_metres=True,
        by_sequence=True,
    ),
}
