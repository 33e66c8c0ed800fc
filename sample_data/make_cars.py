"""Make cars.h5, cars_views.h5 and cars_views.csv.

Eighteen cars of six kinds, by their dimensions in car_models.csv: a body (car_body.py), wheels,
mirrors and number plates; named spots of the mesh are landmarks; a pinhole camera on the street.

Run from the project's folder: python -m sample_data.make_cars [FOLDER]
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

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
    Dimensions,
    Floats,
    Integers,
    Lattice,
    body_vertices,
    lattice_surface,
)
from sample_data.storage import write_csv, write_hdf5, write_shapes

SEED = 20150608
DECIMALS = 4
VIEWS = 6
PIXEL_NOISE = 0.7


def main(folder: Path) -> None:
    models = read_models()
    cars = {name: assemble_car(parts_of(dimensions)) for name, dimensions in models.items()}
    spots = landmark_vertices(parts_of(next(iter(models.values()))))
    write_cars(folder / "cars.h5", cars, spots)
    write_views(folder, cars, spots, np.random.default_rng(SEED))


def assemble_car(parts: Mapping[str, Part]) -> Part:
    mesh = assemble(list(parts.values()))
    return Part(mesh.vertices.round(DECIMALS), mesh.faces)


def write_cars(path: Path, cars: Mapping[str, Part], spots: Mapping[str, int]) -> None:
    names = list(spots)
    vertices = np.stack([car.vertices for car in cars.values()])
    write_shapes(
        path,
        attributes={"frame": "car: x to its left, y up from the ground, z forward"},
        texts={"landmark_names": names, "item": list(cars)},
        arrays={
            "shapes": vertices[:, list(spots.values())],
            "edges": lines(names),
            "mirror_index": counterparts(names),
            "mesh_vertices": vertices,
            "mesh_faces": next(iter(cars.values())).faces,
        },
    )


def write_views(
    folder: Path, cars: Mapping[str, Part], spots: Mapping[str, int], rng: np.random.Generator
) -> None:
    """Look at every car from all sides; landmarks that it hides itself are NaN."""
    items, models, pictures, rotations, translations = [], [], [], [], []
    for name, car in cars.items():
        points = car.vertices[list(spots.values())]
        for number in range(VIEWS):
            camera = look(
                azimuth=360 * number / VIEWS + rng.uniform(0, 360 / VIEWS),
                elevation=rng.uniform(2, 25),
                roll=rng.normal(0, 1.5),
                distance=rng.uniform(9, 15),
            )
            picture = camera.picture(points) + PIXEL_NOISE * rng.standard_normal((len(spots), 2))
            seen = camera.visible(points, car.vertices, car.faces)
            pictures.append(np.where(seen[:, None], picture, np.nan).round(1))
            rotations.append(camera.rotation)
            translations.append(-camera.rotation @ camera.place)
            items.append(f"{name}/view_{number + 1}")
            models.append(name)
    write_hdf5(
        folder / "cars_views.h5",
        attributes={"format": "shapefit-landmarks", "version": 1, "unit": "px", "y_axis": "down"},
        texts={"landmark_names": list(spots), "item": items, "true_model": models},
        arrays={
            "landmarks": np.stack(pictures),
            "true_rotation": np.stack(rotations),
            "true_translation": np.stack(translations),
            "camera_matrix": camera_matrix(),
        },
    )
    write_csv(folder / "cars_views.csv", list(spots), items, np.stack(pictures), decimals=1)


def read_models() -> dict[str, Dimensions]:
    """Return the dimensions of each car."""
    kinds = Dimensions.__annotations__
    with Path(__file__).with_name("car_models.csv").open(encoding="utf-8") as file:
        return {
            row.pop("model"): Dimensions(
                **{
                    key: bool(int(cell)) if kinds[key] == "bool" else float(cell)
                    for key, cell in row.items()
                }
            )
            for row in csv.DictReader(file)
        }


# Parts that stand beside the body: closed, wound outward.

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


# Landmarks

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
_LINES = (
    *("front_light_top_outer-front_light_top_inner", "front_light_top_outer-hood_corner"),
    "front_light_top_inner-front_light_bottom_inner",
    "front_light_bottom_inner-front_light_bottom_outer",
    "front_light_bottom_outer-front_light_top_outer",
    *("rear_light_top_outer-rear_light_top_inner", "rear_light_top_inner-rear_light_bottom_inner"),
    "rear_light_bottom_inner-rear_light_bottom_outer",
    *("rear_light_bottom_outer-rear_light_top_outer", "front_plate_top-front_plate_bottom"),
    *("rear_plate_top-rear_plate_bottom", "front_bumper_bottom-front_bumper_corner"),
    *("front_bumper_bottom-front_arch_front", "rear_bumper_bottom-rear_bumper_corner"),
    "front_bumper_corner-front_light_bottom_outer",
    *("rear_bumper_corner-rear_light_bottom_outer", "hood_corner-windscreen_bottom"),
    *("windscreen_bottom-windscreen_top", "windscreen_bottom-front_window_corner"),
    *("windscreen_top-b_pillar_top", "b_pillar_top-c_pillar_top", "b_pillar_top-b_pillar_bottom"),
    *("c_pillar_top-rear_window_top", "c_pillar_top-c_pillar_bottom"),
    *("rear_window_top-rear_window_bottom", "rear_window_bottom-trunk_corner"),
    *("trunk_corner-rear_light_top_outer", "front_window_corner-mirror"),
    *("front_window_corner-b_pillar_bottom", "b_pillar_bottom-c_pillar_bottom"),
    *("c_pillar_bottom-rear_light_top_outer", "front_arch_front-front_wheel"),
    *("front_wheel-front_arch_rear", "front_arch_rear-rear_arch_front"),
    *("rear_arch_front-rear_wheel", "rear_wheel-rear_arch_rear"),
    "rear_arch_rear-rear_bumper_bottom",
)
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
        tuple(f"{side}_{name}" for name in line.split("-"))
        for side in ("left", "right")
        for line in _LINES
    ]
    pairs += [(f"left_{name}", f"right_{name}") for name in _ACROSS]
    return np.array([[names.index(a), names.index(b)] for a, b in pairs])


# Views from the street

IMAGE_SIZE = (1280, 960)
FOCAL_LENGTH = 1600.0
LOOK_AT = np.array([0.0, 0.70, 0.0])
CLEARANCE = 0.03  # metres before a landmark in which a surface does not hide it


@dataclass(frozen=True)
class Camera:
    """Rotation (3, 3) from the car to the camera (x right, y down, z forward), and its place."""

    rotation: Floats
    place: Floats

    def picture(self, points: Floats) -> Floats:
        """Pixels (p, 2) of points (p, 3), y down from the upper left corner."""
        x, y, z = self.rotation @ (points - self.place).T
        return np.array(IMAGE_SIZE) / 2 + FOCAL_LENGTH * np.stack([x / z, y / z], axis=1)

    def visible(self, points: Floats, vertices: Floats, faces: Integers) -> np.ndarray:
        """Whether the way from each point (p, 3) to the camera is free of the mesh (bool (p,))."""
        before = points + CLEARANCE * _unit(self.place - points)
        return ~_hits(self.place, before, vertices[faces])


def look(azimuth: float, elevation: float, roll: float, distance: float) -> Camera:
    """Camera on a sphere around the car; azimuth 0 is before it, 90 on its left; degrees."""
    a, e, r = np.radians([azimuth, elevation, roll])
    outward = np.array([np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)])
    right = _unit(np.cross(-outward, [0.0, 1.0, 0.0]))
    upright = np.stack([right, np.cross(-outward, right), -outward])
    turn = np.array([[np.cos(r), -np.sin(r), 0], [np.sin(r), np.cos(r), 0], [0, 0, 1]])
    return Camera(turn @ upright, LOOK_AT + distance * outward)


def camera_matrix() -> Floats:
    """Intrinsics (3, 3) of every view."""
    matrix = np.diag([FOCAL_LENGTH, FOCAL_LENGTH, 1.0])
    matrix[:2, 2] = np.array(IMAGE_SIZE) / 2
    return matrix


def _hits(start: Floats, ends: Floats, triangles: Floats) -> np.ndarray:
    """Whether the segment from `start` to each of `ends` crosses a triangle (f, 3, 3).

    Solves start + t (end - start) = a + u (b - a) + v (c - a) for each pair.
    """
    a, b, c = triangles.transpose(1, 0, 2)
    ab, ac, offset = b - a, c - a, start - a
    normal = np.cross(ab, ac)
    away = np.cross(offset, np.stack([ab, ac]))
    way = ends - start
    determinant = -way @ normal.T
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (offset * normal).sum(axis=1) / determinant
        u = -(way @ away[1].T) / determinant
        v = way @ away[0].T / determinant
    return ((t > 0) & (t < 1) & (u >= 0) & (v >= 0) & (u + v <= 1)).any(axis=1)


def _unit(vectors: Floats) -> Floats:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
