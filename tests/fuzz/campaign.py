"""Run cases, each in a process forked from this one, and say what must not happen."""

from __future__ import annotations

import faulthandler
import gc
import importlib
import os
import random
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass, field
from pathlib import Path

import h5py
import numpy as np
from shapefit.cli.main import run as run_command

import shapefit

from .kinds import KINDS, make_base_files
from .past_findings import FINDINGS

SECONDS = 20
"""Of the processor, for one case."""

BYTES = 4 << 30
"""Of memory, for one case."""

ALLOWED = (0, 1, 2)
"""Exit codes: all went well, some items failed, the input is wrong."""

CRASHES = (signal.SIGSEGV, signal.SIGABRT, signal.SIGBUS, signal.SIGFPE, signal.SIGILL)

IN_MEMORY = Path("/dev/shm")
"""Folder of files that no disk has to hold."""


@dataclass(frozen=True)
class Case:
    """The case of a kind and a seed: the same on every machine."""

    kind: str
    seed: int

    def __str__(self) -> str:
        return f"{self.kind} {self.seed}"


@dataclass(frozen=True)
class Finding:
    """A case that did what it must not."""

    case: Case
    what: str
    command: tuple[str, ...]
    told: str

    def __str__(self) -> str:
        words = " ".join(map(ascii, self.command))
        return f"{self.case}: {self.what}\n    {words}\n    {self.told[-3000:]!r}"


@dataclass
class Tally:
    """What came of the cases so far."""

    codes: Counter[str] = field(default_factory=Counter)
    findings: list[Finding] = field(default_factory=list)

    @property
    def cases(self) -> int:
        """How many were run."""
        return sum(self.codes.values())

    def __str__(self) -> str:
        counts = ", ".join(f"{code}: {number}" for code, number in sorted(self.codes.items()))
        return f"{self.cases} cases; exit codes {counts}; {len(self.findings)} findings"


def run(cases: list[Case]) -> Tally:
    """Run cases in this process, and print what is wrong."""
    with tempfile.TemporaryDirectory(dir=IN_MEMORY if IN_MEMORY.is_dir() else None) as folder:
        base, work = Path(folder) / "base", Path(folder) / "work"
        base.mkdir()
        work.mkdir()
        with silenced():
            make_base_files(base)
            import_all()
        return run_cases(cases, base, work)


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


def run_cases(cases: Iterable[Case], base: Path, work: Path) -> Tally:
    """Run the cases one after the other, in copies of the folder of good files; print findings."""
    tally = Tally()
    for case in cases:
        folder = work / "case"
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(base, folder)
        for finding in run_case(case, folder, tally):
            print(finding, flush=True)
            tally.findings.append(finding)
    return tally


def run_case(case: Case, folder: Path, tally: Tally) -> Iterator[Finding]:
    """Spoil the files in the folder, run the command there, and yield what is wrong with that."""
    command = case_command(case, folder)
    before = set(os.listdir(folder))
    status, usage = in_child(lambda: run_command(command), folder)
    told = (folder / "stderr").read_text(errors="surrogateescape")
    code = os.waitstatus_to_exitcode(status)

    def found(what: str) -> Finding:
        return Finding(case, what, command, told)

    if -code in CRASHES and _crashes_h5py(folder):
        tally.codes["crash of libhdf5"] += 1
        return
    tally.codes[str(code)] += 1
    if code == -signal.SIGXCPU or usage.ru_utime + usage.ru_stime > SECONDS:
        yield found(f"takes more than {SECONDS} s")
    elif code not in ALLOWED:
        yield found(f"exit code {code}")
    if usage.ru_maxrss * 1024 > BYTES:
        yield found(f"takes {usage.ru_maxrss >> 10} MB")
    if "Traceback" in told or "Warning: " in told.replace("\nWarning: ", "\n").removeprefix(
        "Warning: "
    ):
        yield found("Python speaks on standard error")
    if any(not line.isprintable() for line in told.split("\n")):
        yield found("the message is not plain text")
    new = set(os.listdir(folder)) - before - {"stderr", "stdout"}
    if litter := [name for name in new if "partial" in name]:
        yield found(f"leaves {litter}")
    if code == 2 and new - {"out"}:
        yield found(f"refuses its input and writes {new}")
    if code == 0 and "out.h5" in new and not _is_finite(folder / "out.h5"):
        yield found("writes nan without a word")


def case_command(case: Case, folder: Path) -> tuple[str, ...]:
    """Spoil the files in the folder; returns the command line that reads them."""
    if case.kind in FINDINGS:
        spoil, command = FINDINGS[case.kind]
        spoil(folder)
        return command
    try:
        return KINDS[case.kind](random.Random(f"{case.kind}{case.seed}"), folder)
    except Exception as error:
        error.add_note(f"in the fuzzer itself, making the case {case}")
        raise


def in_child(work: object, folder: Path) -> tuple[int, resource.struct_rusage]:
    """Run in a fork whose streams are files of the folder; returns its status and what it took."""
    child = os.fork()
    if child == 0:
        become(folder)
        code = 70
        try:
            code = work()  # type: ignore[operator]
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
        descriptor = os.open(name, flags, 0o600)
        os.dup2(descriptor, number)
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
    """Whether h5py alone crashes on a file of the folder: then the fault is that of libhdf5."""

    def read_all() -> int:
        for path in folder.glob("*.h5"):
            try:
                with h5py.File(path, "r") as file:
                    list(file.attrs.items())
                    names: list[str] = []
                    file.visit(names.append)
                    for name in names:
                        node = file[name]
                        if isinstance(node, h5py.Dataset) and node.size < 10**6:
                            node[()]
            except Exception:
                continue
        return 0

    status, _ = in_child(read_all, folder)
    return os.waitstatus_to_exitcode(status) < 0


def _is_finite(path: Path) -> bool:
    """Whether what was learned or fitted holds numbers throughout."""
    with h5py.File(path) as file:
        names = [name for name in ("atoms", "mean_shape") if name in file]
        return all(np.isfinite(file[name][()]).all() for name in names)
