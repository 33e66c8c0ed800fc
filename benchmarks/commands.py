"""What is measured from the outside: commands, the demonstration, and the size on the disk."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

import h5py
import numpy as np

import shapefit
from benchmarks.comparing import Comparison, Row, Turn, compare, compared, reached
from benchmarks.environments import PROJECT, Environment, dependency_bytes, git
from shapefit.io import landmark_writer, open_landmarks

FIT = "method: convex\nlambda: 0.1\nsolver: {tolerance: 1e-4}\n"
"""The same gap for all releases, whatever their default."""

TEN, MILLION = 10, 46
"""How often the 21,740 images of subject 13 are taken: 217,400, and just over 10^6."""

FAST, EVALUATED, PART, MINUTE = 100_000, 200_000, 100_000, 60
"""Images a second that `verify` and `eval` are to reach, images of an `eval` and of each of its
files, seconds of a demo.
"""

NOISE = 1e-3
"""What the landmarks of tiles differ by, beside their standard deviation."""

Clock = Callable[[], float]


def fit_cases(
    old: Environment, new: Environment, mocap: Path | None, folder: Path, repeats: int
) -> Iterator[tuple[str, Callable[[], Row]]]:
    """Whole fits, on files that the release before has made."""
    (folder / "fit.yaml").write_text(FIT, encoding="utf-8")
    if mocap:
        many = partial(compare_many, old, new, mocap, folder)
        case = "fit, 21,740 images, CPU"
        yield case, partial(many, case, 1, repeats)
        case = "fit, 10^6 images, CPU"
        yield case, partial(many, case, MILLION, min(repeats, 2))
        case = "fit, two threads over one"
        yield case, partial(compare_threads, case, old, new, mocap, folder, min(repeats, 5))
        case = "verify, images/s"
        yield case, partial(measure_verify, case, old, new, mocap, folder)
    case = "eval, images/s"
    yield case, partial(measure_eval, case, new, folder)
    if mocap:
        case = "sequences end to end"
        yield case, partial(compare_sequences, case, old, new, mocap, folder, min(repeats, 3))
    case = "fit, 300 files of 100 images, parts, CPU"
    yield case, partial(compare_files, case, old, new, folder, min(repeats, 3))
    case = "one image, CSV to CSV"
    yield case, partial(compare_one, case, old, new, folder, 3 * repeats)
    case = "import numpy over one image, CSV to CSV"
    yield case, partial(compare_one, case, old, new, folder, 3 * repeats)


def compare_many(
    old: Environment,
    new: Environment,
    mocap: Path,
    folder: Path,
    case: str,
    times: int,
    repeats: int,
) -> Row:
    """All images of subject 13, so many times over, HDF5 to HDF5: in time of the processor."""
    command = mocap_command(old, mocap, folder, times)
    before, now = (partial(fit, one, command, folder / "out.h5", spent) for one in (old, new))
    return compared(case, compare(before, now, repeats), certified=True)


def compare_threads(
    case: str, old: Environment, new: Environment, mocap: Path, folder: Path, repeats: int
) -> Row:
    """The whole command on two threads beside the same on one, by the clock."""
    command = mocap_command(old, mocap, folder, TEN)
    one, two = (
        partial(fit, new, [*command[:-1], "--set", f"threads={threads}", "-o"], folder / "out.h5")
        for threads in (1, 2)
    )
    return compared(case, compare(one, two, repeats), certified=True, least=0.0)


def measure_verify(case: str, old: Environment, new: Environment, mocap: Path, folder: Path) -> Row:
    """All proofs of 217,400 images checked, in time of the processor."""
    fitting, result = mocap_command(old, mocap, folder, TEN), folder / "out.h5"
    run([new.command, *fitting, result], folder)
    took = timed([new.command, "verify", result, "-d", fitting[3]], folder, spent)
    return reached(case, FAST, 21_740 * TEN / took.seconds)


def measure_eval(case: str, new: Environment, folder: Path) -> Row:
    """Results with error bars judged by a truth, in time of the processor."""
    parts = folder / "eval"
    parts.mkdir()
    for number in range(EVALUATED // PART):
        write_judged(parts, number)
    command: list[str | Path] = [new.command, "eval", *sorted(parts.glob("part-*.h5")), "-q"]
    command += ["--truth", "truth-*.h5", "-o", "report"]
    return reached(case, FAST, EVALUATED / timed(command, parts, spent).seconds)


def write_judged(folder: Path, number: int) -> None:
    """Write PART true shapes, people of the sample data with noise, and results with error bars."""
    rng = np.random.default_rng(number)
    people = shapefit.read_shapes(PROJECT / "sample_data/people_test.h5")
    shapes = np.asarray(people.shapes)
    rows = np.arange(number * PART, (number + 1) * PART)
    deviation = 0.05 * shapes.std()
    true = shapes[rows % len(shapes)]
    true = true + deviation * rng.standard_normal(true.shape)
    items = [f"image/{row:09}" for row in rows]
    sequences = [f"sequence/{row // 5000:06}" for row in rows]
    truth = shapefit.Shapes(true, people.landmark_names, items, sequences, unit=people.unit)
    shapefit.write_shapes(folder / f"truth-{number:05}.h5", truth)
    straight = np.tile(np.eye(3), (PART, 1, 1))
    found = shapefit.Fit(
        shapes=true + deviation * rng.standard_normal(true.shape),
        landmark_names=people.landmark_names or (),
        items=items,
        sequences=sequences,
        shape_sd=np.full(true.shape, deviation),
        rotation=straight,
        p_value=rng.uniform(size=PART),
        extras={"true_rotation": straight},
        unit=people.unit,
    )
    shapefit.write_results(folder / f"part-{number:05}.h5", found)


def mocap_command(old: Environment, mocap: Path, folder: Path, times: int) -> Sequence[str | Path]:
    """Return the fit of subject 13, `times` times over; the output is to be added."""
    landmarks, dictionary = mocap_files(old, mocap, folder)
    if times > 1:
        landmarks = tile(landmarks, folder / f"tiled-{times}.h5", times)
    return ["fit", landmarks, "-d", dictionary, "-c", folder / "fit.yaml", "-o"]


def compare_sequences(
    case: str, old: Environment, new: Environment, mocap: Path, folder: Path, repeats: int
) -> Row:
    """A sequence of 4,592 frames by `method: sequences`, with the prior of subject 86."""
    landmarks, dictionary = folder / "sequence.h5", folder / "prior.h5"
    configs = old.source / "configs"
    sequence = mocap / "subject13_29_120fps_exact.h5"
    views: list[str | Path] = ["project", "-c", configs / "mocap/project.yaml", sequence]
    run([old.command, *views, "-o", landmarks], folder)
    learn: list[str | Path] = ["learn-dict", "-c", configs / "people/learn-dict.yaml"]
    run([old.command, *learn, mocap / "subject86_24fps.h5", "-o", dictionary], folder)
    config = configs / "people/sequences.yaml"
    command: list[str | Path] = ["fit", landmarks, "-d", dictionary, "-c", config, "-o"]
    before, now = (partial(fit, one, command, folder / "out.h5", spent) for one in (old, new))
    return compared(case, compare(before, now, repeats))


def compare_files(case: str, old: Environment, new: Environment, folder: Path, repeats: int) -> Row:
    """Files of 100 images each, to a folder of results: in time of the processor."""
    dictionary = learn_people(old, folder)
    for number in range(300):
        tile_people(folder / f"clip-{number:03}.h5", 100, first=100 * number)
    command: list[str | Path] = ["fit", "clip-*.h5", "-d", dictionary, "-c", folder / "fit.yaml"]

    def parts(one: Environment) -> Turn:
        shutil.rmtree(folder / "parts", ignore_errors=True)
        return timed([one.command, *command, "-o", "parts/"], folder, spent)

    return compared(case, compare(partial(parts, old), partial(parts, new), repeats))


def tile_people(path: Path, count: int, first: int) -> None:
    """Write images from the `first`: people of the sample data again, a pixel of noise apart."""
    rng = np.random.default_rng(first)
    one = shapefit.read_landmarks(PROJECT / "sample_data/people_views.csv")
    points = np.asarray(one.landmarks)
    rows = np.arange(first, first + count)
    moved = points[rows % len(points)] + rng.standard_normal((count, *points.shape[1:]))
    items = [f"image/{row:08}" for row in rows]
    shapefit.write_landmarks(path, shapefit.Landmarks(moved, one.landmark_names, items=items))


def learn_people(old: Environment, folder: Path) -> Path:
    """Learn the dictionary of the demonstration with the old command."""
    dictionary = folder / "people.h5"
    learning = old.source / "configs/demo/learn-dict.yaml"
    run([old.command, "learn-dict", "-c", learning, "-o", dictionary], folder)
    return dictionary


def compare_one(case: str, old: Environment, new: Environment, folder: Path, repeats: int) -> Row:
    """One image from CSV to CSV, against the release before or against the import of NumPy."""
    dictionary = learn_people(old, folder)
    image = PROJECT / "sample_data/one_person.csv"
    command: list[str | Path] = ["fit", image, "-d", dictionary, "-c", folder / "fit.yaml", "-o"]
    before, now = (partial(fit, one, command, folder / "out.csv", spent) for one in (old, new))
    if "numpy" not in case:
        return compared(case, compare(before, now, repeats))
    numpy = partial(timed, [new.python, "-c", "import numpy"], folder, spent)
    return compared(case, compare(numpy, now, repeats), least=0.0)


def install_cases(
    old: Environment, new: Environment, folder: Path
) -> Iterator[tuple[str, Callable[[], Row]]]:
    """What a newcomer meets: the size of the dependencies, compiling, and the demonstration."""
    yield "installed dependencies", partial(compare_sizes, "installed dependencies", old, new)
    yield "install, CPU", partial(compare_installs, "install, CPU", old, folder)
    yield "make demo, fresh clone, in a minute", partial(measure_demo, folder)


def compare_installs(case: str, old: Environment, folder: Path) -> Row:
    """Compile a wheel of either version from nothing, once each, in time of the processor."""
    pip = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-build-isolation"]
    sides = []
    for name in (old.name, "HEAD"):
        source = clone(name, folder / "source" / name)
        sides.append(partial(timed, [*pip, source, "-w", folder / "wheels" / name], folder, spent))
    return compared(case, compare(sides[0], sides[1], 1))


def measure_demo(folder: Path) -> Row:
    """Time `make demo` in a fresh clone, once: set-up, packages from pip's cache, and chain."""
    seconds = timed(["make", "demo"], clone("HEAD", folder / "demo")).seconds
    return Row(
        "make demo, fresh clone, in a minute", f"{MINUTE} s", f"{seconds:.0f} s", MINUTE / seconds
    )


