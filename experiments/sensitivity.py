"""Error and time against one setting that varies: the sensitivity of a method, and its
speed.
"""

from __future__ import annotations

import csv
import math
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

import shapefit
from shapefit.api.arguments import Metric
from shapefit.arrays import Flags, Floats
from shapefit.evaluation.report import ALL, decimals_of, format_number, markdown_table

PROJECT = Path(__file__).resolve().parents[1]
CONFIGS, RESULTS = PROJECT / "configs", PROJECT / "results"
DATA = PROJECT.parent / "shared" / "data"
GROUPS = {"Subject 13": "13_*", "Subject 14": "14_*"}
WARM_UP = 8
"""Images to fit before the clock runs."""

BATCH = 1024
MARGIN = 0.1
"""By what share of its size the box in which wrong points lie is grown on each side."""

CORRUPTION = 4
"""Purpose of the random numbers that make landmarks wrong."""

OF_THE_CARS = {
    "leave_one_out": "true_model",
    "camera": {"focal": "files", "principal_point": [0, 0]},
}
"""What belongs to the data is not taken from a config in Python."""

Value = str | int | float
Given = tuple[shapefit.Landmarks, shapefit.Dictionary]


@dataclass(frozen=True)
class Experiment:
    """Fits at each value of a setting, `key`, and the truth that they are compared
    with.

    given: value -> images and dictionary; options: value -> arguments of
    `shapefit.fit`, whose config is `config`. Every `every`-th image is fitted.
    """

    name: str
    key: str
    values: tuple[Value, ...]
    config: Path
    given: Callable[[Value], Given]
    truth: Callable[[], shapefit.Shapes]
    options: Callable[[Value], dict[str, Any]] = lambda _: {}
    metrics: tuple[Metric, ...] = ("similarity",)
    match: str = "item"
    groups: Mapping[str, str] = field(default_factory=dict)
    every: int = 1


@dataclass(frozen=True)
class Point:
    """Errors of an experiment at one value of its setting, in one metric, of one group
    of sequences; and the time of an image.

    Statistics of a group are the means of those of its sequences.
    """

    key: str
    value: Value
    group: str
    metric: str
    unit: str
    images: int
    failed: int
    mean: float
    p25: float
    median: float
    p75: float
    p90: float
    seconds_per_image: float


def paper_experiments(data: Path) -> Iterator[Experiment]:
    """Yield the experiments on motion capture: the time of the methods, and the convex
    program against lambda, noise, hidden landmarks, k, and the trials learned from.
    """

    def read_truth() -> shapefit.Shapes:
        return shapefit.read_shapes(*(data / f"subject{n}_24fps.h5" for n in (13, 14)))

    @cache
    def project(settings: tuple[str, ...] = ()) -> shapefit.Landmarks:
        """Return the images of `make mocap-table`, or projected with these settings."""
        path = RESULTS / "mocap/landmarks.h5"
        if settings:
            path = path.with_name("varied.h5")
            run(
                "project",
                "-c",
                CONFIGS / "mocap/project.yaml",
                "-o",
                path,
                *(f"--set={each}" for each in (f"data={data}", *settings)),
            )
        return shapefit.read_landmarks(path)

    @cache
    def learn_atoms(k: int) -> shapefit.Dictionary:
        path = RESULTS / "mocap/varied-dictionary.h5"
        run(
            "learn-dict",
            "-c",
            CONFIGS / "mocap/learn-dict.yaml",
            "-o",
            path,
            f"--set=data={data}",
            f"--set=k={k}",
        )
        return shapefit.read_dictionary(path)

    def learn_from_trials(trials: Value) -> shapefit.Dictionary:
        """Return a dictionary of some trials of subject 86, such as "1-4"."""
        first, last = map(int, str(trials).split("-"))
        shapes = shapefit.read_shapes(data / "subject86_24fps.h5")
        sequences = np.array(shapes.sequences)
        chosen = sorted(set(sequences.tolist()))[first - 1 : last]
        few = shapes[np.isin(sequences, chosen)]
        names = list(read_dictionary().landmark_names or ())
        return shapefit.learn(few, k=64, every=3, landmarks=names)

    @cache
    def read_dictionary(name: str = "mocap/dictionary.h5") -> shapefit.Dictionary:
        return shapefit.read_dictionary(RESULTS / name)

    def project_with(key: str, value: Value) -> Given:
        return project((f"{key}={value}",)), read_dictionary()

    configs = CONFIGS / "paper"
    convex = Experiment(
        "sensitivity-lambda",
        "lambda",
        (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1),
        configs / "fit-convex.yaml",
        lambda _: (project(), read_dictionary()),
        read_truth,
        options=lambda value: {"lam": value},
        groups=GROUPS,
        every=20,
    )
    timing = replace(
        convex,
        name="timing",
        key="method",
        values=("convex", "convex+refine", "alternate", "mean-shape"),
        config=configs / "fit-alternate-six-views.yaml",
        options=lambda method: {"method": method, **_start_option(method)},
        every=10,
    )
    yield timing
    yield replace(
        timing,
        name="timing-pmp",
        values=("pmp",),
        config=configs / "fit-pmp.yaml",
        given=lambda _: (project(), read_dictionary("paper/dictionary-pmp.h5")),
    )
    yield convex
    plain: dict[str, Any] = {"options": lambda _: {}}
    for key, values in (
        ("noise", (0, 0.01, 0.02, 0.03, 0.05, 0.08)),
        ("hidden", (0, 0.1, 0.2, 0.3, 0.4, 0.5)),
    ):
        yield replace(
            convex,
            name=f"sensitivity-{key}",
            key=key,
            values=values,
            given=partial(project_with, key),
            **plain,
        )
    yield replace(
        convex,
        name="sensitivity-k",
        key="k",
        values=(8, 16, 32, 64, 128),
        given=lambda k: (project(), learn_atoms(int(k))),
        **plain,
    )
    yield replace(
        convex,
        name="sensitivity-training",
        key="trials of subject 86",
        values=("1-8", "1-4", "5-8", "1-2", "3-4", "5-6", "7-8"),
        given=lambda trials: (project(), learn_from_trials(trials)),
        **plain,
    )


