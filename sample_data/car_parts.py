"""Closed parts that stand beside the body of a car: wheels, mirrors, number plates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sample_data.car_body import (
    BELT,
    COLUMNS,
    COWL,
    ROWS,
    STATIONS,
    Dimensions,
    Floats,
    Integers,
    Lattice,
    body_vertices,
    lattice_surface,
)

BODY = lattice_surface(STATIONS, ROWS, COLUMNS)
MIRROR = lattice_surface(2, 2, 1)
PLATE = lattice_surface(1, 1, 1)

SEGMENTS = 30
SPOKES = 5
TYRE_WIDTH = 0.20
# Across the wheel from the outside of the hub to the inside: (offset from the outer face as a
# share of the width, radius as a share of the wheel's). The rim lies deep, the spokes do not.
HUB = 0.10
RINGS = np.array(
    [
        *((0.10, 0.18), (0.14, 0.20), (0.14, 0.58), (0.02, 0.64)),
        *((0.00, 0.70), (0.00, 0.92), (0.12, 1.00), (0.88, 1.00), (1.00, 0.92)),
    ]
)
SPOKE_RINGS = (1, 2)
RIM_DEPTH = 0.35

MIRROR_SIZE = np.array([0.10, 0.065, 0.05])  # half width, height and depth
MIRROR_PLACE = np.array([0.12, 0.03, -0.05])  # of the middle, from the front of the window
PLATE_SIZE = np.array([0.26, 0.055, 0.012])
PLATE_PLACE = np.array([0, 0, 0.022])
FRONT_PLATE_ROW, REAR_PLATE_ROW = 2.5, 5.2


@dataclass(frozen=True)
class Part:
    """Vertices (q, 3) and faces (f, 3), closed and wound outward."""

    vertices: Floats
    faces: Integers

    def mirrored(self) -> Part:
        """Return the part of the other side of the car."""
        return Part(self.vertices * [-1, 1, 1], self.faces[:, ::-1])


def assemble(parts: list[Part]) -> Part:
    """Put the parts into one mesh, vertices in the order of the parts."""
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    return Part(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.faces + start for part, start in zip(parts, starts, strict=False)]),
    )


def parts_of(car: Dimensions) -> dict[str, Part]:
    """Return the parts of the car by name, the body first; every car has the same."""
    shell = Part(body_vertices(BODY, car), BODY.faces)
    parts = {"body": shell}
    for axle, z in (("front", car.wheelbase / 2), ("rear", -car.wheelbase / 2)):
        left = wheel(car, z)
        parts |= {f"left_{axle}_wheel": left, f"right_{axle}_wheel": left.mirrored()}
    foot = shell.vertices[BODY.vertex(COWL + 2, BELT + 1, COLUMNS)]
    left = block(MIRROR, foot + MIRROR_PLACE, MIRROR_SIZE)
    parts |= {"left_mirror": left, "right_mirror": left.mirrored()}
    for end, station, row, side in (
        ("front", 0, FRONT_PLATE_ROW, 1),
        ("rear", STATIONS, REAR_PLATE_ROW, -1),
    ):
        below, above = (shell.vertices[BODY.vertex(station, int(row) + step, 0)] for step in (0, 1))
        middle = below + (row % 1) * (above - below)
        parts[f"{end}_plate"] = block(PLATE, middle + side * PLATE_PLACE, PLATE_SIZE)
    return parts


def wheel(car: Dimensions, z: float) -> Part:
    """Return the left wheel of the axle at `z`: a tyre and a rim with spokes, its hub first."""
    radius = car.wheel_radius
    outside = car.width / 2 - 0.02
    angle = 2 * np.pi * np.arange(SEGMENTS) / SEGMENTS - np.pi / 2
    depth = np.tile(RINGS[:, :1], SEGMENTS)
    gap = np.arange(SEGMENTS) * SPOKES % SEGMENTS >= SEGMENTS / 2
    depth[SPOKE_RINGS[0] : SPOKE_RINGS[1] + 1, gap] += RIM_DEPTH
    reach = radius * RINGS[:, 1:]
    ring = np.stack(
        [
            outside - TYRE_WIDTH * depth,
            radius + reach * np.sin(angle),
            z + reach * np.cos(angle),
        ],
        axis=-1,
    )
    hub = [outside - TYRE_WIDTH * HUB, radius, z]
    back = [outside - TYRE_WIDTH, radius, z]
    vertices = np.concatenate([[hub], ring.reshape(-1, 3), [back]])

    here = np.arange(SEGMENTS)
    there = (here + 1) % SEGMENTS
    faces = []
    for k in range(len(RINGS) - 1):
        a, b = 1 + k * SEGMENTS, 1 + (k + 1) * SEGMENTS
        faces.append(np.stack([a + here, b + there, b + here], axis=1))
        faces.append(np.stack([a + here, a + there, b + there], axis=1))
    last = 1 + (len(RINGS) - 1) * SEGMENTS
    faces.append(np.stack([np.zeros_like(here), 1 + there, 1 + here], axis=1))
    faces.append(np.stack([np.full_like(here, len(vertices) - 1), last + here, last + there], 1))
    return Part(vertices, np.concatenate(faces))


def block(surface: Lattice, middle: Floats, half: Floats) -> Part:
    """Return a box with these half sizes; the more squares a side has, the rounder it is."""
    size = np.ptp(surface.place, axis=0)
    i, r, c = (2 * (surface.place - surface.place.min(axis=0)) / size - 1).T
    unit = np.stack([c, r, -i], axis=-1)
    roundness = 0.25 * (size[0] > 1)
    unit = unit / (1 - roundness + roundness * np.linalg.norm(unit, axis=1, keepdims=True))
    return Part(middle + half * unit, surface.faces)
