"""`fit` of very many images on Dask workers of this machine: seconds, memory, files, and bytes.

The sample data is tiled with noise into files of a million images each, or as many as are given; a
fit lifts them to a folder with two workers. Then the same command runs again, which has nothing to
do. Of smaller files, what they take beside the lifting: plain fits, one for each worker, of the
same images in a file each.

    python -m benchmarks.many_images [IMAGES] [WORKERS] [FOLDER] [IMAGES OF A FILE]
"""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.parts import PARTITION, PROJECT, SHAPEFIT, fit, processor_seconds, tile
from benchmarks.processes import watch

FILE = 1_000_000
"""Images of an input file."""


def make_inputs(folder: Path, count: int, size: int) -> int:
    """Write the dictionary and the landmarks; return how many bytes the landmarks take."""
    config = PROJECT / "configs/demo/learn-dict.yaml"
    learn = [str(SHAPEFIT), "learn-dict", "-c", str(config), "-o", "dict.h5", "-q"]
    subprocess.run(learn, cwd=folder, check=True)
    for number, start in enumerate(range(0, count, size)):
        tile(folder / f"views-{number:06}.h5", min(size, count - start), first=start)
    return sum(path.stat().st_size for path in folder.glob("views-*.h5"))


def lift_large(folder: Path, count: int, workers: int) -> tuple[float, float]:
    """Return the seconds, and the processor's, of plain fits at once, one for each worker."""
    each = count // workers
    for number in range(workers):
        tile(folder / f"large-{number}.h5", each, first=number * each)
    numbers, began = range(workers), time.perf_counter()
    commands = [fit(f"large-{number}.h5", "-o", f"plain-{number}.h5") for number in numbers]
    processor = processor_seconds(*commands, folder=folder)
    return time.perf_counter() - began, processor


def main(count: int, workers: int, folder: str | None = None, size: str = str(FILE)) -> None:
    """Print what a fit of so many images takes."""
    with TemporaryDirectory(dir=folder) as name:
        place = Path(name)
        made = make_inputs(place, count, int(size))
        files = -(-count // int(size))
        print(f"{count:,} images in {files:,} files, {made / count:.0f} bytes per image")
        command = [str(SHAPEFIT), "fit", "views-*.h5", "-d", "dict.h5", "-o", "results/"]
        command += ["--workers", str(workers), "--set", f"partition={PARTITION}", "-q"]
        print(f"planned in {watch([*command, '--dry-run'], place).seconds:.1f} s")
        found = watch(command, place)
        seconds, spent, peaks = found.seconds, found.processor, found.peaks
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
        print(f"memory of fit and its scheduler: {found.peak / 1e6:.0f} MB")
        print(f"again, with nothing to do: {watch(command, place).seconds:.1f} s")
        if int(size) < FILE:
            plain = lift_large(place, count, workers)
            beside = [took - lifting for took, lifting in zip((seconds, spent), plain, strict=True)]
            print(
                "beside the lifting of large files: {:.0f} s, {:.0f} s of processor".format(*beside)
            )


if __name__ == "__main__":
    images, workers, *further = sys.argv[1:] + ["10000000", "2"][len(sys.argv) - 1 :]
    main(int(images), int(workers), *further)
