"""What `make bench` measures: kernels in warm processes, and whole commands.

A kernel is a job of worker.py on arrays that are made here. Commands are timed from the
outside, in time of the processor, each version on files that it has made itself, or on
tables made here; of some it is the most memory that counts. Both are compared with the
release before, commands with the import of NumPy too.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
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
from shapefit.convex.problem import build_problem
from shapefit.convex.solver import solve_newton
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
PEERS = Path(__file__).with_name("peers.py")
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

ADMM = "beside the paper's ADMM, in NumPy"
CLARABEL = "beside CVXPY with Clarabel"

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

PARTS = "parts/"
"""A folder of results, which each run makes anew: parts that are there stay."""

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
        """Return the path of its Python."""
        return self.folder / "bin/python"

    @property
    def command(self) -> Path:
        """Return the path of its command `shapefit`."""
        return self.folder / "bin/shapefit"


class Bench(NamedTuple):
    """What the cases need: the environments of both versions, folders of real data
    where there are any, a folder for files, and whether few repeats suffice.
    """

    old: Environment
    new: Environment
    mocap: Path | None
    cars: Path | None
    folder: Path
    quick: bool

    @property
    def repeats(self) -> int:
        """Return how often either version runs."""
        return 3 if self.quick else 5


class Turn(NamedTuple):
    """What one run took, seconds or GB of memory; the share of images that ended well;
    and the sum of their objectives.
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
    """Run both versions in turns and return the row of a case; its ratio is the median
    of those of each turn.

    Figures are images per second where the number of images is given, else in the unit.
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
    """Yield the name of each case and the function that measures it."""
    for name, build in kernels(bench):
        yield name, partial(compare_kernel, bench, name, build)
    yield ADMM, partial(compare_peer, bench, ADMM, "admm", 60)
    yield CLARABEL, partial(compare_peer, bench, CLARABEL, "clarabel", 20)
    for name, command in commands(bench).items():
        yield name, partial(compare_commands, bench, name, command)
    yield "signal, k=2000, p=1000", partial(compare_interrupts, bench)


def kernels(bench: Bench) -> Iterator[tuple[str, Callable[[], Arrays]]]:
    """Yield the name of each convex program and the function that makes its arrays."""
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
    """Compare the solvers of both versions on a convex program, in warm processes that
    take turns.
    """
    arrays, data = build(), bench.folder / "arrays.npz"
    np.savez(data, **arrays)
    with ExitStack() as stack:
        sides = [
            stack.enter_context(Worker(side.python, WORKER, data)).take_turn
            for side in (bench.old, bench.new)
        ]
        return compare(
            name, sides, bench.repeats, len(arrays["landmarks"]), certified=True
        )


def compare_peer(bench: Bench, name: str, peer: str, count: int) -> Row:
    """Compare this solver with another one of peers.py, which runs in the environment
    of this process, on images from all of the motion capture, or made ones without it.
    """
    arrays = mocap_case(bench.mocap) if bench.mocap else made_case(500, 64, 15)
    w = arrays["landmarks"]
    arrays["landmarks"] = w[:: len(w) // count][:count]
    problem = build_problem(arrays["landmarks"], arrays["atoms"], LAMBDA)
    optimum = solve_newton(problem, tolerance=1e-8).objective
    data = bench.folder / "arrays.npz"
    np.savez(data, **arrays, optimum=optimum)
    with (
        Worker(Path(sys.executable), PEERS, data, peer) as other,
        Worker(bench.new.python, WORKER, data) as this,
    ):
        sides = [other.take_turn, this.take_turn]
        return compare(name, sides, bench.repeats, count, certified=True)


class Worker:
    """A process that runs a script on a file of arrays, and has solved it once."""

    def __init__(self, python: Path, script: Path, data: Path, *options: str) -> None:
        self._process = subprocess.Popen(
            [python, "-P", script, data, *options],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            cwd="/",
            env=os.environ | ONE_THREAD,
        )
        self._read()

    def take_turn(self) -> Turn:
        """Solve the program once; return what that took."""
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
    """Return the arrays that `build` makes, with a share of the landmarks hidden,
    others in each image.
    """
    arrays, rng = build(), np.random.default_rng(0)
    n, _, p = arrays["landmarks"].shape
    hidden = rng.random((n, p)).argsort(axis=1) < round(share * p)
    return arrays | {
        "landmarks": np.where(hidden[:, None, :], np.nan, arrays["landmarks"])
    }


def shuffle(build: Callable[[], Arrays]) -> Arrays:
    """Return the arrays that `build` makes, with the images in random order, so that
    none resembles the one before it.
    """
    arrays = build()
    order = np.random.default_rng(0).permutation(len(arrays["landmarks"]))
    return arrays | {"landmarks": arrays["landmarks"][order]}


def program_arrays(landmarks: Floats, atoms: Floats) -> Arrays:
    """Return the arrays of the convex program of normalised landmarks (n, 2, p), nan =
    hidden, and atoms (k, 3, p).
    """
    return {"landmarks": landmarks, "atoms": atoms, "lam": np.array(LAMBDA)}


def made_case(n: int, k: int, p: int) -> Arrays:
    """Return the program of k shapes of a random 10-dimensional family as atoms, and n
    other members of it, rotated, as images of p landmarks.

    Images come in runs of 50 between two shapes and two views, as frames of a sequence
    do.
    """
    rng = np.random.default_rng(0)
    mean, modes = rng.standard_normal((3, p)), rng.standard_normal((10, 3, p))

    def make_shapes(weights: Floats) -> Floats:
        return normalise(mean + 0.3 * np.tensordot(weights, modes, 1)).points

    atoms = make_shapes(rng.standard_normal((k, 10)))
    atoms /= np.linalg.norm(atoms, axis=(1, 2))[:, None, None]
    runs = -(-n // 50)
    ends = rng.standard_normal((runs, 2, 10))
    t = np.linspace(0, 1, 50)[None, :, None]
    weights = (ends[:, :1] * (1 - t) + ends[:, 1:] * t).reshape(-1, 10)[:n]
    starts = random_rotations(runs, rng)
    about = rotation_about(np.array([0.0, 1.0, 0.0]), np.linspace(0, np.pi / 4, 50))
    views = (about[None] @ starts[:, None]).reshape(-1, 3, 3)[:n]
    exact = (views @ make_shapes(weights))[:, :2]
    landmarks = exact + 0.02 * rng.standard_normal((n, 2, p))
    return program_arrays(normalise(landmarks).points, atoms)


def random_case(n: int, k: int, p: int) -> Arrays:
    """Return the program of k random atoms and n random images of p landmarks, which
    have nothing in common: nearly all atoms are active.
    """
    rng = np.random.default_rng(0)
    atoms, w = rng.standard_normal((k, 3, p)), rng.standard_normal((n, 2, p))
    atoms = normalise(atoms).points
    atoms /= np.linalg.norm(atoms, axis=(1, 2))[:, None, None]
    return program_arrays(normalise(w).points, atoms)


def mocap_case(folder: Path) -> Arrays:
    """Return the program of all frames of subject 13, seen by a camera that goes round,
    and the paper's dictionary of subject 86.
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
    return program_arrays(views, learned.atoms)


