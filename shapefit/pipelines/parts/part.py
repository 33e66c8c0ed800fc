"""One part of a fit: what a worker does, wherever it runs."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from shapefit.config import FitConfig
from shapefit.errors import InputError
from shapefit.pipelines.fit.run import run
from shapefit.pipelines.outcome import Counted, Failure, add_up
from shapefit.pipelines.parts.plan import Part
from shapefit.stores.opening import StoreError
from shapefit.stores.options import use_storage_options
from shapefit.stores.shelf import own_shelf
from shapefit.stores.states import find_state

MOST_TOLD = 20
"""Failures and warnings of a part that its worker reports one by one."""


@dataclass(frozen=True)
class Job:
    """A part, the config of the whole run, as a worker gets them, and where its result goes."""

    part: Part
    config: FitConfig
    folder: Path


@dataclass(frozen=True)
class Done:
    """What became of a part; `error` says why it has no result."""

    part: Part
    images: int = 0
    failed: int = 0
    failures: tuple[Failure, ...] = ()
    warnings: tuple[str | Counted, ...] = ()
    seconds: float = 0.0
    bytes: int = 0
    error: str | None = None

    def entry(self) -> dict[str, Any]:
        """Return what the manifest says of the part, beside its inputs."""
        return {
            "images": self.images,
            "failed": self.failed,
            "failures": [[failure.item, failure.reason] for failure in self.failures],
            "seconds": round(self.seconds, 3),
            "bytes": self.bytes,
        }


def fit_part(job: Job) -> Done:
    """Lift the images of a part and write its result, whole or not at all.

    `error` says what is wrong with its input; everything else propagates, so that the part
    can be tried again.
    """
    began = time.perf_counter()
    use_storage_options(job.config.storage_options)
    with own_shelf():
        return _fit(job, began)


def _fit(job: Job, began: float) -> Done:
    target = job.folder / job.part.file
    update = {"landmarks": job.part.inputs, "output": target}
    config = job.config.model_copy(update=update)
    rows = None if job.part.rows is None else slice(*job.part.rows)
    images, failed = 0, 0
    failures: list[Failure] = []
    warnings: dict[str, str | Counted] = {}
    try:
        for outcome in run(config, rows):
            images += outcome.done
            failed += len(outcome.failures)
            failures += outcome.failures[: MOST_TOLD - len(failures)]
            for warning in outcome.warnings[: MOST_TOLD - len(warnings)]:
                add_up(warnings, warning)
    except StoreError:  # which may be over when it is tried again
        raise
    except InputError as error:
        return Done(job.part, error="; ".join(error.problems))
    size, _ = find_state(target) or (0, "")
    return Done(
        job.part,
        images,
        failed,
        tuple(failures),
        tuple(warnings.values()),
        time.perf_counter() - began,
        size,
    )
