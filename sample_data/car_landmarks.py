"""Named spots of a car, as vertices of its mesh, and the lines between them for drawing."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sample_data.car_body import (
    B_PILLAR,
    BELT,
    C_PILLAR,
    COLUMNS,
    COWL,
    DECK,
    FRONT_ARCH,
    REAR_ARCH,
    ROOF_REAR,
    ROWS,
    SCREEN_TOP,
    STATIONS,
    Integers,
)
from sample_data.car_parts import BODY, MIRROR, PLATE, Part

_LIGHT_TOP, _LIGHT_BOTTOM, _LIGHT_INNER = 7, 5, 4
_BUMPER, _HANDLE = 2, 6

# Spots of the left side on the body, by station, row and column.
_ON_BODY: Mapping[str, tuple[int, int, int]] = {
    "front_light_top_outer": (0, _LIGHT_TOP, COLUMNS),
    "front_light_top_inner": (0, _LIGHT_TOP, _LIGHT_INNER),
    "front_light_bottom_outer": (0, _LIGHT_BOTTOM, COLUMNS),
    "front_light_bottom_inner": (0, _LIGHT_BOTTOM, _LIGHT_INNER),
    "front_bumper_corner": (0, _BUMPER, COLUMNS),
    "front_bumper_bottom": (0, 0, COLUMNS),
    "hood_corner": (0, ROWS, COLUMNS),
    "windscreen_bottom": (COWL, ROWS, COLUMNS),
    "windscreen_top": (SCREEN_TOP, ROWS, COLUMNS),
    "front_arch_front": (FRONT_ARCH[0], 0, COLUMNS),
    "front_arch_rear": (FRONT_ARCH[1], 0, COLUMNS),
    "front_window_corner": (COWL + 2, BELT, COLUMNS),
    "front_door_handle": (B_PILLAR - 1, _HANDLE, COLUMNS),
    "b_pillar_top": (B_PILLAR, ROWS, COLUMNS),
    "b_pillar_bottom": (B_PILLAR, BELT, COLUMNS),
    "rear_door_handle": (C_PILLAR - 1, _HANDLE, COLUMNS),
    "c_pillar_top": (C_PILLAR, ROWS, COLUMNS),
    "c_pillar_bottom": (C_PILLAR, BELT, COLUMNS),
    "rear_arch_front": (REAR_ARCH[0], 0, COLUMNS),
    "rear_arch_rear": (REAR_ARCH[1], 0, COLUMNS),
    "rear_window_top": (ROOF_REAR, ROWS, COLUMNS),
    "rear_window_bottom": (DECK, ROWS, COLUMNS),
    "trunk_corner": (STATIONS, ROWS, COLUMNS),
    "rear_light_top_outer": (STATIONS, _LIGHT_TOP, COLUMNS),
    "rear_light_top_inner": (STATIONS, _LIGHT_TOP, _LIGHT_INNER),
    "rear_light_bottom_outer": (STATIONS, _LIGHT_BOTTOM, COLUMNS),
    "rear_light_bottom_inner": (STATIONS, _LIGHT_BOTTOM, _LIGHT_INNER),
    "rear_bumper_corner": (STATIONS, _BUMPER, COLUMNS),
    "rear_bumper_bottom": (STATIONS, 0, COLUMNS),
}
# Corners of the left half of the plates, on the face that looks away from the car.
_ON_PLATES: Mapping[str, tuple[str, tuple[int, int, int]]] = {
    "front_plate_top": ("front_plate", (0, 1, 1)),
    "front_plate_bottom": ("front_plate", (0, 0, 1)),
    "rear_plate_top": ("rear_plate", (1, 1, 1)),
    "rear_plate_bottom": ("rear_plate", (1, 0, 1)),
}
_MIRROR_TIP = MIRROR.vertex(1, 1, 1)
_HUB = 0

# Lines of each side, and landmarks that a line joins to their counterpart.
_LINES: Mapping[str, tuple[str, ...]] = {
    "front_light_top_outer": (
        "front_light_top_inner",
        "hood_corner",
    ),
    "front_light_top_inner": ("front_light_bottom_inner",),
    "front_light_bottom_inner": ("front_light_bottom_outer",),
    "front_light_bottom_outer": ("front_light_top_outer",),
    "rear_light_top_outer": ("rear_light_top_inner",),
    "rear_light_top_inner": ("rear_light_bottom_inner",),
    "rear_light_bottom_inner": ("rear_light_bottom_outer",),
    "rear_light_bottom_outer": ("rear_light_top_outer",),
    "front_plate_top": ("front_plate_bottom",),
    "rear_plate_top": ("rear_plate_bottom",),
    "front_bumper_bottom": (
        "front_bumper_corner",
        "front_arch_front",
    ),
    "rear_bumper_bottom": ("rear_bumper_corner",),
    "front_bumper_corner": ("front_light_bottom_outer",),
    "rear_bumper_corner": ("rear_light_bottom_outer",),
    "hood_corner": ("windscreen_bottom",),
    "windscreen_bottom": (
        "windscreen_top",
        "front_window_corner",
    ),
    "windscreen_top": ("b_pillar_top",),
    "b_pillar_top": (
        "c_pillar_top",
        "b_pillar_bottom",
    ),
    "c_pillar_top": (
        "rear_window_top",
        "c_pillar_bottom",
    ),
    "rear_window_top": ("rear_window_bottom",),
    "rear_window_bottom": ("trunk_corner",),
    "trunk_corner": ("rear_light_top_outer",),
    "front_window_corner": (
        "mirror",
        "b_pillar_bottom",
    ),
    "b_pillar_bottom": ("c_pillar_bottom",),
    "c_pillar_bottom": ("rear_light_top_outer",),
    "front_arch_front": ("front_wheel",),
    "front_wheel": ("front_arch_rear",),
    "front_arch_rear": ("rear_arch_front",),
    "rear_arch_front": ("rear_wheel",),
    "rear_wheel": ("rear_arch_rear",),
    "rear_arch_rear": ("rear_bumper_bottom",),
}
_ACROSS = (
    *("front_bumper_bottom", "hood_corner", "windscreen_bottom", "windscreen_top"),
    *("rear_window_top", "rear_window_bottom", "trunk_corner", "rear_bumper_bottom"),
    *("front_plate_top", "front_plate_bottom", "rear_plate_top", "rear_plate_bottom"),
)


def landmark_vertices(parts: Mapping[str, Part]) -> dict[str, int]:
    """Return the vertex of each landmark in the mesh of all parts, the left side first."""
    sizes = [len(part.vertices) for part in parts.values()]
    start = dict(zip(parts, np.cumsum([0, *sizes]).tolist(), strict=False))
    vertices: dict[str, int] = {}
    for side, sign in (("left", 1), ("right", -1)):
        for name, (i, r, c) in _ON_BODY.items():
            vertices[f"{side}_{name}"] = start["body"] + BODY.vertex(i, r, sign * c)
        for name, (part, (i, r, c)) in _ON_PLATES.items():
            vertices[f"{side}_{name}"] = start[part] + PLATE.vertex(i, r, sign * c)
        for wheel in ("front_wheel", "rear_wheel"):
            vertices[f"{side}_{wheel}"] = start[f"{side}_{wheel}"] + _HUB
        vertices[f"{side}_mirror"] = start[f"{side}_mirror"] + _MIRROR_TIP
    return vertices


def counterparts(names: list[str]) -> Integers:
    """Return, for each landmark, the index of the one on the other side."""
    other = {"left": "right", "right": "left"}
    sides = [name.partition("_") for name in names]
    return np.array([names.index(f"{other[side]}_{spot}") for side, _, spot in sides])


def lines(names: list[str]) -> Integers:
    """Return pairs of landmarks (e, 2) that draw the outline of the car."""
    pairs = [
        (f"{side}_{first}", f"{side}_{second}")
        for side in ("left", "right")
        for first, seconds in _LINES.items()
        for second in seconds
    ]
    pairs += [(f"left_{name}", f"right_{name}") for name in _ACROSS]
    return np.array([[names.index(a), names.index(b)] for a, b in pairs])
