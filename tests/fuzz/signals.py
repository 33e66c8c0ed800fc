"""Signals at random moments of long runs: `python -m tests.fuzz.signals`.

Each run is sent SIGINT or SIGTERM after so much time of the processor, and is to end
within SOON of it, with its exit code and without half a file. The times that they take
are printed.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from shapefit.dictionary.mixture import Mixture
from shapefit.dictionary.model import Dictionary
from shapefit.io import landmark_writer, write_dictionary
from shapefit.records import Landmarks

SOON = 0.5
"""Seconds of the processor from a signal to the end."""

TICK = os.sysconf("SC_CLK_TCK")
PEOPLE = Path(__file__).parents[2] / "sample_data/people_train.h5"


def main() -> int:
    """Send signals; exit code 1 where a run ends late or wrongly."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.fuzz.signals", description=__doc__
    )
    parser.add_argument("--count", type=int, default=50, help="signals in each case")
    parser.add_argument(
        "--longest", type=float, default=8.0, help="second up to which signals come"
    )
    parser.add_argument("--only", choices=CASES, action="append")
    arguments = parser.parse_args()
    faults = 0
    for case in arguments.only or CASES:
        with tempfile.TemporaryDirectory() as name:
            command = CASES[case](Path(name))
            rng = random.Random(case)
            answers: list[float] = []
            while len(answers) < arguments.count:
                seconds, fault = interrupt(
                    command, rng.uniform(0, arguments.longest), rng
                )
                if seconds is not None:
                    answers.append(seconds)
                if fault or (seconds or 0) > SOON:
                    faults += 1
                    print(f"{case}: {fault or 'late'}, {seconds} s", flush=True)
            shares = np.percentile(answers, [50, 90, 100])
            text = ", ".join(f"{value:.2f}" for value in shares)
            print(
                f"{case}: {len(answers)} signals, median, nine in ten, last: {text} s"
            )
    return 1 if faults else 0


def interrupt(
    command: list[str], moment: float, rng: random.Random
) -> tuple[float | None, str]:
    """Run a command and send it a signal at a moment of its time of the processor,
    from when on it has handlers.

    Returns the time from there to its end, None where the run was over before, and what
    is wrong with it, "" for nothing.
    """
    number = rng.choice([signal.SIGINT, signal.SIGTERM])
    folder = Path(command[-1]).parent
    process = subprocess.Popen(
        [sys.executable, "-P", "-m", "shapefit", *command, "-q"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
        # A shell has it ignored by what it starts in the background.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    begin = first = None
    while (spent := seconds_of(process.pid)) is not None:
        if begin is None and is_running(process.pid):
            begin = spent
        if begin is not None and spent - begin >= moment:
            first = spent
            process.send_signal(number)
            break
        time.sleep(0.005)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = code = os.waitstatus_to_exitcode(status)
    left = [path.name for path in folder.iterdir() if "out" in path.name]
    for name in left:
        (folder / name).unlink()
    if code == 0:
        return None, ""
    if first is None:
        return 0.0, f"ends with {code} by itself"
    if code != 128 + number:
        return 0.0, f"signal {number}: ends with {code}"
    if left:
        return 0.0, f"signal {number}: leaves {left}"
    return max(usage.ru_utime + usage.ru_stime - first, 0.0), ""


def seconds_of(process: int) -> float | None:
    """Return the time of the processor that a process has taken; None after its end."""
    try:
        text = Path(f"/proc/{process}/stat").read_text()
    except OSError:
        return None
    fields = text.rpartition(")")[2].split()
    if fields[0] == "Z":
        return None
    return (int(fields[11]) + int(fields[12])) / TICK


def is_running(process: int) -> bool:
    """Return whether a process answers signals: whether it has handlers of its own for
    both.
    """
    try:
        lines = Path(f"/proc/{process}/status").read_text().splitlines()
    except OSError:
        return False
    caught = next(int(line.split()[1], 16) for line in lines if "SigCgt" in line)
    return all(caught >> (number - 1) & 1 for number in (signal.SIGINT, signal.SIGTERM))


def write_views(path: Path, n: int, p: int) -> None:
    """Write n images of p random landmarks."""
    landmarks = np.random.default_rng(1).normal(size=(n, p, 2))
    names = tuple(f"p{j}" for j in range(p))
    items = tuple(f"image{i}" for i in range(n))
    with landmark_writer(path) as writer:
        writer.append(Landmarks(landmarks, landmark_names=names, items=items))


def write_atoms(path: Path, k: int, p: int, prior: Mixture | None = None) -> None:
    """Write a dictionary of random atoms."""
    atoms = np.random.default_rng(0).normal(size=(k, 3, p))
    names = tuple(f"p{j}" for j in range(p))
    variance = None if prior is None else np.array([0.003])
    made = Dictionary(atoms, names, atoms[0], prior=prior, residual_variance=variance)
    write_dictionary(path, made)


def fit(folder: Path, n: int, k: int, p: int, *options: str) -> list[str]:
    """Return the command that lifts n images with k atoms of p landmarks."""
    if not (folder / "atoms.h5").exists():
        write_atoms(folder / "atoms.h5", k, p)
    write_views(folder / "views.h5", n, p)
    given = ["fit", str(folder / "views.h5"), "-d", str(folder / "atoms.h5")]
    return [*given, *options, "-o", str(folder / "out.h5")]


def convex(folder: Path) -> list[str]:
    """p = 1000, k = 2000."""
    return fit(folder, 4, 2000, 1000, "--method", "convex")


def search(folder: Path) -> list[str]:
    """All rotations of many images."""
    return fit(folder, 4096, 64, 15, "--method", "global")


def posterior(folder: Path) -> list[str]:
    """p = 120."""
    p, components = 120, 16
    means = np.random.default_rng(2).normal(size=(components, 3, p))
    covariances = np.tile(0.1 * np.eye(3 * p), (components, 1, 1))
    prior = Mixture(np.full(components, 1 / components), means, covariances)
    write_atoms(folder / "atoms.h5", 16, p, prior)
    return fit(folder, 1024, 16, p, "--method", "posterior")


def learn(folder: Path) -> list[str]:
    """A dictionary of people with a prior."""
    prior = ["--set", "prior.components=32", "--set", "iterations=50"]
    return ["learn-dict", str(PEOPLE), *prior, "-o", str(folder / "out.h5")]


CASES: dict[str, Callable[[Path], list[str]]] = {
    "convex": convex,
    "global": search,
    "posterior": posterior,
    "learn-dict": learn,
}
"""What makes the files and the command of each case."""


if __name__ == "__main__":
    sys.exit(main())
