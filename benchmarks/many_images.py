"""`fit` of very many images on Dask workers of this machine: seconds, memory, files, and bytes.

The sample data is tiled with noise into files of a million images each; a fit lifts them to a
folder with two workers. Then the same command runs again, which has nothing to do.

    python -m benchmarks.many_images [IMAGES] [WORKERS] [FOLDER]
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.parts import PARTITION, PROJECT, SHAPEFIT, tile
from benchmarks.processes import watch

FILE = 1_000_000
"""Images of an input file."""


def make_inputs(folder: Path, count: int) -> int:
    """Write the dictionary and the landmarks; return how many bytes the landmarks take."""
    config = PROJECT / "configs/demo/learn-dict.yaml"
    learn = [str(SHAPEFIT), "learn-dict", "-c", str(config), "-o", "dict.h5", "-q"]
    subprocess.run(learn, cwd=folder, check=True)
    for number, start in enumerate(range(0, count, FILE)):
        tile(folder / f"views-{number:03}.h5", min(FILE, count - start), first=start)
    return sum(path.stat().st_size for path in folder.glob("views-*.h5"))


def main(count: int, workers: int, folder: str | None = None) -> None:
    """Print what a fit of so many images takes."""
    with TemporaryDirectory(dir=folder) as name:
        place = Path(name)
        size = make_inputs(place, count)
        print(f"{count:,} images in {-(-count // FILE)} files, {size / count:.0f} bytes per image")
        command = [str(SHAPEFIT), "fit", *sorted(path.name for path in place.glob("views-*.h5"))]
        command += ["-d", "dict.h5", "-o", "results/", "--workers", str(workers)]
        command += ["--set", f"partition={PARTITION}", "-q"]
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


if __name__ == "__main__":
    images, workers, *place = sys.argv[1:] + ["10000000", "2"][len(sys.argv) - 1 :]
    main(int(images), int(workers), *place)
