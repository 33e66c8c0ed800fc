"""What the functions tell: warnings, progress, and errors of arrays without names."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TypeVar

from shapefit.errors import InputError, input_error, listed
from shapefit.io.skeletons import skeletons_of_size
from shapefit.pipelines.result import Note, Result
from shapefit.records import Landmarks, Record

Step = TypeVar("Step")


def warn(messages: Iterable[object]) -> None:
    """Issue a Python warning, at the user's line, for each message that is no Note."""
    level = _stacklevel_of_user()
    for message in messages:
        if not isinstance(message, Note):
            warnings.warn(str(message), stacklevel=level)


def _stacklevel_of_user() -> int:
    """Return the `stacklevel`, in `warn`, of the first caller outside the package."""
    frame = sys._getframe(1)
    level = 1
    while frame.f_back and _is_ours(str(frame.f_globals.get("__name__"))):
        frame = frame.f_back
        level += 1
    return level


def _is_ours(module: str) -> bool:
    """Whether a module, by its name, belongs to the package."""
    return module.partition(".")[0] == "shapefit"


def show_progress(
    steps: Iterable[Step],
    result_of: Callable[[Step], Result],
    *,
    wanted: bool,
    unit: str,
    total: int | None = None,
) -> Iterator[Step]:
    """Yield steps of a run; where `wanted`, show a progress bar of them.

    total is that of all steps, where it is known before they say it.
    """
    if not wanted:
        yield from steps
        return
    with warnings.catch_warnings():
        # where ipywidgets are missing, a notebook gets the bar as text
        warnings.simplefilter("ignore")
        from tqdm.auto import tqdm

    with tqdm(total=total, unit=f" {unit}", desc="shapefit") as bar:
        for step in steps:
            yield step
            result = result_of(step)
            if total is None and result.total is not None:
                bar.total = result.total
            bar.update(result.done)


def with_names(record: Record, names: Sequence[str]) -> Record:
    """Return a record whose unnamed landmarks are called `names`, and items numbered.

    Names of its own stay. Raises InputError where `names` are too few or too many.
    """
    p = record.points.shape[1]
    if not record.landmark_names and len(names) != p:
        raise unnamed_error(record.POINTS, p, names)
    return record.named(names)


def unnamed_error(dataset: str, p: int, names: Sequence[str]) -> InputError:
    """Return the InputError for p unnamed landmarks of a dataset, more or fewer than
    `names`.
    """
    skeletons = skeletons_of_size(p) if dataset == Landmarks.POINTS else ()
    fix = f"name them: {dataset.title()}({dataset}, landmark_names=[...])"
    if skeletons:
        fix = f"name them, as in {listed(f'`keypoints={name}`' for name in skeletons)}"
    return input_error(
        dataset, f"has {p} landmarks without names, not {len(names)}", fix
    )
