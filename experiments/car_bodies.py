"""Cars by class of body, as in the paper's figure of cars: sedan, SUV and pick-up.

The convex program stands beside the alternative that the paper compares with: nonlinear
optimisation under a perspective camera from the mean shape. Annotated photos show no
pick-up, so images of the 15 shapes from which the paper made its dictionary are made
here.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import shapefit
from experiments.sensitivity import CONFIGS, OF_THE_CARS
from shapefit.api.arguments import Metric
from shapefit.arrays import Floats
from shapefit.evaluation.report import markdown_table
from shapefit.geometry.procrustes import similarity_transform
from shapefit.geometry.rotations import rotation_about

Bodies = Mapping[str, list[str]]
"""Class of body -> names of the models of that class."""

VIEWS = 24
"""Images of a car, spread around it."""

VISIBLE = 40
"""Landmarks that an image shows, as in the paper."""

FOCAL, DISTANCE = 1000.0, 12.0
"""In pixels, and in the unit of the shapes, whose cars are about 5 long."""

ELEVATION = (3.0, 20.0)
"""Least and largest height of the camera above the car, in degrees."""

METHODS = {
    "Convex": "convex-1",
    "Perspective from the mean shape": "perspective-mean-shape",
    "the same, from one view": "perspective-one-view",
    "Mean shape": "mean-shape",
}
"""Name -> config of configs/cars/methods."""

ERRORS: tuple[tuple[Metric, str], ...] = (
    ("similarity", "normalised"),
    ("camera", "normalised"),
    ("rotation", "deg"),
)
CELL = "similarity / camera frame / rotation (deg)"

SHOWN = {"sedan": "car07", "SUV": "car05", "pick-up": "car04"}
SHOWN_VIEW = 3
"""The cars of the figure, and the number of their view."""


class Case(NamedTuple):
    """A car of the figure: its class of body, true shape (p, 3) and landmarks (p, 2),
    and the fit of each method.

    fitted and shapes map a method to its landmarks (p, 2) and its shape (p, 3), moved
    onto the true one.
    """

    body: str
    truth: Floats
    landmarks: Floats
    fitted: Mapping[str, Floats]
    shapes: Mapping[str, Floats]


def look_at(shapes: shapefit.Shapes, seed: int = 0) -> shapefit.Landmarks:
    """Return VIEWS images of each shape, through a perspective camera, in pixels.

    The camera goes around each car. It sees VISIBLE landmarks, drawn from those whose
    direction from the middle of the car faces it.
    """
    rng = np.random.default_rng(seed)
    images: list[Floats] = []
    rotations: list[Floats] = []
    models: list[str] = []
    for points, model in zip(shapes.shapes, shapes.items or (), strict=True):
        car = points - points.mean(axis=0)
        outward = car / np.ptp(car, axis=0)
        for view in range(VIEWS):
            heading = 2 * np.pi * (view + rng.random()) / VIEWS
            R = camera_rotation(heading, np.radians(rng.uniform(*ELEVATION)))
            seen = car @ R.T + np.array([0.0, 0.0, DISTANCE])
            towards_camera = -R[2]
            facing = np.flatnonzero(outward @ towards_camera > 0)
            chosen = rng.choice(facing, VISIBLE, replace=False)
            image = np.full((len(car), 2), np.nan)
            image[chosen] = FOCAL * seen[chosen, :2] / seen[chosen, 2:]
            images.append(image)
            rotations.append(R)
            models.append(model)
    return shapefit.Landmarks(
        np.array(images),
        landmark_names=shapes.landmark_names,
        items=tuple(f"{model}/{row % VIEWS}" for row, model in enumerate(models)),
        unit="px",
        extras={
            "true_model": np.array(models, dtype=object),
            "true_rotation": np.array(rotations),
        },
        file_extras={"camera_matrix": np.diag([FOCAL, FOCAL, 1.0])},
    )


def camera_rotation(heading: float, elevation: float) -> Floats:
    """Return R from the frame of a car (y up) to that of a camera (y down, z forward).

    The camera is turned about the vertical by the heading, and looks down by the
    elevation, both in radians.
    """
    up, across = np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0])
    turn = rotation_about(up, np.array([-heading]))[0]
    tilt = rotation_about(across, np.array([elevation]))[0]
    R: Floats = np.diag([1.0, -1.0, -1.0]) @ tilt @ turn
    return R


def measure_bodies(
    shapes: shapefit.Shapes, bodies: Bodies
) -> tuple[str, tuple[Case, ...]]:
    """Lift images of the shapes by each method, each car without its own shape; return
    the table of errors by class of body, in Markdown, and the cars of the figure.

    bodies: class of body -> names of its cars.
    """
    dictionary = shapefit.learn(shapes, method="exemplars", align="none")
    images = look_at(shapes)
    models = np.asarray(images.extras["true_model"])
    fits = {
        name: fit_with(config, images, dictionary) for name, config in METHODS.items()
    }
    errors: dict[str, Mapping[tuple[str, str], Floats]] = {
        name: shapefit.evaluate(
            fit, shapes, [metric for metric, _ in ERRORS], "true_model"
        ).errors
        for name, fit in fits.items()
    }
    table = markdown_table(*rows_of_bodies(errors, models, bodies))
    cases = [
        case_of(body, f"{model}/{SHOWN_VIEW}", images, shapes, fits)
        for body, model in SHOWN.items()
        if model in models
    ]
    return table, tuple(cases)


def fit_with(
    config: str, images: shapefit.Landmarks, dictionary: shapefit.Dictionary
) -> shapefit.Fit:
    """Lift images with the config of this name in configs/cars/methods."""
    path = CONFIGS / "cars/methods" / f"{config}.yaml"
    of_data: dict[str, Any] = dict(OF_THE_CARS)
    if "camera:" not in path.read_text(encoding="utf-8"):
        del of_data["camera"]
    return shapefit.fit(images, dictionary, config=path, **of_data)


def rows_of_bodies(
    errors: Mapping[str, Mapping[tuple[str, str], Floats]],
    models: Any,
    bodies: Bodies,
) -> tuple[list[str], list[list[str]]]:
    """Return the header and rows of a table: mean errors of each method, a row, over
    the images of each class of body, a column.

    errors maps a method to its errors (n,) in each metric and unit; models (n,) are
    those that the images show. Classes without an image are left out.
    """
    members = {body: np.isin(models, names) for body, names in bodies.items()}
    members = {body: of for body, of in members.items() if of.any()}
    header = [CELL, *(f"{body} ({of.sum()})" for body, of in members.items())]
    rows = []
    for method, found in errors.items():
        row = [method]
        for of in members.values():
            similarity, camera, rotation = (
                np.nanmean(found[metric][of]) for metric in ERRORS
            )
            row.append(f"{similarity:.3f} / {camera:.3f} / {rotation:.1f}")
        rows.append(row)
    return header, rows


def case_of(
    body: str,
    item: str,
    images: shapefit.Landmarks,
    shapes: shapefit.Shapes,
    fits: Mapping[str, shapefit.Fit],
) -> Case:
    """Return the case of the figure for one image: its item, and the class of its
    body.
    """
    row = (images.items or ()).index(item)
    model = str(images.extras["true_model"][row])
    truth = shapes.shapes[(shapes.items or ()).index(model)]
    fitted: dict[str, Floats] = {}
    moved: dict[str, Floats] = {}
    for name in list(METHODS)[:2]:
        fit = fits[name]
        through_camera = fit.landmarks_fitted
        flat = fit.shapes[row, :, :2]
        fitted[name] = flat if through_camera is None else through_camera[row]
        own = fit.shapes[row].T
        moved[name] = similarity_transform(own, truth.T).apply(own).T
    return Case(body, truth, images.landmarks[row], fitted, moved)


def write_bodies(folder: Path, path: Path, bodies: Bodies) -> str:
    """Measure the cars by class of body, write bodies.md and bodies.png into the
    folder, and return the page.

    path is the file of shapes; where it is missing nothing is written, and the page
    says so. bodies: class of body -> names of its cars.
    """
    from experiments.figures import draw_cars

    if not path.exists():
        return (
            f"Sedan, SUV and pick-up side by side are left out: there is no {path}.\n"
        )
    shapes = shapefit.read_shapes(path)
    table, cases = measure_bodies(shapes, bodies)
    page = "\n\n".join(
        [
            "# Cars by class of body",
            (
                f"Images of {len(shapes)} cars, {VIEWS} around each, with {VISIBLE}"
                " visible landmarks through a perspective camera; each is lifted with"
                " the other cars. In brackets how many images there are."
            ),
            table,
            "![Sedan, SUV and pick-up by both methods](bodies.png)",
        ]
    )
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "bodies.md").write_text(page + "\n", encoding="utf-8")
    edges = np.asarray(shapes.edges)
    draw_cars(cases, edges).savefig(folder / "bodies.png", dpi=150)
    return page + "\n"
