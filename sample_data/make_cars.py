"""Make cars.h5, cars_views.h5 and cars_views.csv.

Run from the project's folder: python -m sample_data.make_cars [FOLDER]
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from sample_data.car_landmarks import counterparts, landmark_vertices, lines
from sample_data.car_models import MODELS
from sample_data.car_parts import Part, assemble, parts_of
from sample_data.car_views import camera_matrix, look
from sample_data.storage import write_csv, write_hdf5, write_shapes

SEED = 20150608
DECIMALS = 4
VIEWS = 6
PIXEL_NOISE = 0.7


def main(folder: Path) -> None:
    cars = {name: assemble_car(parts_of(dimensions)) for name, dimensions in MODELS.items()}
    spots = landmark_vertices(parts_of(next(iter(MODELS.values()))))
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


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
