"""People joined over frames, against figures whose identity is known."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from shapefit.arrays import Floats
from shapefit.io import open_landmarks
from shapefit.io.options import InputOptions
from shapefit.io.readers.poses import Poses
from shapefit.io.readers.tracking import MAX_UNSEEN_FRAMES, assign, track_people

FIGURE = np.array(
    [
        *[(0, 170), (0, 150), (-20, 145), (20, 145), (-28, 90), (28, 90)],
        *[(-10, 90), (10, 90), (-12, 45), (12, 45), (-12, 0), (12, 0)],
    ],
    dtype=float,
)
"""Head, neck, shoulders, hands, hips, knees and feet of a figure 170 pixels high."""


def walking(
    start: float, speed: float, frames: int, rng: np.random.Generator
) -> Floats:
    """A figure (frames, p, 2) of its own size and gait walks across the image, with
    noise.
    """
    phase = 2 * np.pi * (np.arange(frames) / 30 + rng.random())
    swing = np.outer(np.sin(phase), [0, 0, 0, 0, 25, -25, 0, 0, -12, 12, -25, 25])
    figure = np.repeat(rng.uniform(0.8, 1.2) * FIGURE[None], frames, axis=0)
    figure[..., 0] += start + speed * np.arange(frames)[:, None] + swing
    return figure + rng.standard_normal(figure.shape)


def instances(
    people: Sequence[Floats], rng: np.random.Generator | None
) -> tuple[Poses, Floats]:
    """Return detections, people of a frame in any order (rng), and who each is."""
    points, frames, who = [], [], []
    for frame in range(len(people[0])):
        there = [n for n, one in enumerate(people) if np.isfinite(one[frame]).any()]
        for person in there if rng is None else rng.permutation(there):
            points.append(people[person][frame])
            frames.append(frame)
            who.append(person)
    return recording(points, frames), np.array(who)


def recording(points: Sequence[Floats], frames: Sequence[int]) -> Poses:
    """Return detections of nobody in particular."""
    return Poses(
        name="walk",
        video="walk",
        points=np.array(points),
        frame=np.array(frames),
        label=[str(frame) for frame in frames],
        individual=[""] * len(frames),
    )


def tracks(poses: Poses) -> NDArray[np.int64]:
    return np.array(
        [int(who.partition(" ")[2] or 0) for who in track_people(poses) or ()]
    )


def same_partition(found: NDArray[np.int64], who: Floats) -> bool:
    return (
        len({*zip(found.tolist(), who.tolist(), strict=True)})
        == len({*who.tolist()})
        == len({*found.tolist()})
    )


@pytest.mark.parametrize("seed", range(20))
def test_two_people_who_cross_in_any_order(seed: int) -> None:
    rng = np.random.default_rng(seed)
    people = [walking(0, 6, 120, rng), walking(700, -6, 120, rng)]
    block, who = instances(people, rng)
    assert same_partition(tracks(block), who)


def test_a_short_gap_is_survived_and_a_long_one_is_not(
    rng: np.random.Generator,
) -> None:
    for gap, numbers in ((MAX_UNSEEN_FRAMES, {1}), (MAX_UNSEEN_FRAMES + 1, {1, 2})):
        one = walking(0, 1, 60, rng)
        one[20 : 20 + gap] = np.nan
        assert {*tracks(instances([one], None)[0]).tolist()} == numbers


def test_identities_of_the_file_and_empty_detections_stay(
    rng: np.random.Generator,
) -> None:
    block, _ = instances([walking(0, 1, 4, rng), walking(500, 1, 4, rng)], None)
    points = block.points.copy()
    points[2] = np.nan
    block = replace(block, individual=["", "person 1", *[""] * 6], points=points)
    assert track_people(block) == [
        "person 2",
        "person 1",
        "",
        *["person 3", "person 2"] * 2,
        "person 3",
    ]


def test_videos_have_their_own_tracks(rng: np.random.Generator) -> None:
    block, who = instances([walking(0, 1, 20, rng), walking(0, 1, 20, rng)], None)
    order = np.lexsort((block.frame, who))
    block = replace(block, video=[f"camera {n}" for n in who.tolist()]).take(order)
    assert (tracks(block) == who[order] + 1).all()


def test_assignment_is_optimal(rng: np.random.Generator) -> None:
    """Against scipy on the whole matrix: as many pairs, and no greater cost."""
    for _ in range(300):
        cost = rng.random(rng.integers(1, 6, size=2))
        allowed = rng.random(cost.shape) < 0.7
        pairs = assign(cost, allowed)
        rows, columns = linear_sum_assignment(np.where(allowed, cost, 1000.0))
        best = [(a, b) for a, b in zip(rows, columns, strict=True) if allowed[a, b]]
        assert (
            len({a for a, _ in pairs})
            == len({b for _, b in pairs})
            == len(pairs)
            == len(best)
        )
        assert all(allowed[pair] for pair in pairs)
        assert sum(cost[p] for p in pairs) == pytest.approx(sum(cost[p] for p in best))


@pytest.mark.real_data
@pytest.mark.parametrize(("camera", "agreeing"), [("cam01", 99), ("cam03", 100)])
def test_the_man_on_the_beam_is_one_person(
    real_data: Path, camera: str, agreeing: int
) -> None:
    """One track is the man that the HDF5 beside has; in a frame of cam01 he is in two
    parts.
    """
    folder = real_data / "detected" / "pose2sim_balancing"
    with h5py.File(folder / f"{camera}.h5") as file:
        truth = file["landmarks"][:]
        frames = [int(item.decode().split("/")[-1]) for item in file["item"][:]]
    options = InputOptions(keypoints="body_25b", track="nearest")
    with open_landmarks(
        [folder / "openpose_json" / f"{camera}_json"], options
    ) as source:
        images = source.whole()
    assert images.sequences is not None
    man = images.take([name.endswith("person 1") for name in images.sequences])
    assert len(man) == 100
    found = dict(
        zip(
            (int(item.split("/")[-1]) for item in man.items),
            man.as_columns(),
            strict=True,
        )
    )
    same = [
        np.allclose(found[frame].T, own, atol=1e-3, equal_nan=True)
        for frame, own in zip(frames, truth, strict=True)
    ]
    assert sum(same) == agreeing


def follow(figures: Sequence[Floats], frames: Sequence[int]) -> list[int]:
    """Return the numbers of the tracks of one figure a frame."""
    return tracks(recording(figures, frames)).tolist()


SIZE = float(np.hypot(56, 170))
"""Diagonal of the box of FIGURE."""


@pytest.mark.parametrize(
    ("missed", "moved", "same"),
    [
        (0, 0.33, True),
        (0, 0.4, False),
        (3, 0.6, True),
        (3, 0.7, False),
        (9, 0.95, True),
    ],
)
def test_the_reach_grows_with_the_frames_that_are_missed(missed, moved, same):
    """0.35 of the size, and 0.1 for each frame without a detection, up to 1."""
    there = FIGURE + np.array([moved * SIZE, 0])
    found = follow([FIGURE, there], [0, missed + 1])
    assert (found[0] == found[1]) == same


@pytest.mark.parametrize(("moved", "same"), [(0.7, True), (0.8, False)])
def test_who_is_missed_is_expected_to_walk_on_for_three_frames(moved, same):
    """And then to stand: 4 missed frames add 0.4 to the reach of 0.35."""
    step = np.array([0.2 * SIZE, 0])
    walk = [FIGURE + number * step for number in range(30)]
    found = follow([*walk, walk[-1] + 3 * step + (moved * SIZE, 0)], [*range(30), 34])
    assert (found[0] == found[-1]) == same


@pytest.mark.parametrize(("frames", "same"), [(2, True), (60, False)])
def test_the_size_of_somebody_half_hidden_shrinks_slowly(frames, same):
    """It is at least 0.95 of that in the frame before: for some frames hidden limbs
    count.
    """
    half = FIGURE.copy()
    half[1:4] += (0, 20)
    half[4:] = np.nan
    parts = [FIGURE, *[half] * frames, half + np.array([40, 0])]
    found = follow(parts, list(range(len(parts))))
    assert (found[0] == found[-1]) == same


@pytest.mark.parametrize(("moved", "same"), [(25, True), (40, False)])
def test_without_a_landmark_in_common_the_middles_of_the_boxes_are_compared(
    moved, same
):
    left = FIGURE.copy()
    right = FIGURE + np.array([moved, 0])
    left[1::2], right[::2] = np.nan, np.nan
    found = follow([left, right], [0, 1])
    assert (found[0] == found[1]) == same
