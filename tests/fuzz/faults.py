"""Every call that writes fails once; outputs are old or new: `python -m
tests.fuzz.faults`.

The process runs with `failing_calls.c` preloaded; each case is forked from it. `--kill`
kills commands at so many of these moments instead.
"""

from __future__ import annotations

import argparse
import ctypes
import errno
import os
import shutil
import signal
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path

ERRORS = (errno.ENOSPC, errno.EIO, errno.EACCES)

SHIM = Path(__file__).with_name("failing_calls.c")

OLD, NEW = (
    ("--set=threads=1", "--set=lambda=0.3"),
    ("--set=threads=1", "--set=lambda=0.1"),
)
FIT = ("fit", "views.h5", "-d", "dict.h5")
MESHES = (
    "fit",
    "views.h5",
    "-d",
    "exemplars.h5",
    "-o",
    "out/r.h5",
    "--set=export.folder=out/m",
)
LEARN = (
    "learn-dict",
    "shapes.h5",
    "-o",
    "out/d.h5",
    "--set",
    "iterations=2",
    "--set",
    "k=3",
)
EVAL = ("eval", "--truth", "shapes.h5", "-o", "out/report", "--set=plots=none")
PROJECT = ("project", "shapes.h5", "-o", "out/v.h5")

COMMANDS = {
    "fit to HDF5": ((*FIT, "-o", "out/r.h5", *OLD), (*FIT, "-o", "out/r.h5", *NEW)),
    "fit to CSV": ((*FIT, "-o", "out/r.csv", *OLD), (*FIT, "-o", "out/r.csv", *NEW)),
    "fit with meshes": ((*MESHES, *OLD), (*MESHES, *NEW)),
    "learn-dict": ((*LEARN, "--set=beta=0.3"), (*LEARN, "--set=beta=0.1")),
    "project": (PROJECT, (*PROJECT, "--set=noise=0.1")),
    "eval": ((*EVAL, "result.csv"), (*EVAL, "result.h5")),
}
"""Commands whose outputs are there already, made by the first, when the second runs."""


