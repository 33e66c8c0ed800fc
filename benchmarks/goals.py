"""What is measured in warm processes, against the release before: one line of the table each."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path

import numpy as np

from benchmarks.cases import cars_case, made_case, mocap_case
from benchmarks.environments import Environment
from benchmarks.inputs import Arrays, bodies, cars, cars_in_perspective, program, training
from benchmarks.pairs import compare_workers
from benchmarks.table import NOISE, Row, compared

Options = dict[str, object]


@dataclass(frozen=True)
class Goal:
    """A job of worker.py on the arrays that `build` makes.

    Both sides run with the same options, unless `instead_of` says that this version is compared
    with itself under other ones. `certified`: every image must be solved to its gap.
    """

    name: str
    job: str
    build: Callable[[], Arrays]
    options: Options
    instead_of: Options | None = None
    certified: bool = False
    repeats: int = 7


def newton(name: str, build: Callable[[], Arrays], tolerance: float = 1e-4) -> Goal:
    """The convex program on one thread."""
    return Goal(name, "newton", build, options(tolerance), certified=True)


def options(tolerance: float = 1e-4, threads: int = 1) -> Options:
    """Options of the solver."""
    return {"tolerance": tolerance, "threads": threads}


def mocap_goals(folder: Path) -> Iterator[Goal]:
    """Motion capture: many images with few landmarks."""
    frames = cache(partial(mocap_case, folder))
    seen = partial(program, frames)
    yield newton("subject 13, gap 1e-4", seen)
    yield newton("subject 13, gap 1e-6", seen, 1e-6)
    yield newton("subject 13, 30% hidden", partial(program, frames, 0.3))
    wall: Options = {"clock": "wall"}
    yield Goal("two threads over one", "newton", seen, options(threads=2) | wall, options() | wall)
    for p, n in ((15, 500), (41, 60), (75, 20)):
        how: Options = {"misfit": 0.006, "threads": 1}
        build = partial(bodies, folder, p, n)
        yield Goal(f"posterior, 32 components, p={p}", "posterior", build, how, repeats=5)
    yield Goal(
        "learn-dict, k=128", "learn", partial(training, folder), {"k": 128} | wall, repeats=3
    )


def cars_goals(folder: Path) -> Iterator[Goal]:
    """Cars: a mask for each image, 66 landmarks."""
    yield newton("cars, p=66", partial(program, partial(cars_case, folder)))
    for method, lam in (("convex+refine", 1.0), ("alternate", 0.1)):
        how: Options = {"method": method, "threads": 1}
        yield Goal(f"cars, {method}", "lift", partial(cars, folder, lam), how)
    one: Options = {"threads": 1}
    yield Goal("cars, perspective", "perspective", partial(cars_in_perspective, folder), one)
    yield Goal("cars, RANSAC", "ransac", partial(cars, folder, 1.0), one)


def grid_goals(quick: bool) -> Iterator[Goal]:
    """Made cases of many sizes, where nothing may be slower than before."""
    for k in (32, 64) if quick else (32, 64, 128, 256):
        for p in (15,) if quick else (15, 33, 66):
            made = cache(partial(made_case, 500 if quick else 2000, k, p))
            for name, hidden in (("", 0.0), (", 30% hidden", 0.3)):
                build = partial(program, made, hidden)
                yield replace(newton(f"made, k={k}, p={p}{name}", build), repeats=3)


def compare_goal(goal: Goal, old: Environment, new: Environment, folder: Path, repeats: int) -> Row:
    """Write the arrays of a goal and let both sides take turns."""
    arrays, data = goal.build(), folder / "arrays.npz"
    np.savez(data, **arrays)
    first = old.python if goal.instead_of is None else new.python
    found = compare_workers(
        (first, goal.instead_of or goal.options),
        (new.python, goal.options),
        goal.job,
        data,
        min(repeats, goal.repeats),
    )
    least = NOISE if goal.instead_of is None else 0.0
    images = len(arrays.get("landmarks", ()))
    return compared(goal.name, found, images=images, certified=goal.certified, least=least)
