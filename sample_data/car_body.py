"""The body of a car: the surface of a lattice, bent into shape by a few dimensions.

Frame: x to the left of the car, y up from the ground, z forward from the middle of the wheelbase;
metres. Every car has the same vertices and faces, so that one place of the lattice is the same
spot on each of them:

    station i   0 at the nose, STATIONS at the tail
    row r       0 at the sill, BELT below the windows, ROWS along the edge of hood, roof and trunk
    column c    -COLUMNS on the right, 0 on the middle, COLUMNS on the left

Sides, front, rear, underside and top (hood, windscreen, roof, rear window, trunk) are the six faces
of the lattice.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

STATIONS, ROWS, COLUMNS = 35, 13, 7
BELT = 7

# Stations of the upper body. From GLASS_FRONT to GLASS_REAR a side window lies behind its frame.
COWL, SCREEN_TOP = 8, 13
B_PILLAR, C_PILLAR, ROOF_REAR, DECK = 17, 23, 27, 30
SIDE_GLASS = ((10, 16), (19, 22), (25, 26))
# Stations of the lower body: the ends of the wheel arches.
FRONT_ARCH, REAR_ARCH = (4, 12), (22, 30)

ROW_HEIGHT = np.array([0, 0.14, 0.28, 0.42, 0.56, 0.70, 0.85, 1])  # from sill to belt
ROW_WIDTH = np.array([0.955, 0.985, 0.997, 1, 1, 0.996, 0.988, 0.970])
BAND_HEIGHT = np.array([0, 0.07, 0.12, 0.50, 0.88, 0.93, 1])  # from belt to roof edge
BAND_LEDGE = np.array([0, 0.8, 1, 1, 1, 1, 1.25])
GLASS_ROWS = (9, 11)
COLUMN_PLACE = np.array([0, 0.18, 0.36, 0.56, 0.75, 0.90, 0.95, 1])
GLASS_COLUMN = 5
GRILLE_ROWS, GRILLE_COLUMN = (4, 6), 3

NOSE_BULGE, TAIL_BULGE = 0.15, 0.10  # how far the middle stands out before the corners
SHOULDER = 0.045  # drop from the edge of hood or trunk to the shoulder of the wings
GLASS_DEPTH = 0.022
GRILLE_DEPTH = 0.04
LEDGE = 0.05


@dataclass(frozen=True)
class Dimensions:
    """What distinguishes one car from another, in metres; `to_...` are distances from the nose."""

    length: float
    width: float
    height: float
    wheelbase: float
    front_overhang: float
    clearance: float
    wheel_radius: float
    hood_front: float  # height of the front edge of the hood
    to_cowl: float
    cowl: float  # height of the lower edge of the windscreen
    to_roof: float  # upper edge of the windscreen
    to_b_pillar: float
    to_c_pillar: float
    to_roof_rear: float
    roof_drop: float  # from the highest point of the roof to its rear edge
    to_deck: float  # lower edge of the rear window
    deck: float  # its height
    tail: float  # height of the rear edge of the trunk
    belt_front: float
    belt_rear: float
    lean_in: float = 0.28  # of the side windows, per metre of height
    nose_rake: float = 1.0
    tail_rake: float = 1.0
    quarter_glass: bool = False
    rear_glass: bool = True  # side windows in the rear doors
    bed: float = 0.0  # depth of a load bed in the place of the trunk


@dataclass(frozen=True)
class Lattice:
    """Surface points of the lattice: place (q, 3) as (i, r, c), and faces (f, 3), outward."""

    place: Integers
    faces: Integers

    def vertex(self, i: int, r: int, c: int) -> int:
        """Return the vertex at a place of the surface."""
        return int(np.flatnonzero((self.place == (i, r, c)).all(axis=1))[0])


def lattice_surface(stations: int, rows: int, columns: int) -> Lattice:
    """Closed surface of the lattice [0, stations] x [0, rows] x [-columns, columns].

    Every square is cut along a diagonal; left and right are mirror images.
    """
    size = np.array([stations, rows, 2 * columns])
    inside = np.stack(np.meshgrid(*(np.arange(n + 1) for n in size), indexing="ij"), axis=-1)
    points = inside.reshape(-1, 3)
    points = points[((points == 0) | (points == size)).any(axis=1)]
    number = np.full(size + 1, -1)
    number[tuple(points.T)] = np.arange(len(points))
    squares = []
    for axis in range(3):
        first, second = (axis + 1) % 3, (axis + 2) % 3
        corner = np.zeros((size[first], size[second], 4, 3), dtype=int)
        for k, (da, db) in enumerate([(0, 0), (1, 0), (1, 1), (0, 1)]):
            corner[:, :, k, first] = np.arange(size[first])[:, None] + da
            corner[:, :, k, second] = np.arange(size[second])[None, :] + db
        for end in (0, size[axis]):
            corner[..., axis] = end
            # (axis, first, second) is right-handed in (i, r, c), which maps to (-z, y, x).
            square = corner.reshape(-1, 4, 3).copy()
            squares.append(square[:, ::-1] if end == 0 else square)
    square = np.concatenate(squares)
    on_right = (square[..., 2].sum(axis=1) < 4 * columns)[:, None]
    a, b, c, d = number[tuple(np.moveaxis(square, -1, 0))].T
    first_cut = np.stack([np.stack([a, b, c], 1), np.stack([a, c, d], 1)], 1)
    second_cut = np.stack([np.stack([a, b, d], 1), np.stack([b, c, d], 1)], 1)
    faces = np.where(on_right[..., None], first_cut, second_cut).reshape(-1, 3)
    return Lattice(points - [0, 0, columns], faces)


def body_vertices(lattice: Lattice, car: Dimensions) -> Floats:
    """Positions (q, 3) of the lattice points on the body of `car`."""
    side = _side(car)
    i, r, c = lattice.place.T
    u = np.sign(c) * COLUMN_PLACE[np.abs(c)]
    x, y, z = (side[k][i, r] for k in range(3))
    bulge, crown = _middle(car, side)
    top, bottom = r == ROWS, r == 0
    in_bed = top & (car.bed > 0) & (i > DECK) & (i < STATIONS)
    arch = 1 - u**2
    arch = np.where(bottom, np.clip((0.75 - np.abs(u)) / 0.19, 0, 1), arch)
    arch = np.where(in_bed, np.clip((1 - np.abs(u)) / 0.10, 0, 1), arch)
    x = u * x
    y = y + arch * crown[i, r]
    z = z + (1 - np.abs(u) ** 2.5) * bulge[i, r]
    grille = (i == 0) & (r >= GRILLE_ROWS[0]) & (r <= GRILLE_ROWS[1]) & (np.abs(c) <= GRILLE_COLUMN)
    z = z - GRILLE_DEPTH * grille

    glass = top & (np.abs(c) <= GLASS_COLUMN)
    screen = glass & (i > COWL) & (i < SCREEN_TOP)
    rear = glass & (i > ROOF_REAR) & (i < DECK)
    for pane, before, after in ((screen, COWL, SCREEN_TOP), (rear, ROOF_REAR, DECK)):
        rise = side[1][after, ROWS] - side[1][before, ROWS]
        run = side[2][after, ROWS] - side[2][before, ROWS]
        inward = GLASS_DEPTH * np.array([run, -rise]) / np.hypot(rise, run)
        y = y + pane * inward[0]
        z = z + pane * inward[1]
    return np.stack([x, y, z], axis=-1)


def _upper_stations(car: Dimensions) -> Floats:
    """Distance of each station from the nose, along the belt and above."""
    end = car.length - TAIL_BULGE
    b, c, roof = car.to_b_pillar, car.to_c_pillar, car.to_roof_rear
    return np.concatenate(
        [
            NOSE_BULGE + (car.to_cowl - NOSE_BULGE) * (np.arange(COWL) / COWL) ** 1.3,
            car.to_cowl + (car.to_roof - car.to_cowl) * np.array([0, 0.07, 0.36, 0.64, 0.93, 1]),
            car.to_roof + (b - 0.055 - car.to_roof) * np.array([1 / 3, 2 / 3]),
            b + np.array([-0.055, -0.035, 0.035, 0.055]),
            b + 0.055 + (c - 0.02 - b - 0.055) * np.array([1 / 3, 2 / 3]),
            [c - 0.02, c, c + 0.06, c + 0.08],
            [max(roof - 0.10, 0.5 * (c + 0.08 + roof)), roof],
            roof + (car.to_deck - roof) * np.array([0.08, 0.92, 1]),
            car.to_deck + (end - car.to_deck) * np.array([0.06, 0.36, 0.64, 0.94, 1]),
        ]
    )


def _lower_stations(car: Dimensions) -> tuple[Floats, Floats]:
    """Distance of each station from the nose along the sill, and the height of its edge."""
    front, rear = car.front_overhang, car.front_overhang + car.wheelbase
    radius = car.wheel_radius + 0.05
    angle = np.linspace(0, np.pi, 9)
    arch = -radius * np.cos(angle)
    start, end = NOSE_BULGE, car.length - TAIL_BULGE
    distance = np.concatenate(
        [
            start + (front - radius - start) * (np.arange(4) / 4) ** 1.5,
            front + arch,
            np.linspace(front + radius, rear - radius, 11)[1:-1],
            rear + arch,
            end - (end - rear - radius) * (np.arange(4, -1, -1) / 5) ** 1.5,
        ]
    )
    height = np.full(STATIONS + 1, car.clearance)
    for first, last in (FRONT_ARCH, REAR_ARCH):
        top = car.wheel_radius + radius - car.clearance
        height[first : last + 1] += top * np.abs(np.sin(angle)) ** 0.8
    return distance, height


def _profile(car: Dimensions, distance: Floats) -> Floats:
    """Height of the edge of hood, windscreen, roof, rear window and trunk at each station."""
    rear = car.height - car.roof_drop
    knots = [0, COWL, SCREEN_TOP, ROOF_REAR, DECK, STATIONS]
    heights = [car.hood_front, car.cowl, car.height - 0.05, rear, car.deck, car.tail]
    bumps = [0.035, 0.012, 0, 0.008, 0.006]
    height = np.empty(STATIONS + 1)
    ends = zip(pairwise(knots), pairwise(heights), bumps, strict=True)
    for (a, b), (low, high), bump in ends:
        t = (distance[a : b + 1] - distance[a]) / (distance[b] - distance[a])
        height[a : b + 1] = low + (high - low) * t + bump * 4 * t * (1 - t)
    along = distance[SCREEN_TOP : ROOF_REAR + 1]
    t = (along - along[0]) / (along[-1] - along[0])
    roof = PchipInterpolator([0, 0.35, 1], [car.height - 0.05, car.height - 0.015, rear])
    height[SCREEN_TOP : ROOF_REAR + 1] = roof(t)
    return height


def _side(car: Dimensions) -> tuple[Floats, Floats, Floats]:
    """Left side of the car: half width, height and z, each (STATIONS + 1, ROWS + 1)."""
    upper = _upper_stations(car)
    lower, sill = _lower_stations(car)
    top = _profile(car, upper)
    along = (upper - car.to_cowl) / (car.to_deck - car.to_cowl)
    belt = np.minimum(car.belt_front + (car.belt_rear - car.belt_front) * along, top - SHOULDER)

    blend = np.clip((np.arange(ROWS + 1) - 2) / (BELT - 2), 0, 1)
    blend = blend * blend * (3 - 2 * blend)
    distance = lower[:, None] * (1 - blend) + upper[:, None] * blend
    band = belt[:, None] + (top - belt)[:, None] * BAND_HEIGHT
    y = np.concatenate([sill[:, None] + (belt - sill)[:, None] * ROW_HEIGHT, band[:, 1:]], axis=1)

    from_end = np.minimum(distance - NOSE_BULGE, car.length - TAIL_BULGE - distance)
    plan = PchipInterpolator([0, 0.06, 0.2, 0.5, 0.9], [0.82, 0.89, 0.945, 0.985, 1])
    half = car.width / 2 * plan(np.clip(from_end, 0, 0.9))
    ledge = LEDGE * BAND_LEDGE + car.lean_in * (band - belt[:, None])
    x = half * np.concatenate([ROW_WIDTH, np.full(ROWS - BELT, ROW_WIDTH[-1])])
    x[:, BELT:] -= ledge
    for number, (first, last) in enumerate(SIDE_GLASS):
        if (number == 1 and not car.rear_glass) or (number == 2 and not car.quarter_glass):
            continue
        x[first : last + 1, GLASS_ROWS[0] : GLASS_ROWS[1] + 1] -= GLASS_DEPTH

    rows = np.arange(ROWS + 1)
    front = PchipInterpolator([0, 1, 3, 4, 7, 10, ROWS], [0.05, 0, 0, 0.05, 0.10, 0.13, 0.19])(rows)
    rear = PchipInterpolator([0, 1, 3, 4, 7, 10, ROWS], [0.05, 0, 0, 0.04, 0.06, 0.07, 0.09])(rows)
    near_nose = np.clip(1 - (distance - NOSE_BULGE) / 0.8, 0, 1) ** 2
    near_tail = np.clip(1 - (car.length - TAIL_BULGE - distance) / 0.5, 0, 1) ** 2
    setback = car.nose_rake * front * near_nose - car.tail_rake * rear * near_tail
    nose = car.wheelbase / 2 + car.front_overhang
    return x, y, nose - distance - setback


def _middle(car: Dimensions, side: tuple[Floats, Floats, Floats]) -> tuple[Floats, Floats]:
    """How far the middle of top, underside, front and rear stands before and above the sides."""
    stations = np.arange(STATIONS + 1)
    bulge = np.zeros((STATIONS + 1, ROWS + 1))
    crown = np.zeros_like(bulge)
    bulge[0], bulge[-1] = NOSE_BULGE, -TAIL_BULGE
    bulge[:, 0] = np.interp(stations, [0, 4, 30, STATIONS], [NOSE_BULGE, 0, 0, -TAIL_BULGE])
    bulge[:, ROWS] = np.interp(
        stations,
        [0, COWL, SCREEN_TOP, B_PILLAR, C_PILLAR, ROOF_REAR, DECK, STATIONS],
        [NOSE_BULGE, 0.14, 0.07, 0, 0, -0.03, -0.06, -TAIL_BULGE],
    )
    crown[:, 0] = car.clearance - side[1][:, 0]
    crown[:, ROWS] = np.interp(
        stations,
        [0, COWL, SCREEN_TOP, B_PILLAR, ROOF_REAR, DECK, STATIONS],
        [0.02, 0.035, 0.03, 0.045, 0.03, 0.02, 0.02],
    )
    if car.bed > 0:
        crown[DECK + 1 : STATIONS, ROWS] = -car.bed
        crown[[DECK, STATIONS], ROWS] = 0
    return bulge, crown
