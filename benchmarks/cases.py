"""What `make bench` measures: kernels in warm processes, and whole commands.

A kernel is a job of worker.py on arrays that are made here. Commands are timed from the
outside, in time of the processor, each version on files that it has made itself, or on
tables made here; of some it is the most memory that counts. Both are compared with the
release before, commands with the import of NumPy too.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from shapefit import read_landmarks
from shapefit.arrays import Floats
from shapefit.dictionary.learning import learn_atoms
from shapefit.geometry.cameras import project_from_afar, turntable
from shapefit.geometry.normalisation import normalise
from shapefit.geometry.procrustes import generalised_procrustes
from shapefit.geometry.rotations import random_rotations, rotation_about
from shapefit.io import open_landmarks, read_shapes
from shapefit.io.arrange import arrange
from shapefit.pipelines.learn_dict.from_3d import every_nth

PROJECT = Path(__file__).resolve().parents[1]
WORKER = Path(__file__).with_name("worker.py")
LAMBDA = 0.1

SOLVE = """
import numpy as np
from shapefit.convex.problem import build_problem
from shapefit.convex.solver import solve_newton
rng = np.random.default_rng(0)
atoms, landmarks = rng.normal(size=(2000, 3, 1000)), rng.normal(size=(4, 2, 1000))
solve_newton(build_problem(landmarks, atoms, 0.5), tolerance=1e-8, threads=1)
"""
"""A program that takes minutes, which a signal ends."""

MOMENT, PATIENCE = 4.0, 20.0
"""Seconds of the processor after which the signal comes, and for which an answer is
waited for.
"""

SHUFFLE = """
import sys, numpy as np, shapefit
source, target, count, shuffled = sys.argv[1:]
one = shapefit.read_landmarks(source)
rows = np.arange(len(one))
if shuffled == "True":
    np.random.default_rng(0).shuffle(rows)
