"""Kills and races on one folder of results, after which nothing is lost: `python -m
tests.fuzz.folders`.

A killed run goes on: parts that were done keep their bytes, and in the end the folder
is that of one run. Of two runs at once with other settings one is refused.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from tests.fuzz.__main__ import become, import_all, silenced
from tests.pipelines.partition.made import make_dictionary, make_images, same_bits

IMAGES, PARTS, SIZE = 640, 10, 64
OUT = Path("out")
FIT = ("fit", "views.h5", "-d", "dict.h5", "--set=threads=1", "--method=alternate")
TO_FOLDER = (*FIT, "-o", "out/", f"--partition={SIZE}")
SETTINGS = ("--set=lambda=0.1", "--set=lambda=0.3")


def main() -> int:
    """Kill and race runs; exit code 1 where something was lost."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.fuzz.folders", description=__doc__
    )
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--races", type=int, default=30)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        with silenced():
            import_all()
        make_files()
        faults = [*kill_often(arguments.kills), *race(arguments.races)]
        os.chdir("/")
    for fault in faults:
        print(fault)
    print(f"{arguments.kills} kills, {arguments.races} races: {len(faults)} faults")
    return 1 if faults else 0


def make_files() -> None:
    """Write images and a dictionary, and for either setting the result of one run."""
    rng = np.random.default_rng(0)
    make_dictionary(Path("dict.h5"), rng)
    make_images("views.h5", rng.normal(size=(IMAGES, 2, 8)))
    for number, setting in enumerate(SETTINGS):
        assert wait(start(*FIT, "-o", f"whole{number}.h5", setting)) == 0


def start(*command: str) -> int:
    """Run a command in a fork; return its process."""
    from shapefit.cli.main import run

    child = os.fork()
    if child == 0:
        code = 70
        try:
            become(Path.cwd())
            code = run(command)
        finally:
            os._exit(code)
    return child


def wait(child: int) -> int:
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def done_parts() -> dict[str, bytes]:
    """Return the results that the manifest lists, and that are there, with their
    bytes.
    """
    manifest = OUT / "manifest.jsonl"
    if not manifest.is_file():
        return {}
    lines = map(json.loads, manifest.read_bytes().split(b"\n")[1:-1])
    names = {line["file"] for line in lines if line["status"] == "done"}
    there = [name for name in sorted(names) if (OUT / name).is_file()]
    return {name: (OUT / name).read_bytes() for name in there}


def is_whole(setting: int) -> str:
    """Return what is wrong with a folder that is to be of one run, "" for nothing."""
    parts = sorted(OUT.glob("part-*.h5"))
    if len(parts) != PARTS or len(done_parts()) != PARTS:
        return f"{len(parts)} files, and {len(done_parts())} parts in the manifest"
    try:
        same_bits(parts, Path(f"whole{setting}.h5"))
    except AssertionError as error:
        return f"other bits: {error!s:.200}"
    code = wait(start("verify", "out", "-d", "dict.h5"))
    return f"verify ends with {code}" if code else ""


def kill_often(number: int) -> list[str]:
    """Kill so many runs, each going on from the last or replacing it."""
    rng, faults, setting = random.Random(0), [], 0
    began = time.perf_counter()
    wait(start(*TO_FOLDER, SETTINGS[0]))
    seconds = time.perf_counter() - began
    for kill in range(number):
        replaces = rng.random() < 0.3
        setting = 1 - setting if replaces else setting
        replace = ("--replace",) if replaces else ()
        if kill % 5 == 4:  # some of what was done is gone
            rng.choice([*OUT.glob("part-*.h5"), OUT / "none"]).unlink(missing_ok=True)
        child = start(*TO_FOLDER, SETTINGS[setting], *replace)
        time.sleep(rng.uniform(0, 1.1 * seconds))
        os.kill(child, signal.SIGKILL)
        code = wait(child)
        if code not in (0, -signal.SIGKILL):
            faults.append(f"kill {kill}: a run ends with {code}")
        before = done_parts() if code < 0 and not replaces else {}
        if kill % 3 and not replaces:
            continue
        # A run that was killed before it replaced anything is to replace it now.
        code = wait(start(*TO_FOLDER, SETTINGS[setting], "--replace"))
        changed = [
            name for name, data in before.items() if (OUT / name).read_bytes() != data
        ]
        if code or changed:
            faults.append(f"kill {kill}: the next run ends with {code}, {changed}")
        if fault := is_whole(setting):
            faults.append(f"kill {kill}: {fault}")
    return faults


def race(number: int) -> list[str]:
    """Let two runs with other settings begin at once, so many times."""
    rng, faults = random.Random(1), []
    for attempt in range(number):
        for path in [*OUT.iterdir()]:
            path.unlink()
        children = [start(*TO_FOLDER, SETTINGS[0])]
        time.sleep(rng.choice((0, 0, 0.01, 0.1, 0.3)) * rng.random())
        children.append(start(*TO_FOLDER, SETTINGS[1]))
        codes = [wait(child) for child in children]
        if sorted(codes) != [0, 2]:
            faults.append(f"race {attempt}: the runs end with {codes}")
        elif fault := is_whole(codes.index(0)):
            faults.append(f"race {attempt}: {fault}")
    return faults


if __name__ == "__main__":
    sys.exit(main())