def main() -> int:
    """Preload the shim, then run every case; exit code 1 where one of them fails."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.fuzz.faults", description=__doc__
    )
    parser.add_argument(
        "--commands", nargs="+", default=list(COMMANDS), choices=list(COMMANDS)
    )
    parser.add_argument(
        "--kill", type=int, default=0, help="kill -9 at so many moments instead"
    )
    parser.add_argument(
        "--quick", action="store_true", help="one of the errors for each call"
    )
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        if "failing_calls" in os.environ.get("LD_PRELOAD", ""):
            return run(arguments, Path(folder))
        library = Path(folder) / "failing_calls.so"
        compiler = (sysconfig.get_config_var("CC") or "cc").split()[0]
        compiler = compiler if shutil.which(compiler) else "cc"
        shared = ("-shared", "-fPIC", "-O1", "-o", str(library), str(SHIM), "-ldl")
        subprocess.run([compiler, *shared], check=True)
        command = [sys.executable, "-m", "tests.fuzz.faults", *sys.argv[1:]]
        return subprocess.call(command, env=os.environ | {"LD_PRELOAD": str(library)})


def run(arguments: argparse.Namespace, folder: Path) -> int:
    """Run the cases of the commands; returns the exit code."""
    from .__main__ import silenced
    from .kinds import make_base_files

    failed = cases = 0
    base = folder / "base"
    base.mkdir()
    with silenced():
        make_base_files(base)
    for name in arguments.commands:
        bench = Bench(*COMMANDS[name], base, folder / "case")
        plan = [(call, error) for call in range(bench.calls) for error in ERRORS]
        plan = plan[:: len(ERRORS) + 1] if arguments.quick else plan
        if arguments.kill:
            share = -(-arguments.kill // len(arguments.commands))
            moments = [number * bench.calls // share for number in range(share)]
            plan = [(call, -signal.SIGKILL) for call in moments]
        wrong = [problem for case in plan if (problem := bench.try_case(*case))]
        for problem in wrong[:20]:
            print(f"{name}: {problem}", flush=True)
        cases += len(plan)
        failed += len(wrong)
        print(
            f"{name}: {bench.calls} calls, {len(plan)} cases, {len(wrong)} wrong",
            flush=True,
        )
    print(f"{cases} cases, {failed} wrong")
    return 1 if failed else 0


class Bench:
    """One command, whose outputs are there already, and what becomes of them."""

    def __init__(
        self, old: tuple[str, ...], new: tuple[str, ...], base: Path, folder: Path
    ) -> None:
        """Make the old outputs, and count the calls of the new run."""
        self._shim = ctypes.CDLL(os.environ["LD_PRELOAD"])
        self._command, self._folder, self._retained = (
            new,
            folder,
            folder.with_name("retained"),
        )
        for path in (folder, self._retained):
            shutil.rmtree(path, ignore_errors=True)
        shutil.copytree(base, folder)
        (folder / "out").mkdir()
        assert self._run(old)[0] == 0
        shutil.copytree(folder / "out", self._retained)
        self._old = content(self._retained)
        code, self.calls = self._run(new)
        assert code == 0
        self._new = content(folder / "out")

    def try_case(self, call: int, error: int) -> str:
        """Let one call fail; returns what is wrong, an empty text where all is well."""
        out = self._folder / "out"
        shutil.rmtree(out)
        shutil.copytree(self._retained, out)
        code, _ = self._run(self._command, call, error)
        word = f"call {call}, error {error}, exit code {code}"
        if (
            error < 0 and code == error
        ):  # the next run puts back what this one was replacing
            again, _ = self._run(self._command)
            return f"{word}: the next run ends with {again}" if again else ""
        files = content(out)
        hidden = sorted(name for name in files if ".partial" in name)
        if code not in (0, 2) or hidden:
            return f"{word}: leaves {hidden}"
        names = self._old.keys() | self._new
        states = {self._state(name, files.get(name)) for name in names} - {"same"}
        # The files of a folder move there one by one, each whole, after what stands
        # beside it.
        folders = any("/" in name for name in names)
        wanted = {"new"} if code == 0 else {"old", "new"} if folders else {"old"}
        return "" if states <= wanted else f"{word}: outputs are {sorted(states)}"

    def _state(self, name: str, data: bytes | None) -> str:
        old = self._old.get(name)
        new = self._new.get(name)
        if old == new:
            return "same" if data == old else "damaged"
        if data == old:
            return "old"
        return (
            "new"
            if data is not None and is_whole(self._folder / "out" / name)
            else "damaged"
        )

    def _run(
        self, command: tuple[str, ...], call: int = -1, error: int = 0
    ) -> tuple[int, int]:
        """Run a command in a fork, with a call that fails; return exit code and number
        of calls.
        """
        from .__main__ import become

        counts = self._folder / "calls"
        child = os.fork()
        if child == 0:
            code = 70
            try:
                from shapefit.cli.main import run as run_command

                become(self._folder)
                self._shim.arm(ctypes.c_long(call), ctypes.c_int(error))
                code = run_command(command)
                number = self._shim.counted()
                self._shim.arm(ctypes.c_long(-1), 0)
                counts.write_text(str(number))
            finally:
                os._exit(code)
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        return code, int(counts.read_text()) if code >= 0 else 0


def content(folder: Path) -> dict[str, bytes]:
    """Return path -> bytes of every file below."""
    paths = (path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in paths}


def is_whole(path: Path) -> bool:
    """Whether a file that is not the old one is a whole one: HDF5 opens, text ends with
    a line.
    """
    if path.suffix == ".h5":
        import h5py

        with h5py.File(path) as file:
            return "format" in file.attrs and all(
                node.shape is not None for node in file.values()
            )
    return path.suffix not in (".csv", ".md") or path.read_bytes().endswith(b"\n")


if __name__ == "__main__":
    sys.exit(main())