shapefit.write_landmarks(target, one[rows[: int(count)]])
"""

ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1"}
"""Of BLAS: its threads spin while they wait, which counts as CPU time."""

Arrays = dict[str, Any]
Command = list[str | Path]


class Environment(NamedTuple):
    """A checkout and the environment that it is installed in."""

    source: Path
    folder: Path

    @property
    def python(self) -> Path:
        """Its Python."""
        return self.folder / "bin/python"

    @property
    def command(self) -> Path:
        """Its shapefit."""
        return self.folder / "bin/shapefit"


class Bench(NamedTuple):
    """The two sides, the real data that there are, a folder for files, and whether in a
    hurry.
    """

    old: Environment
    new: Environment
    mocap: Path | None
    cars: Path | None
    folder: Path
    quick: bool

    @property
    def repeats(self) -> int:
        """Turns of either side."""
        return 3 if self.quick else 5


class Turn(NamedTuple):
    """Seconds of one run, the share of images that ended well, and a sum of the
    objectives.
    """

    seconds: float
    well: float = 1.0
    sum: float = 0.0


@dataclass(frozen=True)
class Row:
    """What a case took before and takes now, and how many times faster it is.

    well and well_before, the smallest shares of images that ended well; change, that of
    the sum of the objectives, relative; certified: every image must be solved; imports,
    the time now in those of importing NumPy.
    """

    case: str
    before: str
    now: str
    ratio: float
    well_before: float = 1.0
    well: float = 1.0
    change: float = 0.0
    certified: bool = False
    imports: float = float("nan")


Side = Callable[[], Turn]


def compare(
    case: str,
    sides: Sequence[Side],
    repeats: int,
    images: int = 0,
    *,
    certified: bool = False,
    unit: str = "s",
) -> Row:
    """Run both sides in turns; the ratio is the median of those of neighbouring turns.

    Times are images per second where their number is given, else figures in the unit.
    """
    before, now = sides
    turns = [(before(), now()) for _ in range(repeats)]
    seconds = [
        float(np.median([turn[side].seconds for turn in turns])) for side in (0, 1)
    ]
    old_text, new_text = (
        f"{images / s:,.0f}/s" if images else f"{s:.3g} {unit}" for s in seconds
    )
    return Row(
        case,
        old_text,
        new_text,
        ratio=float(np.median([old.seconds / new.seconds for old, new in turns])),
        well_before=min(old.well for old, _ in turns),
        well=min(new.well for _, new in turns),
        change=turns[-1][1].sum / (turns[-1][0].sum or 1.0) - 1.0,
        certified=certified,
    )


def cases(bench: Bench) -> Iterator[tuple[str, Callable[[], Row]]]:
    """Yield what can be measured, each with its name."""
    for name, build in kernels(bench):
        yield name, partial(compare_kernel, bench, name, build)
    for name, command in commands(bench).items():
        yield name, partial(compare_commands, bench, name, command)
    yield "signal, k=2000, p=1000", partial(compare_answers, bench)


def kernels(bench: Bench) -> Iterator[tuple[str, Callable[[], Arrays]]]:
    """Yield names of convex programs, and what makes their arrays."""
    if mocap := bench.mocap:
        frames = cache(partial(mocap_case, mocap))
        yield "subject 13", frames
        yield "subject 13, 30% hidden", partial(hide, frames, 0.3)
        yield "subject 13, shuffled", partial(shuffle, frames)
    if cars := bench.cars:
        yield "cars, p=66", partial(cars_case, cars)
    yield "made, k=64, p=1000", partial(made_case, 200, 64, 1000)
    yield "random, k=100, p=200", partial(random_case, 8, 100, 200)
    yield "random, k=100, p=400", partial(random_case, 8, 100, 400)
    yield "random, k=1000, p=400", partial(random_case, 1, 1000, 400)
    yield "low rank, k=100, p=400", partial(made_case, 8, 100, 400)


def compare_kernel(bench: Bench, name: str, build: Callable[[], Arrays]) -> Row:
    """Write the arrays of a program and let warm processes of both sides take turns."""
    arrays, data = build(), bench.folder / "arrays.npz"
    np.savez(data, **arrays)
    with ExitStack() as stack:
        sides = [
            stack.enter_context(Worker(side.python, data)).take_turn
            for side in (bench.old, bench.new)
        ]
        return compare(
            name, sides, bench.repeats, len(arrays["landmarks"]), certified=True
        )


class Worker:
    """A process of worker.py, warm."""

    def __init__(self, python: Path, data: Path) -> None:
        self._process = subprocess.Popen(
            [python, "-P", WORKER, data],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            cwd="/",
            env=os.environ | ONE_THREAD,
        )
        self._read()

    def take_turn(self) -> Turn:
        """Solve the program once."""
        assert self._process.stdin
        self._process.stdin.write("go\n")
        self._process.stdin.flush()
        return Turn(**json.loads(self._read()))

    def __enter__(self) -> Worker:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.communicate()

    def _read(self) -> str:
        assert self._process.stdout
        line = self._process.stdout.readline()
        if not line:
            raise RuntimeError(f"a worker ended with exit code {self._process.wait()}")
        return line


def hide(build: Callable[[], Arrays], share: float) -> Arrays:
    """The case with a share of the landmarks hidden, a different mask each image."""
    arrays, rng = build(), np.random.default_rng(0)
    n, _, p = arrays["landmarks"].shape
    hidden = rng.random((n, p)).argsort(axis=1) < round(share * p)
    return arrays | {
        "landmarks": np.where(hidden[:, None, :], np.nan, arrays["landmarks"])
    }


def shuffle(build: Callable[[], Arrays]) -> Arrays:
    """The case in another order, as single photographs come: no image has a
    neighbour.
    """
    arrays = build()
    order = np.random.default_rng(0).permutation(len(arrays["landmarks"]))
    return arrays | {"landmarks": arrays["landmarks"][order]}


def program(landmarks: Floats, atoms: Floats) -> Arrays:
    """The convex program of normalised landmarks (n, 2, p), nan = hidden, and atoms (k,
    3, p).
    """
    return {"landmarks": landmarks, "atoms": atoms, "lam": np.array(LAMBDA)}


def made_case(n: int, k: int, p: int) -> Arrays:
    """Exemplar shapes of a 10-dimensional family as atoms; other members of it, turned,
    as images.

    Images come in runs of 50 between two shapes and two views, as frames of a sequence
    do.
    """
    rng = np.random.default_rng(0)
    mean, modes = rng.standard_normal((3, p)), rng.standard_normal((10, 3, p))

    def shapes(weights: Floats) -> Floats:
        return normalise(mean + 0.3 * np.tensordot(weights, modes, 1)).points

    atoms = shapes(rng.standard_normal((k, 10)))
    atoms /= np.linalg.norm(atoms, axis=(1, 2))[:, None, None]
    runs = -(-n // 50)
    ends = rng.standard_normal((runs, 2, 10))
    t = np.linspace(0, 1, 50)[None, :, None]
    weights = (ends[:, :1] * (1 - t) + ends[:, 1:] * t).reshape(-1, 10)[:n]
    starts = random_rotations(runs, rng)
    about = rotation_about(np.array([0.0, 1.0, 0.0]), np.linspace(0, np.pi / 4, 50))
    views = (about[None] @ starts[:, None]).reshape(-1, 3, 3)[:n]
    landmarks = (views @ shapes(weights))[:, :2] + 0.02 * rng.standard_normal((n, 2, p))
    return program(normalise(landmarks).points, atoms)


def random_case(n: int, k: int, p: int) -> Arrays:
    """Atoms and images that have nothing in common: nearly all atoms are active."""
    rng = np.random.default_rng(0)
    atoms, w = rng.standard_normal((k, 3, p)), rng.standard_normal((n, 2, p))
    atoms = normalise(atoms).points
    atoms /= np.linalg.norm(atoms, axis=(1, 2))[:, None, None]
    return program(normalise(w).points, atoms)


def mocap_case(folder: Path) -> Arrays:
    """All frames of subject 13 under the turntable, and the paper's dictionary of
    subject 86.
    """
    shapes = read_shapes([folder / "subject13_24fps.h5"])
    lengths = Counter(shapes.sequences)
    turns = np.concatenate([np.arange(length) / length for length in lengths.values()])
    solid = project_from_afar(shapes.as_columns(), turntable(turns, "y"))
    views = normalise(solid).points
    training = read_shapes([folder / "subject86_24fps.h5"])
    retained = training.as_columns()[every_nth(training.sequences or (), 3)]
    aligned = generalised_procrustes(normalise(retained).points).shapes
    *_, learned = learn_atoms(aligned, 64, 0.1, iterations=15)
    return program(views, learned.atoms)


def cars_case(folder: Path) -> Arrays:
    """Annotated cars, each with its mask; all models but one as atoms."""
    models = read_shapes([folder / "models.h5"])
    with open_landmarks([folder / "annotated_cars.h5"]) as source:
        (images,) = source.batches(source.count)
    w = arrange(images, models.landmark_names).as_columns()
    points = normalise(w, np.asarray(np.isfinite(w).all(axis=1))).points
    return program(
        np.where(np.isfinite(w), points, np.nan),
        normalise(models.as_columns()).points[:-1],
    )


def commands(bench: Bench) -> dict[str, Callable[[Environment], Command]]:
    """Return what makes each command that is timed, by its name, for one of the
    versions.
    """

    def made(one: Environment, name: str, *command: str | Path) -> Path:
        target = bench.folder / ("new" if one is bench.new else "old") / name
        if not target.exists():
            target.parent.mkdir(exist_ok=True)
            run([one.command, *command, "-o", target])
        return target

    def config(one: Environment, path: str) -> Command:
        return ["-c", one.source / "configs" / path]

    def one_image(one: Environment, dictionary: str | Path) -> Command:
        return [
            "fit",
            PROJECT / "sample_data/one_person.csv",
            "-d",
            dictionary,
            "-o",
            "out.csv",
        ]

    def copies(count: int) -> list[Path]:
        """Make files of the same image, each of another name."""
        folder = bench.folder / "copies"
        folder.mkdir(exist_ok=True)
        text = (PROJECT / "sample_data/one_person.csv").read_text()
        files = [folder / f"{number:03}.csv" for number in range(count)]
        for file in files:
            file.write_text(text)
        return files

    def demo(one: Environment) -> Path:
        return made(one, "demo.h5", "learn-dict", *config(one, "demo/learn-dict.yaml"))

    found: dict[str, Callable[[Environment], Command]] = {
        "one image": lambda one: [*one_image(one, demo(one)), "--set", "method=convex"],
        "one image, people": lambda one: one_image(one, "people"),
        "200 files of one image": lambda one: [
            "fit",
            *copies(200),
            "-d",
            demo(one),
            "-o",
            "copies.h5",
            "--set",
            "method=convex",
        ],
    }
    if cars := bench.cars:
        data = ["--set", f"data={cars}"]

        def fit_cars(one: Environment, name: str) -> Command:
            learned = made(
                one,
                "cars.h5",
                "learn-dict",
                *config(one, "cars/learn-dict.yaml"),
                *data,
            )
            return [
                "fit",
                *config(one, f"cars/{name}.yaml"),
                *data,
                "-d",
                learned,
                "-o",
                "cars-out.h5",
            ]

        found["cars, in perspective"] = partial(fit_cars, name="fit")
        found["cars, RANSAC"] = partial(fit_cars, name="outliers-ransac")
    if not bench.mocap:
        return found
    tested, trained = (bench.mocap / f"subject{number}_24fps.h5" for number in (13, 86))
    sequence = bench.mocap / "subject13_29_120fps_exact.h5"
    pickup = bench.mocap.parent / "nrsfm/pickup.h5"

    def dictionary(one: Environment, kind: str = "mocap") -> Path:
        given = ("learn-dict", *config(one, f"{kind}/learn-dict.yaml"), trained)
        return made(one, f"dictionary-{kind}.h5", *given)

    def images(
        one: Environment, count: int, shuffled: bool = False, source: Path = tested
    ) -> Path:
        whole = made(
            one,
            f"{source.stem}.h5",
            "project",
            *config(one, "mocap/project.yaml"),
            source,
        )
        target = whole.with_name(f"{source.stem}-{count}-{shuffled}.h5")
        if not target.exists():
            run(
                [
                    one.python,
                    "-P",
                    "-c",
                    SHUFFLE,
                    whole,
                    target,
                    str(count),
                    str(shuffled),
                ]
            )
        return target

    def fit(one: Environment, *given: str | Path) -> Command:
        return ["fit", *given, "-o", bench.folder / "out.h5"]

    def convex(one: Environment, given: Path) -> Command:
        return fit(one, given, "-d", dictionary(one), "--set", "method=convex")

    def posterior(one: Environment) -> Command:
        given = images(one, 2174)
        return fit(
            one, given, "-d", dictionary(one, "people"), "--set", "method=posterior"
        )

    def sequences(one: Environment, given: Path) -> Command:
        learned = dictionary(one, "people")
        return fit(one, given, "-d", learned, "--set", "method=sequences")

    def table(name: str, frames: int) -> Path:
        """Make a CSV of the frames of the longest sequence, to and fro until they are
        enough.
        """
        target = bench.folder / f"{name}.csv"
        if not target.exists():
            source = read_landmarks(images(bench.new, 10_000, source=sequence))
            labels, sequences = (
                source.landmark_names or (),
                list(source.sequences or ()),
            )
            rows = np.flatnonzero(
                np.array(sequences) == max(sequences, key=sequences.count)
            )
            wave = np.arange(frames) % (2 * len(rows) - 2)
            wave = rows[np.minimum(wave, 2 * len(rows) - 2 - wave)]
            with target.open("w") as out:
                print("sequence,item,landmark,x,y", file=out)
                for number, row in enumerate(wave):
                    for label, (x, y) in zip(
                        labels, source.landmarks[row], strict=True
                    ):
                        print(f"{name},{number:06},{label},{x:.5f},{y:.5f}", file=out)
        return target

    def result(one: Environment) -> Path:
        given = images(one, 21_740), "-d", dictionary(one), "--set", "method=convex"
        return made(one, "result.h5", "fit", *given)

    return found | {
        "fit, 21,740 images": lambda one: convex(one, images(one, 21_740)),
        "fit, 21,740 images, shuffled": lambda one: convex(
            one, images(one, 21_740, shuffled=True)
        ),
        "posterior, 2,174 images": posterior,
        "sequences, 4,592 frames": lambda one: sequences(
            one, images(one, 10_000, source=sequence)
        ),
        "one sequence of 10,000 frames, memory": lambda one: sequences(
            one, table("walk", 10_000)
        ),
        "CSV of 100,000 images, memory": lambda one: convex(
            one, table("images", 100_000)
        ),
        "info, CSV of 100,000 images": lambda one: ["info", table("images", 100_000)],
        "CSV of 100,000 images to HDF5": lambda one: [
            "convert",
            table("images", 100_000),
            "-o",
            "images.h5",
        ],
        "eval, 21,740 images": lambda one: [
            "eval",
            result(one),
            "--truth",
            tested,
            "-o",
            bench.folder / "report",
            "--set",
            "plots=none" if one is bench.new else "plots=false",
        ],
        "verify, 21,740 images": lambda one: [
            "verify",
            result(one),
            "-d",
            dictionary(one),
            "--landmarks",
            images(one, 21_740),
        ],
        "learn-dict, people": lambda one: [
            "learn-dict",
            *config(one, "people/learn-dict.yaml"),
            trained,
            "-o",
            "out.h5",
        ],
        "learn-dict, from 2D": lambda one: [
            "learn-dict",
            made(one, "pickup.h5", "convert", pickup),
            "-o",
            "out.h5",
        ],
    }


def compare_commands(
    bench: Bench, name: str, command: Callable[[Environment], Command]
) -> Row:
    """Time a command of both versions in turns, in time of the processor; or take its
    memory.
    """
    measure, unit = (peak, "GB") if name.endswith("memory") else (timed, "s")
    sides = [
        partial(measure, [one.command, *command(one), "-q"], bench.folder)
        for one in (bench.old, bench.new)
    ]
    if measure is peak:
        return compare(name, sides, 3, unit=unit)
    numpy = np.median(
        [
            timed([bench.new.python, "-c", "import numpy"], bench.folder).seconds
            for _ in range(5)
        ]
    )
    row = compare(name, sides, bench.repeats)
    seconds = float(row.now.removesuffix(" s"))
    return Row(**{**vars(row), "imports": seconds / float(numpy)})


def timed(command: Command, folder: Path) -> Turn:
    """Run a command; return the processor's seconds of its processes."""
    before = os.times()
    run(command, folder)
    after = os.times()
    spent = (after.children_user + after.children_system) - (
        before.children_user + before.children_system
    )
    return Turn(spent)


