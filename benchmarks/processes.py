"""Commands run as processes of their own: seconds, time of the processor, and memory."""

from __future__ import annotations

import os
import re
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path

import psutil

WAIT = 0.1
"""Seconds between two looks at the memory of the processes."""


@dataclass(frozen=True)
class Watched:
    """What a command took: seconds, those of all processors, and the most memory in bytes.

    peaks of the command itself, whose number is 0, and of each process that it started.
    """

    seconds: float
    processor: float
    peaks: dict[int, int]

    @property
    def peak(self) -> int:
        """Of the command itself."""
        return self.peaks[0]


def watch(command: list[str], folder: Path) -> Watched:
    """Run a command to its end. Raises SystemExit where it fails."""
    before, began = spent(), time.perf_counter()
    peaks: dict[int, int] = {}
    process = subprocess.Popen(command, cwd=folder, stdout=subprocess.DEVNULL)
    own = psutil.Process(process.pid)
    while process.poll() is None:
        for number in (process.pid, *children(own)):
            key = 0 if number == process.pid else number
            peaks[key] = max(peaks.get(key, 0), peak_of(number))
        time.sleep(WAIT)
    if process.returncode:
        raise SystemExit(process.returncode)
    return Watched(time.perf_counter() - began, spent() - before, peaks)


def spent() -> float:
    """Return the processor's seconds of all processes that were started here and have ended."""
    times = os.times()
    return times.children_user + times.children_system


def peak_of(number: int) -> int:
    """Return the most bytes that a process held so far, 0 where it has ended.

    What `getrusage` says begins with the peak of the process that started it.
    """
    try:
        status = Path(f"/proc/{number}/status").read_text()
    except (FileNotFoundError, ProcessLookupError):
        return 0
    found = re.search(r"VmHWM:\s+(\d+)", status)
    return 1024 * int(found[1]) if found else 0


def children(process: psutil.Process) -> list[int]:
    """Return the numbers of the processes that a process has started, none where it has ended."""
    try:
        return [each.pid for each in process.children(recursive=True)]
    except psutil.NoSuchProcess:
        return []
