"""What lowers the error on motion capture, chosen by validation on the training subject.

Usage: python -m benchmarks.mocap_ablation FOLDER [--every N] [--test]. FOLDER holds the motion
capture files. Three folds: the dictionary comes from the sequences of subject 86 outside a fold,
the error from those in it, as they are ("same body") and with bones of other lengths ("other
bodies"). The dictionaries are judged on every N-th frame, the rest on all. `--test` adds the
baseline and the chosen configuration on subjects 13 and 14. Errors are similarity-aligned, for
truth of unit standard deviation, means of sequence means over the folds.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.cases import Floats, turntable_views
from benchmarks.loose_stop import sequence_mean
from shapefit.convex.newton import solve_newton
from shapefit.convex.problem import Loss, build_problem
from shapefit.dictionary.learning import learn
from shapefit.geometry.cameras import project, turntable
from shapefit.geometry.normalisation import normalise
from shapefit.geometry.procrustes import generalised_procrustes
from shapefit.geometry.symmetry import double
from shapefit.io import ShapeSet, read_shapes
from shapefit.lifting.options import DepthOptions
from shapefit.lifting.reconstruction import reconstruct
from shapefit.lifting.temporal import refine_sequences
from shapefit.pipelines.learn_dict.training_shapes import every_nth

FOLDS = (("86_13", "86_14", "86_15"), ("86_01", "86_05", "86_09"), ("86_10", "86_11"))
SIDES = {"r": "l", "l": "r"}
DICTIONARIES: tuple[dict[str, Any], ...] = (
    {},
    {"k": 128},
    {"beta": 0.03},
    {"k": 128, "beta": 0.03},
    {"mirrored": True},
    {"k": 128, "mirrored": True},
)
LAMBDAS = (0.1, 0.01, 0.003, 0.001)
REFINEMENTS = (
    DepthOptions(smoothness=100, rigidity=0, tolerance=0.1),
    DepthOptions(smoothness=100, rigidity=3, tolerance=0.1),
    DepthOptions(smoothness=100, rigidity=30, tolerance=0.1),
    DepthOptions(smoothness=10, rigidity=30, tolerance=0.1),
    DepthOptions(smoothness=10, rigidity=30, tolerance=0.01),
    DepthOptions(smoothness=10, rigidity=100, tolerance=0.01),
)
BEST: dict[str, Any] = {"k": 128}
BEST_LAMBDA = 0.03
PROGRAMS = (0.1, 0.03, 0.01, 0.003, 0.001, None)  # None: exact
CHOSEN = REFINEMENTS[-1]
BONE_SPREAD = 0.1  # standard deviation of the logarithm of a bone's length


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--every", type=int, default=10)
    parser.add_argument("--test", action="store_true")
    arguments = parser.parse_args()
    subject = read_shapes([arguments.folder / "subject86_24fps.h5"])
    names = np.array(subject.sequences)
    folds = [
        (subject.take(~np.isin(names, fold)), subject.take(np.isin(names, fold))) for fold in FOLDS
    ]

    print("| dictionary | " + " | ".join(f"lambda {lam:g}" for lam in LAMBDAS) + " |")
    print("|---|" + "--:|" * len(LAMBDAS))
    for options in DICTIONARIES:
        atoms = [learn_atoms(training, **options) for training, _ in folds]
        errors = [
            np.mean(
                [
                    single_error(held, B, lam, arguments.every)
                    for (_, held), B in zip(folds, atoms, strict=True)
                ]
            )
            for lam in LAMBDAS
        ]
        cells = " | ".join(f"{error:.4f}" for error in errors)
        print(f"| {options or 'k 64, beta 0.1'} | {cells} |", flush=True)

    atoms = [learn_atoms(training, **BEST) for training, _ in folds]
    rng = np.random.default_rng(0)
    bodies = {
        "same body": [held for _, held in folds],
        "other bodies": [with_other_bones(held, rng) for _, held in folds],
    }
    for body, helds in bodies.items():
        print(f"\n| {body} | single images | refined, fitted x y | refined, observed x y |")
        print("|---|--:|--:|--:|")
        for lam in PROGRAMS:
            lifted = [lift_frames(held, B, lam) for held, B in zip(helds, atoms, strict=True)]
            rows = [lifted]
            for observed in (False, True):
                rows.append(
                    [refine(S, h, CHOSEN, observed) for S, h in zip(lifted, helds, strict=True)]
                )
            cells = " | ".join(f"{mean_error(helds, row):.4f}" for row in rows)
            print(f"| {'exact' if lam is None else f'lambda {lam:g}'} | {cells} |", flush=True)
        print(f"\n| {body}: smoothness | rigidity | tolerance | refined, observed x y |")
        print("|--:|--:|--:|--:|")
        lifted = [lift_frames(held, B, BEST_LAMBDA) for held, B in zip(helds, atoms, strict=True)]
        for settings in REFINEMENTS:
            row = [refine(S, h, settings) for S, h in zip(lifted, helds, strict=True)]
            print(
                f"| {settings.smoothness:g} | {settings.rigidity:g} | {settings.tolerance:g} "
                f"| {mean_error(helds, row):.4f} |",
                flush=True,
            )
    if arguments.test:
        test(arguments.folder, subject)


def test(folder: Path, training: ShapeSet) -> None:
    """Print the baseline and the chosen configuration on subjects 13 and 14."""
    print("\n| configuration | subject 13 | subject 14 |\n|---|--:|--:|")
    subjects = [read_shapes([folder / f"subject{name}_24fps.h5"]) for name in ("13", "14")]
    baseline, best = learn_atoms(training), learn_atoms(training, **BEST)
    first = [sequence_mean(lift_frames(truth, baseline, 0.1), truth) for truth in subjects]
    lifted = [lift_frames(truth, best, BEST_LAMBDA) for truth in subjects]
    second = [sequence_mean(S, truth) for S, truth in zip(lifted, subjects, strict=True)]
    refined = [refine(S, truth, CHOSEN) for S, truth in zip(lifted, subjects, strict=True)]
    third = [sequence_mean(S, truth) for S, truth in zip(refined, subjects, strict=True)]
    rows = {"baseline": first, "chosen, single images": second, "chosen, refined": third}
    for name, (subject13, subject14) in rows.items():
        print(f"| {name} | {subject13:.4f} | {subject14:.4f} |")


def learn_atoms(
    training: ShapeSet, *, k: int = 64, beta: float = 0.1, mirrored: bool = False
) -> Floats:
    """Atoms (k, 3, p) from every third frame, with their mirror images or without."""
    kept = every_nth(training.sequences or (), 3)
    shapes = normalise(training.shapes[kept]).points
    if mirrored:
        shapes = double(shapes, partners(training.landmark_names))
    *_, learned = learn(generalised_procrustes(shapes).shapes, k, beta, iterations=15)
    return learned.atoms


def partners(names: tuple[str, ...]) -> list[int]:
    """Index of the landmark on the other side: lhip for rhip, itself for one in the middle."""
    others = [SIDES.get(name[0], name[0]) + name[1:] for name in names]
    return [names.index(o) if o in names else j for j, o in enumerate(others)]


def single_error(held: ShapeSet, atoms: Floats, lam: float, every: int) -> float:
    """Error of the convex program on every N-th frame."""
    chosen = np.arange(0, len(held), every)
    views = turntable_views(held)[chosen]
    found = reconstruct(solve_newton(build_problem(views, atoms, lam)).transforms, atoms)
    return sequence_mean(found.shapes, held.take(chosen))


def lift_frames(held: ShapeSet, atoms: Floats, lam: float | None) -> Floats:
    """Shapes (n, 3, p) for every frame, in the unit of the landmarks.

    Those of the convex program with `lam`, or of the exact one where it is None.
    """
    views = normalise(camera_views(held))
    loss = Loss.EXACT if lam is None else Loss.SQUARED
    problem = build_problem(views.points, atoms, lam or 1.0, loss=loss)
    found = reconstruct(solve_newton(problem).transforms, atoms)
    return found.shapes * views.scale[:, None, None]


def camera_views(shapes: ShapeSet) -> Floats:
    """Landmarks in metres, the camera turning once around each sequence."""
    names = np.array(shapes.sequences)
    turns = np.concatenate(
        [np.arange(n) / n for n in ((names == s).sum() for s in dict.fromkeys(names))]
    )
    return project(shapes.shapes, turntable(turns, "y"))


def refine(shapes: Floats, held: ShapeSet, settings: DepthOptions, observed: bool = True) -> Floats:
    """Refine the depths along each sequence; the edges of the data are the bones."""
    assert held.edges is not None
    views = camera_views(held)
    points = shapes.copy()
    if observed:
        points[:, :2] = views
    return refine_sequences(points, held.sequences or (), held.edges, settings)


def with_other_bones(held: ShapeSet, rng: np.random.Generator) -> ShapeSet:
    """Stretch the bones, by another factor for each bone and sequence, left and right alike."""
    assert held.edges is not None
    names, other = np.array(held.sequences), partners(held.landmark_names)
    shapes = held.shapes.copy()
    for name in dict.fromkeys(held.sequences or ()):
        factors = np.exp(BONE_SPREAD * rng.standard_normal(len(other)))
        frames = names == name
        for i, j in held.edges:  # from the pelvis outwards
            bone = held.shapes[frames][:, :, j] - held.shapes[frames][:, :, i]
            shapes[frames, :, j] = shapes[frames][:, :, i] + factors[min(j, other[j])] * bone
    return replace(held, shapes=shapes)


def mean_error(helds: list[ShapeSet], estimates: list[Floats]) -> float:
    """Mean over the folds of their errors."""
    return float(
        np.mean([sequence_mean(S, held) for held, S in zip(helds, estimates, strict=True)])
    )


if __name__ == "__main__":
    main()
