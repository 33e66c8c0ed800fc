"""People joined over frames, against figures whose identity is known."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from numpy.testing import assert_array_equal
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from shapefit.arrays import Floats
from shapefit.io import open_landmarks
from shapefit.io.options import InputOptions
from shapefit.io.readers.poses import Poses, name_individual
from shapefit.io.readers.tracking import MAX_UNSEEN_FRAMES, assign, track_people

FIGURE = np.array(
    [
        (0, 170),
        (0, 150),
        (-20, 145),
        (20, 145),
        (-28, 90),
        (28, 90),
        (-10, 90),
        (10, 90),
        (-12, 45),
        (12, 45),
        (-12, 0),
        (12, 0),
    ],
    dtype=float,
)
"""Head, neck, shoulders, hands, hips, knees and feet of a figure 170 pixels high."""


SWING = [0, 0, 0, 0, 25, -25, 0, 0, -12, 12, -25, 25]
"""How far each landmark swings, in pixels."""


def walking(
    start: float, speed: float, frames: int, rng: np.random.Generator
) -> Floats:
    """A figure (frames, p, 2) of its own size and gait walks across the image, with
    noise.
    """
    frame = np.arange(frames)
    phase = 2 * np.pi * (frame / 30 + rng.random())
    size = rng.uniform(0.8, 1.2)
    figure = np.repeat(size * FIGURE[None], frames, axis=0)
    swing = np.outer(np.sin(phase), SWING)
    figure[..., 0] += start + speed * frame[:, None] + swing
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
    """Return the number of the track of each pose, 0 for none."""
    names = track_people(poses) or ()
    return np.array([int(name.partition(" ")[2] or 0) for name in names])


def same_partition(found: NDArray[np.int64], who: Floats) -> bool:
    """Say whether each track is one person, and each person one track."""
    pairs = {*zip(found.tolist(), who.tolist(), strict=True)}
    return len(pairs) == len({*who.tolist()}) == len({*found.tolist()})


@pytest.mark.parametrize("seed", range(20))
def test_two_people_who_cross_in_any_order(seed: int) -> None:
    rng = np.random.default_rng(seed)
    people = [walking(0, 6, 120, rng), walking(700, -6, 120, rng)]
    block, who = instances(people, rng)
    assert same_partition(tracks(block), who)


@pytest.mark.parametrize(
    ("gap", "numbers"), [(MAX_UNSEEN_FRAMES, {1}), (MAX_UNSEEN_FRAMES + 1, {1, 2})]
)
def test_a_short_gap_is_survived_and_a_long_one_is_not(
    rng: np.random.Generator, gap: int, numbers: set[int]
) -> None:
    person = walking(0, 1, 60, rng)
    person[20 : 20 + gap] = np.nan
    poses, _ = instances([person], None)
    assert {*tracks(poses).tolist()} == numbers


def test_identities_of_the_file_and_empty_detections_stay(
    rng: np.random.Generator,
) -> None:
    people = [walking(0, 1, 4, rng), walking(500, 1, 4, rng)]
    poses, _ = instances(people, None)
    points = poses.points.copy()
    points[2] = np.nan
    given = ["", "person 1", *[""] * 6]
    poses = replace(poses, individual=given, points=points)
    expected = ["person 2", "person 1", "", "person 3", "person 2", "person 3"]
    assert track_people(poses) == [*expected, "person 2", "person 3"]


def test_videos_have_their_own_tracks(rng: np.random.Generator) -> None:
    people = [walking(0, 1, 20, rng), walking(0, 1, 20, rng)]
    poses, who = instances(people, None)
    order = np.lexsort((poses.frame, who))
    videos = [f"camera {number}" for number in who.tolist()]
    of_two_cameras = replace(poses, video=videos).take(order)
    assert_array_equal(tracks(of_two_cameras), who[order] + 1)


def optimal_pairs(cost: Floats, allowed: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return the pairs that scipy finds in the whole matrix."""
    rows, columns = linear_sum_assignment(np.where(allowed, cost, 1000.0))
    pairs = zip(rows, columns, strict=True)
    return [(row, column) for row, column in pairs if allowed[row, column]]


def test_assignment_is_optimal(rng: np.random.Generator) -> None:
    """Against scipy on the whole matrix: as many pairs, and no greater cost."""
    for _ in range(300):
        cost = rng.random(rng.integers(1, 6, size=2))
        allowed = rng.random(cost.shape) < 0.7
        pairs = assign(cost, allowed)
        best = optimal_pairs(cost, allowed)
        total = sum(cost[pair] for pair in pairs)
        least = sum(cost[pair] for pair in best)
        assert len(pairs) == len(best)
        assert len({row for row, _ in pairs}) == len(pairs)
        assert len({column for _, column in pairs}) == len(pairs)
        assert all(allowed[pair] for pair in pairs)
        assert total == pytest.approx(least)


