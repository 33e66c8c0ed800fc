"""Frames of a page: thinned, in sequences, at a rate."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from shapefit.io import (
    read_results,
)
from shapefit.viewer.page import viewer_page

LONG = 20_000
"""Frames of a film."""


@pytest.fixture
def film(desk, monkeypatch):
    """A result of one long sequence and twenty short ones, whose page may have 1 MB."""
    monkeypatch.setattr("shapefit.pipelines.view.reading.MAX_MEGABYTES", 1)
    short = tuple(f"short{i % 20}" for i in range(LONG - 60, LONG))
    sequences = ("long",) * (LONG - 60) + short
    return desk.result(n=LONG, sequences=sequences, frame_rate=60.0)


def test_many_frames_are_thinned_until_the_page_is_small(desk, film):
    scene = desk.scene(film)
    assert 100_000 < len(viewer_page(scene)) <= 1_000_000


def test_frames_are_thinned_by_sequence_and_the_page_says_so(desk, film):
    scene = desk.scene(film)
    step = round(LONG / len(scene["items"]))
    assert step > 1
    assert scene["notes"][0].startswith(f"One of {step} frames is shown")
    assert scene["frame_rate"] == 60 / step
    assert scene["items"][:2] == ("i0", f"i{step}")
    assert len(scene["sequences"]) == 21
    third_point = scene["layers"][0]["points"][2]
    expected = read_results(film).as_columns()[2 * step]
    assert_allclose(third_point, expected)


def test_few_frames_that_were_chosen_are_all_shown(desk, film):
    scene = desk.scene(film, items=("i19???",))
    assert len(scene["items"]) == 1000
    assert scene["frame_rate"] == 60


def test_many_frames_that_were_chosen_are_thinned(desk, film):
    """Every third of them."""
    scene = desk.scene(film, items=("i*[0-2]",))
    assert scene["items"][:3] == ("i0", "i10", "i20")


def test_sequences_are_put_together(desk):
    page = desk.view(desk.result(n=4, sequences=("x", "y", "x", "y"))).data
    assert page["items"] == ["i0", "i2", "i1", "i3"]
    assert page["sequences"] == [["x", 0], ["y", 2]]


def test_the_sequence_of_an_item_is_that_of_the_first_file(desk):
    first = desk.result("first.h5", n=4, sequences=("x", "x", "y", "y"))
    second = desk.result("second.h5", n=4, sequences=("z",) * 4)
    assert desk.scene(first, second)["sequences"] == (("x", 0), ("y", 2))


def test_sequences_of_one_frame_are_none(desk):
    page = desk.view(desk.result(n=4, sequences=("x", "y", "z", "w"))).data
    assert page["sequences"] == [["", 0]]


def test_individuals_and_their_frames_are_counted(desk):
    reasons = [""] * 20 + ["wide error bars"] * 20 + [""]
    extras = {
        "frame": np.r_[0:20, 0:20, 3],
        "reasons": np.array(reasons, object),
    }
    items = tuple(f"v/{'abc'[i // 20]}/{i}" for i in range(41))
    sequences = tuple(item[:3] for item in items)
    result = desk.result(n=41, items=items, sequences=sequences, extras=extras)
    page = desk.scene(result)
    assert page["recordings"] == [[0, 1, 2]]
    assert [fact["text"] for fact in page["facts"]] == [
        "3 individuals",
        "20 frames",
        "24 Hz assumed",
        "21 of 41 trusted",
    ]


def test_the_frame_rate_is_that_of_the_result(desk):
    result = desk.result(sequences=("s",) * 6, frame_rate=30.0)
    assert desk.view(result).data["frame_rate"] == 30


def test_the_frame_rate_of_the_config_comes_first(desk):
    result = desk.result(sequences=("s",) * 6, frame_rate=30.0)
    assert desk.view(result, frame_rate=12.5).data["frame_rate"] == 12.5


def test_a_frame_rate_that_nobody_states_is_said_to_be_unknown(desk):
    page = desk.view(desk.result(sequences=("s",) * 6)).data
    assert page["frame_rate"] == 24
    assert page["rate_known"] is False


@pytest.mark.parametrize(
    ("n", "fields", "is_video"),
    [
        (6, {}, False),
        (6, {"frame_rate": 30.0}, True),
        (1, {"frame_rate": 30.0}, False),
        (6, {"sequences": ("s",) * 6}, True),
    ],
)
def test_images_of_a_sequence_or_of_a_rate_are_a_video(desk, n, fields, is_video):
    assert desk.scene(desk.result(n=n, **fields))["video"] == is_video
