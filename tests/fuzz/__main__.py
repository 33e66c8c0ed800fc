"""`python -m tests.fuzz`: many spoiled inputs, each read in a fork; exit code 1 for
findings.
"""

from __future__ import annotations

import argparse
import faulthandler
import gc
import importlib
import os
import random
import re
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass, field
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

import h5py
import numpy as np
from shapefit.cli.main import run as run_command

import shapefit
from tests.fuzz.kinds import FINDINGS, KINDS, edit, make_base_files

BLOCK = 250
"""Seeds of each kind that a process runs."""

SECONDS = 20
"""Of the processor, for one case."""

BYTES = 4 << 30
"""Of memory, for one case."""

ALLOWED = (0, 1, 2)
"""Exit codes: all went well, some items failed, the input is wrong."""

PYTHON = re.compile(
    r"NoneType|object is not|object has no|not supported between|unhashable|unpack\b"
    r"|cannot reshape|broadcast|invalid literal|could not convert|string to float"
    r"|index \d+ is out of bounds|index out of range"
    r"|subscriptable|positional argument|codec can't"
    r"|it has no ['\d]|list indices|dtype|must be str|bytes-like|KeyError|ValueError"
    r"|TypeError|IndexError|AttributeError|iterable|inhomogeneous|Input should"
)
"""Words of Python, NumPy and pydantic that no message has."""

CRASHES = (signal.SIGSEGV, signal.SIGABRT, signal.SIGBUS, signal.SIGFPE, signal.SIGILL)

IN_MEMORY = Path("/dev/shm")
"""Folder of files that no disk has to hold."""


class Case(NamedTuple):
    """The case of a kind and a seed: the same on every machine."""

    kind: str
    seed: int


@dataclass
class Tally:
    """What came of the cases so far: exit codes, and descriptions of what must not
    happen.
    """

    codes: Counter[str] = field(default_factory=Counter)
    findings: list[str] = field(default_factory=list)

    def __str__(self) -> str:
        counts = ", ".join(
            f"{code}: {number}" for code, number in sorted(self.codes.items())
        )
        cases = sum(self.codes.values())
        return f"{cases} cases; exit codes {counts}; {len(self.findings)} findings"