def _start_option(method: Value) -> dict[str, int]:
    """Return `starts` = 1 for alternation, as in the paper; {} for another method."""
    return {"starts": 1} if method == "alternate" else {}


def car_experiments(data: Path) -> Iterator[Experiment]:
    """Yield the experiments on cars with corrupted landmarks: each search for outliers,
    against the share that is corrupted.
    """
    dictionary = shapefit.read_dictionary(RESULTS / "cars/dictionary.h5")
    images = shapefit.read_landmarks(data / "annotated_cars.h5")
    images = arrange(images, tuple(dictionary.landmark_names or ()))

    def corrupt_images(share: Value) -> Given:
        is_used = visible_landmarks(images).sum(axis=1) >= 20
        return corrupt(images, float(share))[is_used], dictionary

    for config in sorted((CONFIGS / "cars").glob("outliers-*.yaml")):
        yield Experiment(
            config.stem,
            "corrupted share",
            (0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7),
            config,
            corrupt_images,
            lambda: shapefit.read_shapes(data / "models.h5"),
            options=lambda _: OF_THE_CARS,
            metrics=("similarity", "camera", "rotation", "precision", "recall"),
            match="true_model",
        )


def run(*arguments: str | Path) -> None:
    """Run a command of shapefit. Raises SystemExit where its exit code is not 0."""
    command = [
        str(Path(sys.executable).with_name("shapefit")),
        *map(str, arguments),
        "--quiet",
    ]
    if subprocess.run(command, check=False).returncode:
        raise SystemExit(f"failed: {' '.join(command)}")


def visible_landmarks(images: shapefit.Landmarks) -> Flags:
    """Return flags (n, p) of the landmarks that have coordinates and, if any confidence
    is known, one above 0.
    """
    seen: Flags = np.asarray(np.isfinite(images.landmarks).all(axis=2))
    return (
        seen
        if images.confidence is None
        else seen & (np.asarray(images.confidence) > 0)
    )


def arrange(images: shapefit.Landmarks, names: tuple[str, ...]) -> shapefit.Landmarks:
    """Return images with the landmarks of these names, in their order; nan where the
    images lack one.
    """
    own = list(images.landmark_names or ())
    columns = [own.index(name) if name in own else len(own) for name in names]

    def reorder(values: Any, missing: float) -> Floats:
        values = np.asarray(values)
        blank = np.full_like(values[:, :1], missing)
        return np.concatenate([values, blank], axis=1)[:, columns]

    confidence = images.confidence
    return images.replaced(
        landmarks=reorder(images.landmarks, np.nan),
        landmark_names=names,
        confidence=None if confidence is None else reorder(confidence, 0.0),
    )


def corrupt(
    images: shapefit.Landmarks, share: float, seed: int = 0
) -> shapefit.Landmarks:
    """Return images with a random `share` of the visible landmarks of each replaced by
    random points, and with the flags of these as the extra `corrupted` (n, p).

    The points are uniform over the bounding box of the visible landmarks grown on each
    side by MARGIN times its size. The number in an image is rounded up or down at
    random; a larger share replaces more of the landmarks, by the same points. What is
    drawn for an image depends on its place alone.
    """
    seen = visible_landmarks(images)
    points = np.array(images.landmarks, dtype=np.float64)
    n, p = seen.shape
    chosen = np.zeros((n, p), dtype=bool)
    for batch, start in enumerate(range(0, n, BATCH)):
        rng = np.random.default_rng(
            np.random.SeedSequence(seed, spawn_key=(CORRUPTION, batch))
        )
        rows = slice(start, min(start + BATCH, n))
        size = rows.stop - start
        own = seen[rows]
        rounding, order = rng.random(BATCH)[:size], rng.random((BATCH, p))[:size]
        place = rng.random((BATCH, 2, p))[:size].swapaxes(1, 2)
        rank = np.where(own, order, np.inf).argsort(axis=1).argsort(axis=1)
        chosen[rows] = rank < np.floor(share * own.sum(axis=1) + rounding)[:, None]
        low = np.where(own[:, :, None], points[rows], np.inf).min(axis=1, keepdims=True)
        high = np.where(own[:, :, None], points[rows], -np.inf).max(
            axis=1, keepdims=True
        )
        with np.errstate(invalid="ignore"):  # images without visible landmarks
            drawn = (
                low - MARGIN * (high - low) + (1 + 2 * MARGIN) * (high - low) * place
            )
        points[rows] = np.where(chosen[rows][:, :, None], drawn, points[rows])
    before = images.extras.get("corrupted")
    wrong = chosen if before is None else chosen | np.asarray(before, bool)
    return images.replaced(
        landmarks=points, extras={**images.extras, "corrupted": wrong}
    )


