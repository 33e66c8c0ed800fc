"""Draw the pictures of the README from the results of `make demo`: python docs/pictures.py."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from shapefit.geometry.procrustes import similarity_transform
from shapefit.io import read_results, read_shapes
from shapefit.meshes.pictures import Pose, skeleton_picture

PROJECT = Path(__file__).resolve().parents[1]
SHOWN = ("walk", "box", "throw")


def draw(demo: Path, images: Path) -> None:
    """Draw one frame each of a few activities: landmarks, estimate and truth in a novel view.

    demo is the folder of the results, images that of the picture.
    """
    results = read_results(demo / "result.h5")
    truth = read_shapes([PROJECT / "sample_data/people_test.h5"])
    edges = truth.edges
    assert edges is not None
    poses = []
    for activity in SHOWN:
        frames = [i for i, item in enumerate(results.items) if item.startswith(activity)]
        image = frames[len(frames) // 3]
        estimate = results.shapes[image]
        true = truth.shapes[truth.items.index(results.items[image])]
        poses.append(
            Pose(
                title=activity,
                landmarks=np.asarray(results.columns["landmarks"][image]).T,
                shapes={
                    "estimate": estimate,
                    "truth": similarity_transform(true, estimate).apply(true),
                },
            )
        )
    figure = skeleton_picture(poses, edges, results.y_axis)
    figure.savefig(images / "people.png", dpi=110)


if __name__ == "__main__":
    draw(PROJECT / "results/demo", PROJECT / "docs/images")
