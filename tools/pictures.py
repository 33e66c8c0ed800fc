"""Draw the pictures of the README from the results of `make demo`: python tools/pictures.py."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from shapefit.geometry.procrustes import similarity_transform
from shapefit.io import read_results, read_shapes
from shapefit.meshes.pictures import FittedImage, Model, View, draw_image, draw_solid

PROJECT = Path(__file__).resolve().parents[1]
SHOWN = ("walk", "box", "throw")
VIEW = View(45, 10)


def draw(demo: Path, images: Path) -> None:
    """Draw one frame each of a few activities: landmarks, estimate and truth in a novel view.

    demo is the folder of the results, images that of the picture.
    """
    results = read_results(demo / "result.h5")
    truth = read_shapes([PROJECT / "sample_data/people_test.h5"])
    edges = truth.edges
    assert edges is not None
    figure = Figure(figsize=(6, 6.6))
    figure.subplots_adjust(0, 0, 1, 0.96, 0, 0)
    model = Model(results.y_axis, edges=edges)
    for row, activity in enumerate(SHOWN):
        frames = [i for i, item in enumerate(results.items) if item.startswith(activity)]
        image = frames[len(frames) // 3]
        estimate = results.shapes[image]
        true = truth.shapes[truth.items.index(results.items[image])]
        landmarks = np.asarray(results.columns["landmarks"][image]).T
        shapes = {"estimate": estimate, "truth": similarity_transform(true, estimate).apply(true)}
        flat = figure.add_subplot(3, 3, 3 * row + 1)
        draw_image(flat, FittedImage(activity, landmarks, estimate, estimate[:2]), model)
        flat.set_title(activity, fontsize=9, loc="left")
        for column, (name, shape) in enumerate(shapes.items(), 2):
            solid = figure.add_subplot(3, 3, 3 * row + column, projection="3d")
            draw_solid(solid, FittedImage(name, landmarks, shape, shape[:2]), model, VIEW)
            solid.set_title(name if row == 0 else "", fontsize=9)
    figure.savefig(images / "people.png", dpi=110)


if __name__ == "__main__":
    draw(PROJECT / "results/demo", PROJECT / "docs/images")
