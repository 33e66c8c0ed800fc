"""Two sides of a comparison, in turns: A B A B, so that what else the machine does hits both."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np

WORKER = Path(__file__).with_name("worker.py")


@dataclass(frozen=True)
class Turn:
    """Seconds of one run, the share of images that ended well, and a sum of what it found."""

    seconds: float
    well: float = 1.0
    sum: float = 0.0


@dataclass(frozen=True)
class Comparison:
    """How many times faster the second side is: the median of the ratios of neighbouring turns.

    With the median seconds of either, the smallest share of images that ended well, and the
    relative change of the sum.
    """

    ratio: float
    before: float
    now: float
    well_before: float
    well: float
    change: float = 0.0


Side = Callable[[], Turn]

NO_SPINNING = {"OPENBLAS_THREAD_TIMEOUT": "4"}
"""Threads of BLAS sleep at once. By default they wait for 25 ms by turning round, which counts as
time of the processor: short turns took up to twice as long, in one process and not in the next.
"""


class Worker:
    """A process of worker.py, warm; each call is one turn."""

    def __init__(self, python: Path, job: str, data: Path, options: dict[str, object]) -> None:
        told = [f"{key}={value}" for key, value in options.items()]
        self._process = subprocess.Popen(
            [str(python), "-P", str(WORKER), job, str(data), *told],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            cwd="/",
            env=os.environ | NO_SPINNING,
        )
        self._read()

    def __call__(self) -> Turn:
        """Take a turn."""
        assert self._process.stdin
        self._process.stdin.write("go\n")
        self._process.stdin.flush()
        return Turn(**json.loads(self._read()))

    def __enter__(self) -> Worker:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.communicate()

    def _read(self) -> str:
        assert self._process.stdout
        line = self._process.stdout.readline()
        if not line:
            raise RuntimeError(f"a worker ended with exit code {self._process.wait()}")
        return line


def compare(before: Side, now: Side, repeats: int) -> Comparison:
    """Run both in turns and summarise."""
    turns = [(before(), now()) for _ in range(repeats)]
    ratios = [old.seconds / new.seconds for old, new in turns]
    return Comparison(
        ratio=float(np.median(ratios)),
        before=float(np.median([old.seconds for old, _ in turns])),
        now=float(np.median([new.seconds for _, new in turns])),
        well_before=min(old.well for old, _ in turns),
        well=min(new.well for _, new in turns),
        change=turns[-1][1].sum / (turns[-1][0].sum or 1.0) - 1.0,
    )


def compare_workers(
    before: tuple[Path, dict[str, object]],
    now: tuple[Path, dict[str, object]],
    job: str,
    data: Path,
    repeats: int,
) -> Comparison:
    """Compare two environments, each with its options, at one job."""
    with ExitStack() as stack:
        old, new = (
            stack.enter_context(Worker(python, job, data, options))
            for python, options in (before, now)
        )
        return compare(old, new, repeats)