def compare_sizes(case: str, old: Environment, new: Environment) -> Row:
    """Weigh the installed dependencies."""
    before, now = (dependency_bytes(one) / 1e9 for one in (old, new))
    return compared(case, Comparison(before / now, before, now, 1.0, 1.0), unit="GB")


def mocap_files(old: Environment, mocap: Path, folder: Path) -> tuple[Path, Path]:
    """Make the landmarks of subject 13 and the dictionary of subject 86 with the old commands."""
    landmarks, dictionary = folder / "landmarks.h5", folder / "dictionary.h5"
    configs = old.source / "configs/mocap"
    shapes = [mocap / "subject13_24fps.h5"]
    run([old.command, "project", "-c", configs / "project.yaml", *shapes, "-o", landmarks], folder)
    shapes = [mocap / "subject86_24fps.h5"]
    learn: list[str | Path] = [
        old.command,
        "learn-dict",
        "-c",
        configs / "learn-dict.yaml",
        *shapes,
    ]
    run([*learn, "-o", dictionary], folder)
    return landmarks, dictionary


def tile(source: Path, target: Path, times: int) -> Path:
    """Write all images of a file again and again, with noise, so that no two are equal; once."""
    if target.is_file():
        return target
    rng = np.random.default_rng(0)
    with open_landmarks((source,)) as file, landmark_writer(target) as writer:
        (one,) = file.batches(file.count)
        noise = NOISE * np.nanstd(one.landmarks)
        for number in range(times):
            moved = noise * rng.standard_normal(one.landmarks.shape)
            items = tuple(f"{item}/{number}" for item in one.items)
            writer.append(one.replaced(landmarks=one.landmarks + moved, items=items))
    return target


