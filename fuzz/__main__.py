"""`python -m fuzz`: many cases, shared by processes; exit code 1 where one of them fails."""

from __future__ import annotations

import argparse
import gc
import importlib
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from pathlib import Path

import shapefit

from .base_files import make_base_files
from .campaign import run_cases
from .case import Case
from .kinds import KINDS
from .past_findings import FINDINGS, SEEDS

IN_MEMORY = Path("/dev/shm")
"""Folder of files that no disk has to hold."""


def main() -> int:
    """Run the cases of consecutive seeds, kind by kind, and print what is wrong."""
    parser = argparse.ArgumentParser(prog="python -m fuzz", description=__doc__)
    parser.add_argument("--cases", type=int, default=50_000)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--past", action="store_true", help="what once failed, and nothing else")
    parser.add_argument("--kinds", nargs="+", default=list(KINDS), choices=list(KINDS))
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    arguments = parser.parse_args()
    if arguments.past:
        return run([*(Case(name, 0) for name in FINDINGS), *(Case(*seed) for seed in SEEDS)])
    jobs = max(arguments.jobs, 1)
    if jobs == 1:
        seeds = range(
            arguments.first, arguments.first + -(-arguments.cases // len(arguments.kinds))
        )
        return run([Case(kind, seed) for seed in seeds for kind in arguments.kinds])
    # Processes of their own: a fork of a process that has threads can stand still.
    share = -(-arguments.cases // jobs)
    per_kind = -(-share // len(arguments.kinds))
    command = [sys.executable, "-m", "fuzz", "--jobs", "1", "--cases", str(share)]
    command += ["--kinds", *arguments.kinds]
    parts = [
        subprocess.Popen([*command, "--first", str(arguments.first + number * per_kind)])
        for number in range(jobs)
    ]
    return max(part.wait() for part in parts)


def run(cases: list[Case]) -> int:
    """Run cases in this process, and print what is wrong and how many there were."""
    began = time.monotonic()
    with tempfile.TemporaryDirectory(dir=IN_MEMORY if IN_MEMORY.is_dir() else None) as folder:
        base, work = Path(folder) / "base", Path(folder) / "work"
        base.mkdir()
        work.mkdir()
        with silenced():
            make_base_files(base)
            import_all()
        tally = run_cases(cases, base, work)
    print(f"{tally}; {time.monotonic() - began:.0f} s")
    return 1 if tally.findings else 0


def import_all() -> None:
    """Import the whole package, which the cases, being forks, then need not do."""
    package = Path(shapefit.__file__).parent
    for file in package.rglob("[!_]*.py"):
        with suppress(ImportError):  # of libraries that are optional
            importlib.import_module(
                ".".join(file.relative_to(package.parent).with_suffix("").parts)
            )
    gc.collect()
    gc.freeze()


@contextmanager
def silenced() -> Iterator[None]:
    """Send what the commands print to nowhere."""
    with open(os.devnull, "w") as nowhere, redirect_stdout(nowhere), redirect_stderr(nowhere):
        yield


if __name__ == "__main__":
    sys.exit(main())