def measure(experiment: Experiment) -> list[Point]:
    """Run an experiment: fit its images at each value, compare with the truth, and
    return the points.
    """
    points = []
    truth = experiment.truth()
    for value in experiment.values:
        images, dictionary = experiment.given(value)
        images = images[:: experiment.every]
        options = {"config": experiment.config, **experiment.options(value)}
        unwarmed = {key: of for key, of in options.items() if key != "leave_out"}
        shapefit.fit(images[:WARM_UP], dictionary, **unwarmed)
        began = time.perf_counter()
        found = shapefit.fit(images, dictionary, **options)
        seconds = (time.perf_counter() - began) / len(images)
        errors = shapefit.evaluate(
            found, truth, experiment.metrics, experiment.match, groups=experiment.groups
        )
        points += list(points_of(experiment.key, value, errors, seconds))
    return points


def points_of(
    key: str, value: Value, errors: shapefit.Evaluation, seconds: float
) -> Iterator[Point]:
    """Yield the points at a value of the setting `key`: one for each metric, in its
    first unit, and group of sequences.
    """
    units: dict[str, str] = {}
    for metric, unit in errors.errors:
        units.setdefault(metric, unit)
    sequences = np.array(errors.sequences)
    summaries = [s for s in errors.summaries if units[s.metric] == s.unit]
    for whole in (s for s in summaries if s.sequence is None):
        own = errors.errors[whole.metric, whole.unit]
        members = [
            s.sequence
            for s in summaries
            if s.group == whole.group
            and s.metric == whole.metric
            and s.sequence is not None
        ]
        parts = (
            [own]
            if members in ([], [ALL])
            else [own[sequences == name] for name in members]
        )
        known = [part[np.isfinite(part)] for part in parts]
        quartiles = [np.percentile(part, (25, 75)) for part in known if len(part)]
        p25, p75 = (
            np.mean(quartiles, axis=0).tolist() if quartiles else (math.nan, math.nan)
        )
        yield Point(
            key,
            value,
            whole.group,
            whole.metric,
            whole.unit,
            whole.images,
            whole.failed,
            whole.mean,
            p25,
            whole.median,
            p75,
            whole.p90,
            seconds,
        )


def table_of(points: Sequence[Point]) -> str:
    """Return the points as a table in Markdown: values down; mean / median of each
    group and metric, and the time of an image, across.

    Where images failed, the share of those that did not stands behind the errors of
    their group.
    """
    values = list(dict.fromkeys(point.value for point in points))
    columns: dict[str, dict[Value, str]] = {}
    for metric, group, unit in dict.fromkeys(
        (p.metric, p.group, p.unit) for p in points
    ):
        own = [p for p in points if (p.metric, p.group) == (metric, group)]
        before = "" if group == ALL else f"{group}: "
        decimals = decimals_of(n for p in own for n in (p.mean, p.median))
        columns[f"{before}{metric} ({unit})"] = {
            p.value: " / ".join(format_number(n, decimals) for n in (p.mean, p.median))
            for p in own
        }
        if metric not in ("precision", "recall") and any(p.failed for p in own):
            columns[f"{before}with a shape"] = {
                p.value: (
                    f"{math.floor(100 * p.images / (p.images + p.failed) + 1e-9)} %"
                )
                for p in own
            }
    columns["ms per image"] = {
        p.value: f"{1000 * p.seconds_per_image:.3g}" for p in points
    }
    rows = [
        [str(v), *(column.get(v, "–") for column in columns.values())] for v in values
    ]
    return markdown_table([points[0].key, *columns], rows)


def read_points(folder: Path) -> list[Point]:
    """Read the points of an experiment from sweep.csv in its folder; values stay
    text.
    """
    types = {entry.name: entry.type for entry in fields(Point)}
    convert = {"int": int, "float": float}
    with (folder / "sweep.csv").open(newline="", encoding="utf-8") as file:
        return [
            Point(
                **{
                    key: convert.get(str(types[key]), str)(text)
                    for key, text in row.items()
                }
            )
            for row in csv.DictReader(file)
        ]