def peak(command: Command, folder: Path) -> Turn:
    """Run a command; return the most memory that it has, in GB."""
    process = subprocess.Popen(command, cwd=folder, stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode > 1:
        raise RuntimeError(f"{command} failed")
    return Turn(usage.ru_maxrss * 1024 / 1e9)


def compare_answers(bench: Bench) -> Row:
    """Time what either version takes from SIGINT to its end, PATIENCE at most."""
    sides = [partial(answer, side.python) for side in (bench.old, bench.new)]
    return compare("signal, k=2000, p=1000", sides, bench.repeats)


def answer(python: Path) -> Turn:
    """Send SIGINT to a kernel; return the processor's seconds from there to the end."""
    process = subprocess.Popen(
        [python, "-P", "-c", SOLVE],
        stderr=subprocess.DEVNULL,
        env=os.environ | ONE_THREAD,
    )
    begin = last = wait_for(process.pid, MOMENT)
    process.send_signal(signal.SIGINT)
    while last - begin < PATIENCE:
        time.sleep(0.005)
        if (now := seconds_of(process.pid)) is None:
            break
        last = now
    process.kill()
    process.wait()
    return Turn(max(last - begin, 0.01))


def wait_for(process: int, moment: float) -> float:
    """Wait until a process has taken so much of the processor; return how much."""
    while (spent := seconds_of(process)) is not None:
        if spent >= moment:
            return spent
        time.sleep(0.005)
    raise RuntimeError("a kernel ended before its signal")


def seconds_of(process: int) -> float | None:
    """Return the processor's seconds of a process, None after its end."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    ticks = int(fields[11]) + int(fields[12])
    return None if fields[0] == "Z" else ticks / os.sysconf("SC_CLK_TCK")


def run(command: Command, folder: Path | None = None) -> None:
    """Run a command, silent unless it fails. Exit code 1, some items failed, is a
    result too.
    """
    with tempfile.TemporaryFile() as output:
        done = subprocess.run(
            command, cwd=folder, stdout=output, stderr=output, check=False
        )
        if done.returncode > 1:
            output.seek(0)
            raise RuntimeError(f"{command} failed:\n{output.read().decode()}")