def main() -> int:
    """Run the cases of consecutive seeds, kind by kind, and print what is wrong."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--cases", type=int, default=50_000)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument(
        "--past", action="store_true", help="what once failed, and nothing else"
    )
    parser.add_argument("--kinds", nargs="+", default=list(KINDS), choices=list(KINDS))
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    arguments = parser.parse_args()
    seeds = range(
        arguments.first, arguments.first - (-arguments.cases // len(arguments.kinds))
    )
    blocks = [
        [
            Case(kind, seed)
            for seed in seeds[at : at + BLOCK]
            for kind in arguments.kinds
        ]
        for at in range(0, len(seeds), BLOCK)
    ]
    if arguments.past:
        blocks = [[Case(name, 0) for name in FINDINGS]]
    # Each in a process of its own: libraries that spoil files keep some of the memory.
    whole = Tally()
    with get_context("spawn").Pool(max(arguments.jobs, 1), maxtasksperchild=1) as pool:
        for tally in pool.imap_unordered(run, blocks):
            whole.codes += tally.codes
            whole.findings += tally.findings
            print(whole, flush=True)
    return 1 if whole.findings else 0


def run(cases: list[Case]) -> Tally:
    """Run cases in copies of a folder of good files, and print what is wrong."""
    tally = Tally()
    with tempfile.TemporaryDirectory(
        dir=IN_MEMORY if IN_MEMORY.is_dir() else None
    ) as folder:
        base = Path(folder) / "base"
        work = Path(folder) / "case"
        base.mkdir()
        with silenced():
            make_base_files(base)
            import_all()
        for case in cases:
            shutil.rmtree(work, ignore_errors=True)
            shutil.copytree(base, work)
            for finding in run_case(case, work, tally):
                print(finding, flush=True)
                tally.findings.append(finding)
    return tally


def import_all() -> None:
    """Import the whole package, which the cases, being forks, then need not do."""
    package = Path(shapefit.__file__).parent
    for file in package.rglob("[!_]*.py"):
        with suppress(ImportError):  # of libraries that are optional
            name = ".".join(file.relative_to(package.parent).with_suffix("").parts)
            importlib.import_module(name)
    gc.collect()
    gc.freeze()


@contextmanager
def silenced() -> Iterator[None]:
    """Send what the commands print to nowhere."""
    with (
        open(os.devnull, "w") as nowhere,
        redirect_stdout(nowhere),
        redirect_stderr(nowhere),
    ):
        yield


def run_case(case: Case, folder: Path, tally: Tally) -> Iterator[str]:
    """Spoil the files in the folder, run the command there, and yield what is wrong
    with that.
    """
    command = case_command(case, folder)
    before = set(os.listdir(folder))
    status, usage = in_child(lambda: run_command(command), folder)
    text = (folder / "stderr").read_text(errors="surrogateescape")
    code = os.waitstatus_to_exitcode(status)
    if -code in CRASHES and _crashes_h5py(folder):
        tally.codes["crash of libhdf5"] += 1
        return
    tally.codes[str(code)] += 1
    new = set(os.listdir(folder)) - before - {"stderr", "stdout"}
    late = code == -signal.SIGXCPU or usage.ru_utime + usage.ru_stime > SECONDS
    lines = text.split("\n")
    faults = {
        f"takes more than {SECONDS} s": late,
        f"exit code {code}": not late and code not in ALLOWED,
        f"takes {usage.ru_maxrss >> 10} MB": usage.ru_maxrss * 1024 > BYTES,
        "Python speaks on standard error": (
            "Traceback" in text
            or any("Warning: " in line.removeprefix("Warning: ") for line in lines)
        ),
        "a message in words of Python": bool(PYTHON.search(text)),
        "the message is not plain text": not all(line.isprintable() for line in lines),
        f"leaves {new}": any("partial" in name for name in new),
        f"refuses its input and writes {new}": code == 2 and bool(new - {"out"}),
        "writes nan without a word": (
            code == 0 and "out.h5" in new and not _is_finite(folder / "out.h5")
        ),
    }
    words = " ".join(map(ascii, command))
    for fault in (text for text, holds in faults.items() if holds):
        yield f"{case.kind} {case.seed}: {fault}\n    {words}\n    {text[-3000:]!r}"


def case_command(case: Case, folder: Path) -> tuple[str, ...]:
    """Spoil the files in the folder; returns the command line that reads them."""
    if case.kind in FINDINGS:
        name, changes, command = FINDINGS[case.kind]
        if name:
            edit(folder / name, changes)
        return command
    try:
        return KINDS[case.kind](random.Random(f"{case.kind}{case.seed}"), folder)
    except Exception as error:
        error.add_note(f"in the fuzzer itself, making the case {case}")
        raise


def in_child(
    work: Callable[[], int], folder: Path
) -> tuple[int, resource.struct_rusage]:
    """Run in a fork whose streams are files of the folder; returns its status and what
    it took.
    """
    child = os.fork()
    if child == 0:
        become(folder)
        code = 70
        try:
            code = work()
            sys.stdout.flush()
            sys.stderr.flush()
        except SystemExit as error:
            code = error.code if isinstance(error.code, int) else 70
        finally:
            os._exit(code)
    deadline = time.monotonic() + 3 * SECONDS
    while True:
        pid, status, usage = os.wait4(child, os.WNOHANG)
        if pid:
            return status, usage
        if time.monotonic() > deadline:
            os.kill(child, signal.SIGXCPU)
        time.sleep(0.002)


def become(folder: Path) -> None:
    """Make a forked process ready to be a command in the folder."""
    os.chdir(folder)
    for number, name in enumerate(("/dev/null", "stdout", "stderr")):
        flags = os.O_RDONLY if number == 0 else os.O_WRONLY | os.O_CREAT | os.O_TRUNC
        os.dup2(os.open(name, flags, 0o600), number)
    sys.stdin = open(0, closefd=False)  # noqa: SIM115
    sys.stdout = open(1, "w", closefd=False)  # noqa: SIM115
    sys.stderr = open(2, "w", closefd=False, errors="backslashreplace")  # noqa: SIM115
    resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, 2 * SECONDS))
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * os.sysconf("SC_PAGE_SIZE") + BYTES
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    faulthandler.dump_traceback_later(2 * SECONDS)  # where it stands still
    signal.signal(signal.SIGXCPU, signal.SIG_DFL)


def _crashes_h5py(folder: Path) -> bool:
    """Whether h5py alone crashes on a file of the folder: then the fault is that of
    libhdf5.
    """

    def read(name: str, node: object) -> None:
        if isinstance(node, h5py.Dataset) and node.size < 10**6:
            node[()]

    def read_all() -> int:
        for path in folder.glob("*.h5"):
            with suppress(Exception), h5py.File(path, "r") as file:
                list(file.attrs.items())
                file.visititems(read)
        return 0

    return os.waitstatus_to_exitcode(in_child(read_all, folder)[0]) < 0


def _is_finite(path: Path) -> bool:
    """Whether what was learned or fitted holds numbers throughout."""
    with h5py.File(path) as file:
        names = [name for name in ("atoms", "mean_shape") if name in file]
        return all(np.isfinite(file[name][()]).all() for name in names)


if __name__ == "__main__":
    from tests.fuzz import __main__ as by_name  # by which processes find its functions

    sys.exit(by_name.main())
