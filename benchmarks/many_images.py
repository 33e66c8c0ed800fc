"""`fit` of very many images on Dask workers of this machine: seconds, memory, files, and bytes.

The sample data is tiled with noise into files of a million images each; a fit lifts them to a
folder with two workers. Then the same command runs again, which has nothing to do.

    python -m benchmarks.many_images [IMAGES] [WORKERS] [FOLDER]
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import psutil

from benchmarks.parts import PARTITION, PROJECT, SHAPEFIT, tile

FILE = 1_000_000
"""Images of an input file."""

WAIT = 0.5
"""Seconds between two looks at the memory of the processes."""


def make_inputs(folder: Path, count: int) -> int:
    """Write the dictionary and the landmarks; return how many bytes the landmarks take."""
    config = PROJECT / "configs/demo/learn-dict.yaml"
    learn = [str(SHAPEFIT), "learn-dict", "-c", str(config), "-o", "dict.h5", "-q"]
    subprocess.run(learn, cwd=folder, check=True)
    for number, start in enumerate(range(0, count, FILE)):
        tile(folder / f"views-{number:03}.h5", min(FILE, count - start), first=start)
    return sum(path.stat().st_size for path in folder.glob("views-*.h5"))


def watch(command: list[str], folder: Path) -> tuple[float, float, dict[int, int]]:
    """Run a command; return its seconds, those of all its processors, and each process's peak.

    The peak is that of the memory in use of the command (its number is 0) and of its children.
    """
    before, began = os.times(), time.perf_counter()
    peaks: dict[int, int] = {}
    process = subprocess.Popen(command, cwd=folder)
    own = psutil.Process(process.pid)
    while process.poll() is None:
        for each in (own, *children(own)):
            try:
                number = 0 if each.pid == own.pid else each.pid
                peaks[number] = max(peaks.get(number, 0), each.memory_info().rss)
            except psutil.NoSuchProcess:
                continue
        time.sleep(WAIT)
    if process.returncode:
        raise SystemExit(process.returncode)
    seconds, after = time.perf_counter() - began, os.times()
    spent = after.children_user + after.children_system
    return seconds, spent - before.children_user - before.children_system, peaks


def children(process: psutil.Process) -> list[psutil.Process]:
    """Return the processes that a process has started, none where it has ended."""
    try:
        return process.children(recursive=True)
    except psutil.NoSuchProcess:
        return []


def main(count: int, workers: int, folder: str | None = None) -> None:
    """Print what a fit of so many images takes."""
    with TemporaryDirectory(dir=folder) as name:
        place = Path(name)
        size = make_inputs(place, count)
        print(f"{count:,} images in {-(-count // FILE)} files, {size / count:.0f} bytes per image")
        command = [str(SHAPEFIT), "fit", *sorted(path.name for path in place.glob("views-*.h5"))]
        command += ["-d", "dict.h5", "-o", "results/", "--workers", str(workers)]
        command += ["--set", f"partition={PARTITION}", "-q"]
        seconds, spent, peaks = watch(command, place)
        results = sorted((place / "results").glob("part-*"))
        written = sum(path.stat().st_size for path in results)
        print(
            f"{seconds:.0f} s with {workers} workers, {count / seconds:,.0f} images/s; "
            f"{spent:.0f} s of processor, {count / spent:,.0f} images/s a core"
        )
        each = written / count
        print(f"{len(results)} results, {written / 1e9:.1f} GB, {each:.0f} bytes per image")
        manifest = (place / "results/manifest.json").stat().st_size
        print(f"the manifest has {manifest / len(results):.0f} bytes a part")
        largest = sorted((peak for number, peak in peaks.items() if number), reverse=True)[:workers]
        print("memory of the workers:", ", ".join(f"{peak / 1e6:.0f} MB" for peak in largest))
        print(f"memory of fit and its scheduler: {peaks[0] / 1e6:.0f} MB")
        again, _, _ = watch(command, place)
        print(f"again, with nothing to do: {again:.1f} s")


if __name__ == "__main__":
    images, workers, *place = sys.argv[1:] + ["10000000", "2"][len(sys.argv) - 1 :]
    main(int(images), int(workers), *place)