def cars_case(folder: Path) -> Arrays:
    """Return the program of the annotated cars, each with landmarks of its own hidden,
    and all models but one as atoms.
    """
    models = read_shapes([folder / "models.h5"])
    with open_landmarks([folder / "annotated_cars.h5"]) as source:
        (images,) = source.batches(source.count)
    w = arrange(images, models.landmark_names).as_columns()
    points = normalise(w, np.asarray(np.isfinite(w).all(axis=1))).points
    return program_arrays(
        np.where(np.isfinite(w), points, np.nan),
        normalise(models.as_columns()).points[:-1],
    )


def commands(bench: Bench) -> dict[str, Callable[[Environment], Command]]:
    """Return name of the case -> function from an environment to the command that is
    measured there.
    """

    def make_once(one: Environment, name: str, *command: str | Path) -> Path:
        """Return the file that a command writes, run where it is not there yet."""
        target = bench.folder / ("new" if one is bench.new else "old") / name
        if not target.exists():
            target.parent.mkdir(exist_ok=True)
            run([one.command, *command, "-o", target])
        return target

    def config_options(one: Environment, path: str) -> Command:
        return ["-c", one.source / "configs" / path]

    def fit_one_image(one: Environment, dictionary: str | Path) -> Command:
        return [
            "fit",
            PROJECT / "sample_data/one_person.csv",
            "-d",
            dictionary,
            "-o",
            "out.csv",
        ]

    def copy_image(count: int) -> list[Path]:
        """Write so many files of the same image; return their paths."""
        folder = bench.folder / "copies"
        folder.mkdir(exist_ok=True)
        text = (PROJECT / "sample_data/one_person.csv").read_text()
        files = [folder / f"{number:03}.csv" for number in range(count)]
        for file in files:
            file.write_text(text)
        return files

    def demo_dictionary(one: Environment) -> Path:
        options = config_options(one, "demo/learn-dict.yaml")
        return make_once(one, "demo.h5", "learn-dict", *options)

    def fit_copies(one: Environment, output: str) -> Command:
        return [
            "fit",
            *copy_image(200),
            "-d",
            demo_dictionary(one),
            "-o",
            output,
            "--set",
            "method=convex",
        ]

    found: dict[str, Callable[[Environment], Command]] = {
        "one image": lambda one: [
            *fit_one_image(one, demo_dictionary(one)),
            "--set",
            "method=convex",
        ],
        "one image, people": lambda one: fit_one_image(one, "people"),
        "200 files of one image": partial(fit_copies, output="copies.h5"),
        "200 files of one image, into a folder": partial(fit_copies, output=PARTS),
    }
    if cars := bench.cars:
        data = ["--set", f"data={cars}"]

        def fit_cars(one: Environment, name: str) -> Command:
            learned = make_once(
                one,
                "cars.h5",
                "learn-dict",
                *config_options(one, "cars/learn-dict.yaml"),
                *data,
            )
            return [
                "fit",
                *config_options(one, f"cars/{name}.yaml"),
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

    def learn_dictionary(one: Environment, kind: str = "mocap") -> Path:
        options = config_options(one, f"{kind}/learn-dict.yaml")
        return make_once(one, f"dictionary-{kind}.h5", "learn-dict", *options, trained)

    def project_images(
        one: Environment, count: int, shuffled: bool = False, source: Path = tested
    ) -> Path:
        """Return a file of `count` images of the source, its first or random ones."""
        whole = make_once(
            one,
            f"{source.stem}.h5",
            "project",
            *config_options(one, "mocap/project.yaml"),
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

    def fit_by(
        one: Environment, method: str, landmarks: Path, dictionary: Path
    ) -> Command:
        out = bench.folder / "out.h5"
        return [
            *("fit", landmarks, "-d", dictionary),
            *("--set", f"method={method}", "-o", out),
        ]

    def fit_convex(one: Environment, landmarks: Path) -> Command:
        return fit_by(one, "convex", landmarks, learn_dictionary(one))

    def fit_posterior(one: Environment) -> Command:
        images = project_images(one, 2174)
        return fit_by(one, "posterior", images, learn_dictionary(one, "people"))

    def fit_sequences(one: Environment, landmarks: Path) -> Command:
        return fit_by(one, "sequences", landmarks, learn_dictionary(one, "people"))

    def write_table(name: str, frames: int) -> Path:
        """Write a CSV of so many frames, those of the longest sequence to and fro;
        return its path.
        """
        target = bench.folder / f"{name}.csv"
        if not target.exists():
            source = read_landmarks(project_images(bench.new, 10_000, source=sequence))
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

    def fit_once(one: Environment) -> Path:
        """Return the result of all images by `convex`."""
        options = "-d", learn_dictionary(one), "--set", "method=convex"
        images = project_images(one, 21_740)
        return make_once(one, "result.h5", "fit", images, *options)

    def learn_people(one: Environment) -> Command:
        options = config_options(one, "people/learn-dict.yaml")
        return ["learn-dict", *options, trained, "-o", "out.h5"]

    def learn_from_2d(one: Environment) -> Command:
        images = make_once(one, "pickup.h5", "convert", pickup)
        return ["learn-dict", images, "-o", "out.h5"]

    return found | {
        "fit, 21,740 images": lambda one: fit_convex(one, project_images(one, 21_740)),
        "fit, 21,740 images, shuffled": lambda one: fit_convex(
            one, project_images(one, 21_740, shuffled=True)
        ),
        "posterior, 2,174 images": fit_posterior,
        "sequences, 4,592 frames": lambda one: fit_sequences(
            one, project_images(one, 10_000, source=sequence)
        ),
        "one sequence of 10,000 frames, memory": lambda one: fit_sequences(
            one, write_table("walk", 10_000)
        ),
        "CSV of 100,000 images, memory": lambda one: fit_convex(
            one, write_table("images", 100_000)
        ),
        "info, CSV of 100,000 images": lambda one: [
            "info",
            write_table("images", 100_000),
        ],
        "CSV of 100,000 images to HDF5": lambda one: [
            "convert",
            write_table("images", 100_000),
            "-o",
            "images.h5",
        ],
        "eval, 21,740 images": lambda one: [
            "eval",
            fit_once(one),
            "--truth",
            tested,
            "-o",
            bench.folder / "report",
            "--set",
            "plots=none" if one is bench.new else "plots=false",
        ],
        "verify, 21,740 images": lambda one: [
            "verify",
            fit_once(one),
            "-d",
            learn_dictionary(one),
            "--landmarks",
            project_images(one, 21_740),
        ],
        "learn-dict, people": learn_people,
        "learn-dict, people, by the clock": learn_people,
        "learn-dict, from 2D": learn_from_2d,
        "learn-dict, from 2D, by the clock": learn_from_2d,
    }


def compare_commands(
    bench: Bench, name: str, command: Callable[[Environment], Command]
) -> Row:
    """Compare what a command takes in both versions, which run in turns: seconds of the
    processor, or by the clock or memory where the name of the case ends so.
    """
    in_memory = name.endswith("memory")
    by_clock = name.endswith("by the clock")
    measure = measure_seconds
    if in_memory:
        measure = measure_memory
    elif by_clock:
        measure = measure_clock
    sides = [
        partial(measure, [one.command, *command(one), "-q"], bench.folder)
        for one in (bench.old, bench.new)
    ]
    if in_memory:
        return compare(name, sides, 3, unit="GB")
    if by_clock:
        return compare(name, sides, bench.repeats)
    numpy = np.median(
        [
            measure_seconds(
                [bench.new.python, "-c", "import numpy"], bench.folder
            ).seconds
            for _ in range(5)
        ]
    )
    row = compare(name, sides, bench.repeats)
    seconds = float(row.now.removesuffix(" s"))
    return Row(**{**vars(row), "imports": seconds / float(numpy)})


def measure_seconds(command: Command, folder: Path) -> Turn:
    """Run a command in a folder; return the seconds of the processor that it and its
    processes use.
    """
    shutil.rmtree(folder / PARTS, ignore_errors=True)
    before = os.times()
    run(command, folder)
    after = os.times()
    spent = (after.children_user + after.children_system) - (
        before.children_user + before.children_system
    )
    return Turn(spent)


def measure_clock(command: Command, folder: Path) -> Turn:
    """Run a command in a folder; return the seconds that it takes by the clock."""
    began = time.monotonic()
    run(command, folder)
    return Turn(time.monotonic() - began)


def measure_memory(command: Command, folder: Path) -> Turn:
    """Run a command in a folder; return the most memory that it has, in GB."""
    process = subprocess.Popen(command, cwd=folder, stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode > 1:
        raise RuntimeError(f"{command} failed")
    return Turn(usage.ru_maxrss * 1024 / 1e9)


def compare_interrupts(bench: Bench) -> Row:
    """Compare how long a kernel of either version goes on after SIGINT."""
    sides = [partial(time_interrupt, side.python) for side in (bench.old, bench.new)]
    return compare("signal, k=2000, p=1000", sides, bench.repeats)


def time_interrupt(python: Path) -> Turn:
    """Send SIGINT to a kernel; return the seconds of the processor that it uses from
    there to its end, PATIENCE at most.
    """
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
    """Wait until a process has used `moment` seconds of the processor; return how many
    it has used.
    """
    while (spent := seconds_of(process)) is not None:
        if spent >= moment:
            return spent
        time.sleep(0.005)
    raise RuntimeError("a kernel ended before its signal")


def seconds_of(process: int) -> float | None:
    """Return the seconds of the processor that a process has used, None after its
    end.
    """
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    ticks = int(fields[11]) + int(fields[12])
    return None if fields[0] == "Z" else ticks / os.sysconf("SC_CLK_TCK")


def run(command: Command, folder: Path | None = None) -> None:
    """Run a command in a folder. Raises RuntimeError, with what it printed, where its
    exit code is more than 1, which says that some items failed.
    """
    with tempfile.TemporaryFile() as output:
        done = subprocess.run(
            command, cwd=folder, stdout=output, stderr=output, check=False
        )
        if done.returncode > 1:
            output.seek(0)
            raise RuntimeError(f"{command} failed:\n{output.read().decode()}")
