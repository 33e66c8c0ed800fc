"""Formats of 3D points and motion."""

from __future__ import annotations

from shapefit.io.foreign.file_format import FileFormat

_ROOM = "shapefit.io.motion"
_RECOGNITION = f"{_ROOM}.recognition"

FORMATS: dict[str, FileFormat] = {
    "acclaim": FileFormat(
        title="an ASF/AMC motion",
        suffixes=(".amc", ".asf"),
        recogniser=f"{_RECOGNITION}:is_acclaim",
        recorder=f"{_ROOM}.acclaim:record",
        records=("shapes",),
        together=True,
    ),
    "anipose-csv": FileFormat(
        title="an anipose 3D CSV",
        suffixes=(".csv",),
        recogniser=f"{_RECOGNITION}:is_anipose",
        recorder=f"{_ROOM}.anipose_csv:record",
        records=("shapes",),
    ),
    "bvh": FileFormat(
        title="a BVH motion",
        suffixes=(".bvh",),
        recogniser=f"{_RECOGNITION}:is_bvh",
        recorder=f"{_ROOM}.bvh:record",
        records=("shapes",),
    ),
    "c3d": FileFormat(
        title="a C3D file",
        suffixes=(".c3d",),
        recogniser=f"{_RECOGNITION}:is_c3d",
        recorder=f"{_ROOM}.c3d:record",
        records=("shapes",),
    ),
    "mesh": FileFormat(
        title="a mesh with landmarks",
        suffixes=(".obj", ".ply", ".glb"),
        recogniser=f"{_RECOGNITION}:is_mesh",
        readers={"shapes": f"{_ROOM}.meshes:read"},
        together=True,
    ),
    "trc": FileFormat(
        title="a TRC file",
        suffixes=(".trc",),
        recogniser=f"{_RECOGNITION}:is_trc",
        recorder=f"{_ROOM}.trc:record",
        records=("shapes",),
    ),
}
