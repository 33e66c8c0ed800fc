"""`frames` and `every` of a fit: which images are lifted, with their own numbers."""

import json
import shutil

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from shapefit.config import load_config
from shapefit.errors import InputError
from shapefit.io import open_landmarks, read_results
from shapefit.io.formats import record_writer
from shapefit.io.layout import LANDMARKS
from shapefit.io.options import InputOptions
from shapefit.records import Landmarks
from tests.cli.conftest import run_in

NAMES = tuple("abcdef")
COUNT = 40


def video(n=COUNT, people=("x", "y"), *, frames=True):
    """Return n frames of each person, one after the other, at 25 Hz."""
    rng = np.random.default_rng(3)
    number = np.tile(np.arange(n), len(people))
    return Landmarks(
        rng.normal(size=(n * len(people), len(NAMES), 2)),
        landmark_names=NAMES,
        items=tuple(f"{who}/{frame:03}" for who in people for frame in range(n)),
        sequences=tuple(who for who in people for _ in range(n)),
        frames=number if frames else None,
        frame_rate=25.0,
    )


def read(path, rows=None, **options):
    with open_landmarks([path], InputOptions(**options), rows) as source:
        return source.whole(), source.left_out


@pytest.mark.parametrize("ending", ["h5", "csv"])
@pytest.mark.parametrize("frames", [True, False])
def test_every_format_gives_the_same_frames(tmp_path, ending, frames):
    path = tmp_path / f"video.{ending}"
    with record_writer(path, LANDMARKS) as writer:
        writer.append(video(frames=frames))
    whole, none = read(path)
    assert none == 0
    wanted = [*range(10, 31, 5)]
    some, left_out = read(path, frames=(10, 31), every=5)
    assert some.frames.tolist() == wanted * 2
    rows = [row + start for start in (0, COUNT) for row in wanted]
    assert some.items == tuple(whole.items[row] for row in rows)
    assert_array_equal(some.points, whole.points[rows])
    assert left_out == 2 * COUNT - len(rows)


def test_every_third_frame_begins_with_the_first(tmp_path):
    path = tmp_path / "video.h5"
    with record_writer(path, LANDMARKS) as writer:
        writer.append(video(n=8))
    some, _ = read(path, every=3)
    assert some.frames.tolist() == [0, 3, 6] * 2


def test_a_range_of_which_a_video_has_nothing_is_empty(tmp_path):
    path = tmp_path / "video.h5"
    with record_writer(path, LANDMARKS) as writer:
        writer.append(video())
    none, left_out = read(path, frames=(COUNT, None))
    assert none.items == ()
    assert left_out == 2 * COUNT


def test_rows_are_those_of_the_frames_that_stay(tmp_path):
    path = tmp_path / "video.h5"
    with record_writer(path, LANDMARKS) as writer:
        writer.append(video())
    every_third, _ = read(path, every=3)
    parts = [read(path, slice(a, a + 7), every=3) for a in range(0, 28, 7)]
    assert sum((part.items for part, _ in parts), ()) == every_third.items
    assert sum(left for _, left in parts) == 2 * COUNT - len(every_third)


def test_single_images_are_counted_in_the_file(tmp_path):
    path = tmp_path / "images.csv"
    images = video(people=("x",)).replaced(sequences=None, frames=None)
    with record_writer(path, LANDMARKS) as writer:
        writer.append(images)
    some, _ = read(path, frames=(5, None), every=10)
    assert some.items == ("x/005", "x/015", "x/025", "x/035")
    assert some.frames is None


@pytest.mark.parametrize("text", ["5", "a:b", "9:4", "4:4", "-3:4", ":0", "1:2:3"])
def test_a_text_that_is_no_range_is_refused(tmp_path, text):
    (tmp_path / "a.csv").touch()
    with pytest.raises(InputError, match=r"frames: .*give"):
        load_config("fit", None, [], {"landmarks": tmp_path / "a.csv", "frames": text})


def test_a_fit_says_what_it_leaves_out_and_is_verified(tmp_path, project):
    shutil.copytree(project / "sample_data/openpose", tmp_path / "cam")
    options = "--keypoints body_25 --method convex --frames 4:20 --every 2 --json"
    done = run_in(tmp_path, "fit", "cam", "-o", "r.h5", *options.split())
    told = json.loads(done.stdout)
    assert told["numbers"]["images"] == 16
    assert "56 images left out by `frames: 4:20` and `every: 2`" in told["warnings"]
    result = read_results(tmp_path / "r.h5")
    assert sorted(result.frames.tolist()) == sorted([*range(4, 20, 2)] * 2)
    checked = run_in(
        tmp_path, *["verify", "r.h5", "-d", "people", "--landmarks", "cam"]
    )
    assert checked.returncode == 0, checked.stdout