def fit(
    environment: Environment,
    command: Sequence[str | Path],
    output: Path,
    clock: Clock = time.perf_counter,
) -> Turn:
    """Time a fit; the share of optimal images is read from a result that holds one."""
    turn = timed([environment.command, *command, output], output.parent, clock)
    if output.suffix != ".h5":
        return turn
    with h5py.File(output) as result:
        counts = Counter(result["status"].asstr()[:].tolist())
        total = float(result["objective"][:].sum())
    return Turn(turn.seconds, well=counts["optimal"] / counts.total(), sum=total)


def clone(revision: str, folder: Path) -> Path:
    """Check a revision out into a fresh folder."""
    run(["git", "clone", "--quiet", "--no-checkout", PROJECT, folder], PROJECT)
    commit = git("rev-parse", revision).stdout.decode().strip()
    run(["git", "checkout", "--quiet", commit], folder)
    return folder


def spent() -> float:
    """Return the processor's seconds of all processes that were started here and have ended."""
    times = os.times()
    return times.children_user + times.children_system


def timed(command: Sequence[str | Path], folder: Path, clock: Clock = time.perf_counter) -> Turn:
    """Time a command."""
    began = clock()
    run(command, folder)
    return Turn(clock() - began)


def run(command: Sequence[str | Path], folder: Path) -> None:
    """Run a command, silent unless it fails."""
    with tempfile.TemporaryFile() as told:
        done = subprocess.run(command, cwd=folder, stdout=told, stderr=told, check=False)
        if done.returncode:
            told.seek(0)
            raise RuntimeError(f"{command} failed:\n{told.read().decode()}")
