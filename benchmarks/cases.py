"""What `make bench` measures: kernels in warm processes, and whole commands.

A kernel is a job of worker.py on arrays that are made here. Commands are timed from the outside.
Both are compared with the release before.
"""

from __future__ import annotations

import os
import subprocess
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np

import shapefit
from benchmarks.comparing import NOISE, Row, Turn, compare, compare_workers, compared
from benchmarks.environments import PROJECT, Environment
from shapefit.arrays import Floats
from shapefit.convex.problem import build_problem
from shapefit.convex.solver import solve_newton
from shapefit.dictionary.learning import learn
from shapefit.dictionary.mixture import learn_mixture
from shapefit.geometry.cameras import project, turntable
from shapefit.geometry.normalisation import Normalised, normalise
from shapefit.geometry.pinhole import Camera, depth_sign
from shapefit.geometry.procrustes import generalised_procrustes
from shapefit.geometry.rotations import random_rotations, rotation_about
from shapefit.io import LandmarkSet, open_landmarks, read_shapes
from shapefit.lifting.methods import Settings, choose_method
from shapefit.lifting.perspective.view import mean_coefficients
from shapefit.pipelines.fit.camera import read_intrinsics
from shapefit.pipelines.learn_dict.training_shapes import every_nth

LAMBDA = 0.1

FIT = "method: convex\nlambda: 0.1\n"
TOLERANCES = "tolerance: 1e-4\n", "solver: {tolerance: 1e-4}\n"
"""The same gap for all releases, whatever their default: how they write it now, and once did."""

SUBJECT_13, TEN, MILLION = 21_740, 10, 46
"""Images of subject 13, and how often they are taken: 217,400, and just over 10^6."""

FAST, PART, PARTS = 100_000, 100_000, 2
"""Images a second that `verify` and `eval` are to reach, images of a file of an `eval`, files."""

TILE = """
import sys, numpy as np, shapefit
source, target, files, count, noise = sys.argv[1:]
one, rng = shapefit.read_landmarks(source), np.random.default_rng(0)
noise = float(noise) * np.nanstd(one.landmarks)
for number in range(int(files)):
    rows = np.arange(int(count)) + number * int(count)
    some = one[rows % len(one)]
    moved = some.landmarks + noise * rng.standard_normal(some.landmarks.shape)
    items = [f"image/{row:08}" for row in rows]
    shapefit.write_landmarks(target.format(number), some.replaced(landmarks=moved, items=items))
"""

Arrays = dict[str, Any]
Options = dict[str, object]
Command = list[str | Path]
Clock = Callable[[], float]


@dataclass(frozen=True)
class Bench:
    """The two sides, the real data that there are, a folder for files, turns of a comparison."""

    old: Environment
    new: Environment
    mocap: Path | None
    cars: Path | None
    folder: Path
    quick: bool

    @property
    def repeats(self) -> int:
        """Turns, where a case does not need fewer."""
        return 3 if self.quick else 7

    @property
    def sides(self) -> tuple[Environment, Environment]:
        """The release before and this version."""
        return self.old, self.new


def cases(bench: Bench) -> Iterator[tuple[str, Callable[[], Row]]]:
    """Yield what can be measured, each with its name."""
    for kernel in kernels(bench):
        yield kernel.name, partial(compare_kernel, bench, kernel)
    for name, run in COMMANDS.items():
        if bench.mocap or run not in WITH_MOCAP:
            yield name, partial(run, bench, name)


@dataclass(frozen=True)
class Kernel:
    """A job of worker.py on the arrays that `build` makes.

    Both sides run with the same options, unless `instead_of` says that this version is compared
    with itself under other ones. `certified`: every image must be solved to its gap.
    """

    name: str
    job: str
    build: Callable[[], Arrays]
    options: Options
    instead_of: Options | None = None
    certified: bool = False
    repeats: int = 7


