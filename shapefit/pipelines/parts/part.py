"""One part of a fit: what a worker does, wherever it runs."""

from __future__ import annotations

import platform
import time
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from shapefit import __version__
from shapefit.config import FitConfig
from shapefit.errors import InputError, input_error
from shapefit.io.names import stable_hashes
from shapefit.pipelines.fit.prepare import Estimates
from shapefit.pipelines.fit.run import run
from shapefit.pipelines.outcome import Counted, Failure, Outcome, add_up
from shapefit.pipelines.parts.equal_items import Span
from shapefit.pipelines.parts.manifest import replace_link
from shapefit.pipelines.parts.plan import Part
from shapefit.stores import State, StoreError, find_state, masked, own_copies, use_storage_options

MOST_TOLD = 20
"""Failures and warnings of a part that its worker reports one by one."""


@dataclass(frozen=True)
class Job:
    """A part, the config of the whole run, as a worker gets them, and where its result goes.

    setup   what was estimated of all parts together
    version  of the program that planned it.
    """

    part: Part
    config: FitConfig
    folder: Path
    setup: Estimates | None = None
    version: str = __version__


@dataclass(frozen=True)
class Done:
    """What became of a part; `error` says why it has no result.

    outcome   what is known of it: its images, and the first failures and warnings
    state     of its result, once that is written
    span      of the names of its images, and the stable hashes of these
    passing   whether another try, or another machine, may do better
    """

    part: Part
    outcome: Outcome = field(default_factory=Outcome)
    failed: int = 0
    seconds: float = 0.0
    state: State = (0, "")
    span: Span | None = None
    hashes: bytes = b""
    error: str | None = None
    passing: bool = False

    def entry(self) -> dict[str, Any]:
        """Return what the manifest says of the part, beside its inputs."""
        return {
            "images": self.outcome.done,
            "failed": self.failed,
            "failures": [[failure.item, failure.reason] for failure in self.outcome.failures],
            "seconds": round(self.seconds, 3),
            "bytes": self.state[0],
            "written": self.state[1],
            "items": None if self.span is None else asdict(self.span),
        }


def fit_part(job: Job) -> Done:
    """Lift the images of a part and write its result, whole or not at all.

    `error` says why it could not be done; what a full disk or a library raises may pass, what is
    wrong with the input stays. Raises InputError where this is not the version that planned it.
    """
    if job.version != __version__:
        found = f"is a worker with shapefit {__version__}, but `fit` is version {job.version}"
        raise input_error(platform.node(), found, "install the same version on all machines")
    began = time.perf_counter()
    use_storage_options(job.config.storage_options)
    with own_copies():
        return _fit(job, began)


def _fit(job: Job, began: float) -> Done:
    target = job.folder / job.part.file
    update = {"landmarks": job.part.inputs, "output": target}
    config = job.config.model_copy(update=update)
    rows = None if job.part.rows is None else slice(*job.part.rows)
    images, failed = 0, 0
    span: Span | None = None
    hashes: list[bytes] = []
    failures: list[Failure] = []
    warnings: dict[str, str | Counted] = {}
    doubts: dict[str, str | Counted] = {}
    try:
        replace_link(target)
        for outcome in run(config, rows, job.setup):
            images += outcome.done
            failed += len(outcome.failures)
            if outcome.items:
                met = Span.of(outcome.items)
                span = span | met if span else met
                hashes.append(stable_hashes(outcome.items).tobytes())
            failures += outcome.failures[: MOST_TOLD - len(failures)]
            add_up(warnings, outcome.warnings, MOST_TOLD)
            add_up(doubts, (replace(doubt, items=()) for doubt in outcome.doubts))
        state = find_state(target) or (0, "")
    except InputError as error:
        cause = error.__cause__
        of_system = isinstance(cause, OSError) and cause.errno is not None
        passing = of_system or isinstance(error, StoreError)
        return Done(job.part, error="; ".join(error.problems), passing=passing)
    except Exception as error:
        return Done(job.part, error=describe(error), passing=True)
    told = Outcome(
        done=images,
        failures=tuple(failures),
        warnings=tuple(warnings.values()),
        doubts=tuple(doubt for doubt in doubts.values() if isinstance(doubt, Counted)),
    )
    return Done(job.part, told, failed, time.perf_counter() - began, state, span, b"".join(hashes))


def describe(error: BaseException) -> str:
    """Return an unexpected error in one line."""
    kind, text = type(error).__name__, masked(str(error).partition("\n")[0])
    return f"{kind}: {text}" if text else kind
