"""Landmarks from a pipe that stays open: what each item has beside its landmarks."""

import io
import sys

import pytest

from shapefit.io.live import LiveLandmarks
from shapefit.io.options import InputOptions


@pytest.fixture
def read(monkeypatch):
    """Return what reads items of landmarks a and b from standard input."""

    def read(*lines):
        text = "".join(f"{line}\n" for line in lines)
        stream = io.TextIOWrapper(io.BytesIO(text.encode()))
        monkeypatch.setattr(sys, "stdin", stream)
        live = LiveLandmarks(InputOptions(), ("a", "b"))
        return list(live.items())

    return read


WITH_FRAMES = "item,landmark,x,y,sequence,frame"


def test_frames_of_images_of_no_sequence_are_none(read):
    rows = ["i,a,1,2,,", "i,b,3,4,,", "j,a,5,6,,", "j,b,7,8,,"]
    first, second = read(WITH_FRAMES, *rows)
    assert first.frames is None
    assert second.frames is None
    assert second.landmarks.tolist() == [[[5, 6], [7, 8]]]


def test_each_item_has_its_frame(read):
    rows = ["i,a,1,2,v,7", "i,b,3,4,v,7", "j,a,5,6,v,0", "j,b,7,8,v,0"]
    first, second = read(WITH_FRAMES, *rows)
    assert first.frames.tolist() == [7]
    assert second.frames.tolist() == [0]


def test_a_frame_that_the_first_item_lacks_is_refused(read, problems):
    rows = ["i,a,1,2,,", "i,b,3,4,,", "j,a,5,6,v,7", "j,b,7,8,v,7"]
    (line,) = problems(read, WITH_FRAMES, *rows)
    fault = "item 'j' has a frame, and the first item none"
    fix = "give all items a frame, or leave out the column"
    assert line == f"standard input: {fault}; {fix}"


def test_each_item_has_its_sequence_and_time(read):
    header = "item,landmark,x,y,sequence,time"
    rows = ["i,a,1,2,v,0.5", "i,b,3,4,v,0.5", "j,a,5,6,w,0.25", "j,b,7,8,w,0.25"]
    first, second = read(header, *rows)
    assert first.sequences == ("v",)
    assert second.sequences == ("w",)
    assert first.times.tolist() == [0.5]
    assert second.times.tolist() == [0.25]