def last_number(item: str) -> int:
    return int(item.split("/")[-1])


@pytest.mark.real_data
@pytest.mark.parametrize(("camera", "agreeing"), [("cam01", 99), ("cam03", 100)])
def test_the_man_on_the_beam_is_one_person(
    real_data: Path, camera: str, agreeing: int
) -> None:
    """One track is the man that the HDF5 beside has; in a frame of cam01 he is in two
    parts.
    """
    folder = real_data / "detected" / "pose2sim_balancing"
    detections = folder / "openpose_json" / f"{camera}_json"
    with h5py.File(folder / f"{camera}.h5") as file:
        truth = file["landmarks"][:]
        frames = [last_number(item.decode()) for item in file["item"][:]]
    options = InputOptions(keypoints="body_25b", track="nearest")
    with open_landmarks([detections], options) as source:
        images = source.whole()
    man = images.take([name.endswith("person 1") for name in images.sequences])
    by_frame = dict(zip(map(last_number, man.items), man.landmarks, strict=True))
    agree = [
        np.allclose(by_frame[frame], points, atol=1e-3, equal_nan=True)
        for frame, points in zip(frames, truth, strict=True)
    ]
    assert len(man) == 100
    assert sum(agree) == agreeing


def is_followed(figures: Sequence[Floats], frames: Sequence[int]) -> bool:
    """Say whether the last of one figure a frame is the first."""
    numbers = tracks(recording(figures, frames))
    return numbers[0] == numbers[-1]


REACH = [
    (0, 0.33, True),
    (0, 0.4, False),
    (3, 0.6, True),
    (3, 0.7, False),
    (9, 0.95, True),
]
"""Missed frames, how far a figure moved in its size, and whether it is the same."""


SIZE = float(np.hypot(56, 170))
"""Diagonal of the box of FIGURE."""


@pytest.mark.parametrize(("missed", "moved", "same"), REACH)
def test_the_reach_grows_with_the_frames_that_are_missed(missed, moved, same):
    """0.35 of the size, and 0.1 for each frame without a detection, up to 1."""
    moved_figure = FIGURE + np.array([moved * SIZE, 0])
    assert is_followed([FIGURE, moved_figure], [0, missed + 1]) == same


@pytest.mark.parametrize(("moved", "same"), [(0.7, True), (0.8, False)])
def test_who_is_missed_is_expected_to_walk_on_for_three_frames(moved, same):
    """And then to stand: 4 missed frames add 0.4 to the reach of 0.35."""
    step = np.array([0.2 * SIZE, 0])
    walk = [FIGURE + number * step for number in range(30)]
    stands = walk[-1] + 3 * step
    found_again = stands + np.array([moved * SIZE, 0])
    assert is_followed([*walk, found_again], [*range(30), 34]) == same


@pytest.mark.parametrize(("frames", "same"), [(2, True), (60, False)])
def test_the_size_of_somebody_half_hidden_shrinks_slowly(frames, same):
    """It is at least 0.95 of that in the frame before: for some frames hidden limbs
    count.
    """
    half = FIGURE.copy()
    half[1:4] += (0, 20)
    half[4:] = np.nan
    moved = half + np.array([40, 0])
    figures = [FIGURE, *[half] * frames, moved]
    assert is_followed(figures, range(len(figures))) == same


@pytest.mark.parametrize(("moved", "same"), [(25, True), (40, False)])
def test_without_a_landmark_in_common_the_middles_of_the_boxes_are_compared(
    moved, same
):
    left = FIGURE.copy()
    right = FIGURE + np.array([moved, 0])
    left[1::2] = np.nan
    right[::2] = np.nan
    assert is_followed([left, right], [0, 1]) == same


IDENTITIES = [
    ("Ann", "Ann"),
    (3, "id 3"),
    (0, "id 0"),
    (2.0, "id 2"),
    ([7], "id 7"),
    ([["Ann"]], "Ann"),
    (-1, ""),
    ([-1], ""),
    (True, ""),
    (None, ""),
    ({}, ""),
    ([], ""),
    ([3, 4], ""),
    (["Ann", "Bob"], ""),
]
"""What a file gives for an identity, and the name of the individual."""


@pytest.mark.parametrize(("who", "name"), IDENTITIES)
def test_an_identity_is_a_text_or_a_number_from_0(who, name):
    assert name_individual(who) == name