def kernels(bench: Bench) -> Iterator[Kernel]:
    """Yield motion capture with few landmarks, cars with many, made cases of all sizes."""
    wall: Options = {"clock": "wall"}
    one: Options = {"threads": 1}
    if mocap := bench.mocap:
        frames = cache(partial(mocap_case, mocap))
        yield newton("subject 13, gap 1e-4", frames)
        yield newton("subject 13, gap 1e-6", frames, 1e-6)
        yield newton("subject 13, 30% hidden", partial(hide, frames, 0.3))
        yield newton("subject 13, shuffled", partial(shuffle, frames))
        how: Options = {"tolerance": 1e-4} | wall
        two = how | {"threads": 2}
        yield Kernel("two threads over one", "newton", frames, two, instead_of=how | one)
        for p, n in ((15, 500), (41, 60), (75, 20)):
            build = partial(bodies, mocap, p, n)
            how = one | {"residual_variance": 0.006}
            yield Kernel(f"posterior, 32 components, p={p}", "posterior", build, how, repeats=5)
        build = partial(training, mocap)
        yield Kernel("learn-dict, k=128", "learn", build, {"k": 128} | wall, repeats=3)
    if cars := bench.cars:
        yield newton("cars, p=66", partial(cars_case, cars))
        for method, lam in (("convex+refine", 1.0), ("alternate", 0.1)):
            build = partial(cars_with_mean, cars, lam)
            yield Kernel(f"cars, {method}", "lift", build, one | {"method": method})
        yield Kernel("cars, perspective", "perspective", partial(cars_in_perspective, cars), one)
        yield Kernel("cars, RANSAC", "ransac", partial(cars_with_mean, cars, 1.0), one)
    for k, p in ((64, 15), (256, 33), (64, 66), (64, 1000)):
        made = cache(partial(made_case, 20_000 // p, k, p))
        yield replace(newton(f"made, k={k}, p={p}", made), repeats=3)
        if p < 1000:
            hidden = partial(hide, made, 0.3)
            yield replace(newton(f"made, k={k}, p={p}, 30% hidden", hidden), repeats=3)


def newton(name: str, build: Callable[[], Arrays], tolerance: float = 1e-4) -> Kernel:
    """The convex program on one thread."""
    options: Options = {"tolerance": tolerance, "threads": 1}
    return Kernel(name, "newton", build, options, certified=True)


def compare_kernel(bench: Bench, kernel: Kernel) -> Row:
    """Write the arrays of a kernel and let both sides take turns."""
    arrays, data = kernel.build(), bench.folder / "arrays.npz"
    np.savez(data, **arrays)
    alone = kernel.instead_of is not None
    found = compare_workers(
        ((bench.new if alone else bench.old).python, kernel.instead_of or kernel.options),
        (bench.new.python, kernel.options),
        kernel.job,
        data,
        min(bench.repeats, kernel.repeats),
    )
    images = len(arrays.get("landmarks", ()))
    least = 0.0 if alone else NOISE
    return compared(kernel.name, found, images=images, certified=kernel.certified, least=least)


def program(landmarks: Floats, atoms: Floats) -> Arrays:
    """The convex program of normalised landmarks (n, 2, p), nan = hidden, and atoms (k, 3, p)."""
    return {"landmarks": landmarks, "atoms": atoms, "lam": np.array(LAMBDA)}


def hide(build: Callable[[], Arrays], share: float, seed: int = 0) -> Arrays:
    """The case with a share of the landmarks hidden, a different mask each image."""
    arrays, rng = build(), np.random.default_rng(seed)
    n, _, p = arrays["landmarks"].shape
    hidden = rng.random((n, p)).argsort(axis=1) < round(share * p)
    return arrays | {"landmarks": np.where(hidden[:, None, :], np.nan, arrays["landmarks"])}


def shuffle(build: Callable[[], Arrays], seed: int = 0) -> Arrays:
    """The case in another order, as single photographs come: no image has a neighbour."""
    arrays = build()
    order = np.random.default_rng(seed).permutation(len(arrays["landmarks"]))
    return arrays | {"landmarks": arrays["landmarks"][order]}


def made_case(n: int, k: int, p: int, seed: int = 0) -> Arrays:
    """Exemplar shapes of a 10-dimensional family as atoms; other members of it, turned, as images.

    Images come in runs of 50 between two shapes and two views, as frames of a sequence do.
    """
    rng = np.random.default_rng(seed)
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


def mocap_case(folder: Path) -> Arrays:
    """All frames of subject 13 under the turntable, and the paper's dictionary of subject 86."""
    shapes = read_shapes([folder / "subject13_24fps.h5"])
    lengths = Counter(shapes.sequences)
    turns = np.concatenate([np.arange(length) / length for length in lengths.values()])
    views = normalise(project(shapes.shapes, turntable(turns, "y"))).points
    *_, learned = learn(training(folder)["shapes"], 64, 0.1, iterations=15)
    return program(views, learned.atoms)


def cars_case(folder: Path, times: int = 10) -> Arrays:
    """Annotated cars, each with its mask, several times over; all models but one as atoms."""
    images, atoms = read_cars(folder)
    points = np.where(np.isfinite(images.landmarks), normalise_visible(images).points, np.nan)
    return program(np.tile(points, (times, 1, 1)), atoms)


def cars_with_mean(folder: Path, lam: float) -> Arrays:
    """Annotated cars, once each, with the mean of their models."""
    arrays = cars_case(folder, times=1)
    return arrays | {"lam": np.array(lam), "mean_shape": arrays["atoms"].mean(axis=0)}


def cars_in_perspective(folder: Path) -> Arrays:
    """Cars, their cameras in normalised units, and the rotations that the refinement starts from.

    The optical axis is at 0, 0 (see configs/cars/fit.yaml).
    """
    images, _ = read_cars(folder)
    arrays, norm = cars_with_mean(folder, 1.0), normalise_visible(images)
    atoms, mean = arrays["atoms"], arrays["mean_shape"]
    settings = Settings(solve=partial(solve_newton, tolerance=1e-4), mean_shape=mean)
    found = choose_method("convex+refine", settings)(build_problem(arrays["landmarks"], atoms, 1.0))
    focal, _ = read_intrinsics(images, "camera_matrix")
    camera = Camera(focal, np.zeros_like(focal), depth_sign(images.y_axis)).normalised_as(norm)
    return arrays | {
        "rotation": found.rotation,
        "prior": mean_coefficients(atoms, mean),
        "focal": camera.focal,
        "centre": camera.centre,
        "sign": np.array(camera.sign),
    }


def read_cars(folder: Path) -> tuple[LandmarkSet, Floats]:
    """Annotated cars, their landmarks in the order of the models, and the normalised models."""
    models = read_shapes([folder / "models.h5"])
    with open_landmarks([folder / "annotated_cars.h5"]) as source:
        (images,) = source.batches(source.count)
    return images.arrange(models.landmark_names), normalise(models.shapes).points[:-1]


def normalise_visible(images: LandmarkSet) -> Normalised:
    """Normalise by the landmarks that are seen."""
    return normalise(images.landmarks, np.asarray(np.isfinite(images.landmarks).all(axis=1)))


def training(folder: Path) -> Arrays:
    """The paper's training shapes, as learn-dict aligns them."""
    shapes = read_shapes([folder / "subject86_24fps.h5"])
    retained = every_nth(shapes.sequences or (), 3)
    return {"shapes": generalised_procrustes(normalise(shapes.shapes[retained]).points).shapes}


def bodies(folder: Path, p: int, n: int) -> Arrays:
    """Frames of subject 86 with p landmarks, and a prior of 32 components from the other frames.

    Landmarks beyond the joints lie between two of them, where a third one pulls, with an error.
    """
    shapes = read_shapes([folder / "subject86_24fps.h5"])
    rng = np.random.default_rng(p)
    joints = shapes.shapes.shape[2]
    mixing = np.eye(joints, p)
    for column in range(joints, p):
        mixing[rng.permutation(joints)[:3], column] = rng.dirichlet([2.0, 2.0, 0.5])
    points = shapes.shapes @ mixing
    points[:, :, joints:] += 0.003 * rng.standard_normal((len(points), 3, p - joints))
    prior_shapes = generalised_procrustes(normalise(points[::3]).points).shapes
    prior = learn_mixture(prior_shapes, 32, shrinkage=0.3, floor=0.01, max_rounds=5).mixture
    visible = points[1 :: len(points) // n][:n]
    atoms = prior.means / np.linalg.norm(prior.means, axis=(1, 2))[:, None, None]
    return {
        "landmarks": normalise(project(visible, turntable(np.arange(n) / n, "y"))).points,
        "atoms": atoms,
        "lam": np.array(LAMBDA),
        "mean_shape": prior_shapes.mean(axis=0),
        "weights": prior.weights,
        "means": prior.means,
        "covariances": prior.covariances,
    }


def compare_many(bench: Bench, case: str) -> Row:
    """All images of subject 13, once or many times, HDF5 to HDF5: in time of the processor."""
    times, repeats = (MILLION, 2) if "10^6" in case else (1, bench.repeats)
    before, now = fits(bench, mocap_command(bench, times), "out.h5")
    return compared(case, compare(before, now, repeats), certified=True)


def compare_threads(bench: Bench, case: str) -> Row:
    """The whole command on two threads beside the same on one, by the clock."""
    command, output = mocap_command(bench, TEN), bench.folder / "out.h5"
    command = own_files(bench, bench.new, [*command, "-c", written_config(bench, bench.new)])
    one, two = (
        partial(
            fit, bench.new, [*command, "--set", f"threads={threads}"], output, time.perf_counter
        )
        for threads in (1, 2)
    )
    found = compare(one, two, min(bench.repeats, 5))
    return compared(case, found, certified=True, least=0.0)


def measure_verify(bench: Bench, case: str) -> Row:
    """All proofs of 217,400 images checked, in time of the processor."""
    command, result = mocap_command(bench, TEN), bench.folder / "out.h5"
    fits(bench, command, result.name)[1]()
    took = timed(
        [bench.new.command, "verify", result, *own_files(bench, bench.new, command[2:])],
        bench.folder,
    )
    return reached(case, FAST, SUBJECT_13 * TEN / took.seconds)


def measure_eval(bench: Bench, case: str) -> Row:
    """Results with error bars judged by a truth, in time of the processor."""
    parts = bench.folder / "eval"
    parts.mkdir()
    for number in range(PARTS):
        write_judged(parts, number)
    command: Command = [bench.new.command, "eval", *sorted(parts.glob("part-*.h5")), "-q"]
    command += ["--truth", "truth-*.h5", "-o", "report"]
    return reached(case, FAST, PARTS * PART / timed(command, parts).seconds)


def reached(case: str, asked: float, rate: float) -> Row:
    """Make a row of images per second beside those asked for."""
    return Row(case, f"{asked:,.0f}/s", f"{rate:,.0f}/s", rate / asked)


def compare_sequences(bench: Bench, case: str) -> Row:
    """A sequence of 4,592 frames by `method: sequences`, with the prior of subject 86."""
    assert bench.mocap
    configs, sequence = bench.old.source / "configs", bench.mocap / "subject13_29_120fps_exact.h5"
    landmarks = made_before(bench, "project", configs / "mocap/project.yaml", sequence)
    output = bench.folder / "out.h5"
    command: Command = ["fit", landmarks, "-d", learned_people(bench), "-c"]
    path = "configs/people/sequences.yaml"
    old, new = (
        partial(fit, one, [*own_files(bench, one, command), one.source / path], output)
        for one in bench.sides
    )
    return compared(case, compare(old, new, min(bench.repeats, 3)))


def compare_posterior(bench: Bench, case: str) -> Row:
    """Images of subject 13 under the prior of subject 86, HDF5 to HDF5."""
    landmarks, some = mocap_command(bench, 1)[1], bench.folder / "some.h5"
    assert isinstance(landmarks, Path)
    tile(bench, bench.old, landmarks, some.name, 1, 2174, 0.0)
    command: Command = ["fit", some, "-d", learned_people(bench), "--set", "method=posterior"]
    output = bench.folder / "out.h5"
    old, new = (
        partial(timed, [one.command, *own_files(bench, one, command), "-o", output], bench.folder)
        for one in bench.sides
    )
    return compared(case, compare(old, new, min(bench.repeats, 5)))


def compare_learning(bench: Bench, case: str) -> Row:
    """A dictionary of people with its prior, from subject 86."""
    assert bench.mocap
    given: Command = [
        bench.mocap / "subject86_24fps.h5",
        "-o",
        bench.folder / "learned.h5",
        "-q",
        "-c",
    ]
    config = "configs/people/learn-dict.yaml"
    old, new = (
        partial(timed, [one.command, "learn-dict", *given, one.source / config], bench.folder)
        for one in bench.sides
    )
    return compared(case, compare(old, new, min(bench.repeats, 3)))


def compare_one(bench: Bench, case: str) -> Row:
    """One image from CSV to CSV, against the release before or against the import of NumPy."""
    command: Command = ["fit", PROJECT / "sample_data/one_person.csv", *people_options(bench)]
    if "people" in case:
        command = [*command[:2], "-d", "people", "-q"]
        output = bench.folder / "out.csv"
        old, new = (partial(fit, one, command, output) for one in bench.sides)
        return compared(case, compare(old, new, 3 * bench.repeats))
    before, now = fits(bench, command, "out.csv")
    if "numpy" not in case:
        return compared(case, compare(before, now, 3 * bench.repeats))
    numpy = partial(timed, [bench.new.python, "-c", "import numpy"], bench.folder)
    return compared(case, compare(numpy, now, 3 * bench.repeats), least=0.0)


COMMANDS: dict[str, Callable[[Bench, str], Row]] = {
    "fit, 21,740 images, CPU": compare_many,
    "fit, 10^6 images, CPU": compare_many,
    "fit, two threads over one": compare_threads,
    "verify, images/s": measure_verify,
    "eval, images/s": measure_eval,
    "sequences end to end": compare_sequences,
    "one image, CSV to CSV": compare_one,
    "one image, people": compare_one,
    "posterior, 2,174 images, CPU": compare_posterior,
    "learn-dict, people, CPU": compare_learning,
    "import numpy over one image, CSV to CSV": compare_one,
}
WITH_MOCAP = (
    compare_many, compare_threads, compare_posterior, compare_learning, measure_verify,
    compare_sequences,
)  # fmt: skip


def mocap_command(bench: Bench, times: int) -> Command:
    """Return the fit of subject 13, `times` times over; the output is to be added."""
    assert bench.mocap
    configs = bench.old.source / "configs/mocap"
    subject_13, subject_86 = (bench.mocap / f"subject{n}_24fps.h5" for n in (13, 86))
    landmarks = made_before(bench, "project", configs / "project.yaml", subject_13)
    dictionary = made_before(bench, "learn-dict", configs / "learn-dict.yaml", subject_86)
    many = bench.folder / f"tiled-{times}.h5"
    if times > 1 and not many.exists():
        tile(bench, bench.old, landmarks, many.name, 1, times * SUBJECT_13, 1e-3)
    return ["fit", many if times > 1 else landmarks, "-d", dictionary]


def learned_people(bench: Bench) -> Path:
    """Return a dictionary with a prior of subject 86."""
    assert bench.mocap
    config = bench.old.source / "configs/people/learn-dict.yaml"
    return made_before(bench, "learn-dict", config, bench.mocap / "subject86_24fps.h5")


def people_options(bench: Bench) -> Command:
    """Return the options of a fit with the dictionary of the demonstration."""
    dictionary = made_before(bench, "learn-dict", bench.old.source / "configs/demo/learn-dict.yaml")
    return ["-d", dictionary]


def fits(bench: Bench, command: Command, output: str) -> list[Callable[[], Turn]]:
    """Return a fit of each side, in time of the processor."""
    target = bench.folder / output
    return [
        partial(
            fit, one, [*own_files(bench, one, command), "-c", written_config(bench, one)], target
        )
        for one in bench.sides
    ]


def own_files(bench: Bench, one: Environment, command: Command) -> Command:
    """Return a command with files in the format of a release: made before, converted for now."""
    if one is not bench.new:
        return command
    return [
        converted(bench, part, f"new-{part.name}")
        if isinstance(part, Path) and part.suffix == ".h5"
        else part
        for part in command
    ]


def converted(bench: Bench, source: Path, name: str) -> Path:
    """Return a file in the format of this version, written once."""
    target = bench.folder / name
    if not target.exists():
        run([bench.new.command, "convert", source, "-o", name], bench.folder)
    return target


def written_config(bench: Bench, one: Environment) -> Path:
    """Write the config of the fits, in the keys of a release."""
    path = bench.folder / ("new.yaml" if one is bench.new else "old.yaml")
    known = (file.read_text("utf-8") for file in (one.source / "configs").rglob("*.yaml"))
    nested = any("\nsolver:" in text for text in known)
    path.write_text(FIT + TOLERANCES[nested], encoding="utf-8")
    return path


def made_before(bench: Bench, command: str, config: Path, *given: Path) -> Path:
    """Return what a command of the release before makes with a config, once for all cases."""
    stem = "-".join([config.parent.name, config.stem, *(path.stem for path in given)])
    target = bench.folder / f"{stem}.h5"
    if not target.exists():
        run([bench.old.command, command, "-c", config, *given, "-o", target], bench.folder)
    return target


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


def tile(
    bench: Bench,
    one: Environment,
    source: Path,
    name: str,
    files: int,
    count: int,
    noise: float,
) -> None:
    """Write files of so many images with one release: those of `source` again and again.

    noise, a share of their standard deviation, is added, so that no two are equal.
    """
    given = map(str, (source, bench.folder / name, files, count, noise))
    run([one.python, "-P", "-c", TILE, *given], bench.folder)


def spent() -> float:
    """Return the processor's seconds of all processes that were started here and have ended."""
    times = os.times()
    return times.children_user + times.children_system


def timed(command: Command, folder: Path, clock: Clock = spent) -> Turn:
    """Time a command."""
    began = clock()
    run(command, folder)
    return Turn(clock() - began)


def fit(one: Environment, command: Command, output: Path, clock: Clock = spent) -> Turn:
    """Time a fit; the share of optimal images is read from a result that holds one."""
    turn = timed([one.command, *command, "-o", output], output.parent, clock)
    if output.suffix != ".h5":
        return turn
    with h5py.File(output) as result:
        counts = Counter(result["status"].asstr()[:].tolist())
        total = float(result["objective"][:].sum())
    return Turn(turn.seconds, well=counts["optimal"] / counts.total(), sum=total)


def run(command: Command, folder: Path) -> None:
    """Run a command, silent unless it fails."""
    with tempfile.TemporaryFile() as told:
        done = subprocess.run(command, cwd=folder, stdout=told, stderr=told, check=False)
        if done.returncode:
            told.seek(0)
            raise RuntimeError(f"{command} failed:\n{told.read().decode()}")
