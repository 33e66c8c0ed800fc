"""The good files that every case starts from: a few people, and what is made of them."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from shapefit.cli.main import run

from shapefit.io import read_shapes, write_shapes
from shapefit.io.records import ShapeSet

from .detector_cases import write_detector_files
from .tracker_cases import write_tracker_files

SAMPLE = Path(__file__).resolve().parents[1] / "sample_data" / "people_test.h5"

ITEMS = 8
"""Shapes and images in each file: a case should take some milliseconds."""

SIMULATE = (
    *("simulate", "-o", "simulated", "--set=trials=1", "--set=k=6", "--set=plots=false"),
    *("--set=landmarks=[5]", "--set=active_atoms=[1]"),
)


def make_base_files(folder: Path) -> None:
    """Fill the folder by the commands themselves; raises RuntimeError where one of them fails.

    They also import and compile whatever the cases need, so that these can be forked.
    """
    os.chdir(folder)
    people = read_shapes([SAMPLE])
    rng = np.random.default_rng(0)
    few = people.take(np.linspace(0, len(people) - 1, ITEMS).astype(int))
    vertices = few.shapes[:, :, :6] + 0.1 * rng.standard_normal((ITEMS, 3, 6))
    meshed = ShapeSet(
        few.shapes,
        few.landmark_names,
        few.items,
        sequences=tuple("ab"[number % 2] for number in range(ITEMS)),
        edges=few.edges,
        mesh_vertices=vertices,
        mesh_faces=np.array([[0, 1, 2], [3, 4, 5]]),
        unit="m",
        columns={"weight": rng.uniform(size=ITEMS), "model": np.array(few.items, object)},
    )
    write_shapes(Path("shapes.h5"), meshed)
    write_shapes(Path("shapes.csv"), few)
    write_tracker_files(folder)
    write_detector_files(folder)
    learn = ("learn-dict", "shapes.h5", "--set", "iterations=2", "--set", "k=4")
    exemplars = ("learn-dict", "shapes.h5", "--set", "method=exemplars")
    camera = ("--set", "camera.view=random", "--set", "hidden=0.1")
    for command in (
        (*learn, "-o", "dict.h5"),
        (*exemplars, "-o", "exemplars.h5"),
        ("learn-dict", "shapes.h5", "--set", "method=pca-bases", "-o", "bases.h5"),
        ("project", "shapes.h5", *camera, "-o", "views.h5"),
        ("project", "shapes.csv", *camera, "-o", "views.csv"),
        ("fit", "views.h5", "-d", "dict.h5", "-o", "result.h5"),
        ("fit", "views.csv", "-d", "dict.h5", "-o", "result.csv"),
        ("fit", "views.h5", "-d", "dict.h5", "-o", "x.h5", "--set", "loss=exact"),
        ("fit", "views.h5", "-d", "dict.h5", "-o", "refined.h5", "--set=method=convex+refine"),
        ("fit", "views.h5", "-d", "bases.h5", "-o", "x.h5", "--set", "method=pmp"),
        ("eval", "result.h5", "--truth", "shapes.h5", "-o", "report", "--set=plots=false"),
        ("verify", "result.h5", "-d", "dict.h5", "--landmarks", "views.h5"),
        ("view", "result.h5", "--truth", "shapes.h5", "-o", "page.html"),
        SIMULATE,
    ):
        if run(command) not in (0, 1):
            raise RuntimeError(f"a good command fails: {' '.join(command)}")
