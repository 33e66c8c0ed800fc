"""Files that are too large to keep are read anew, in parts: memory stays flat."""

import numpy as np
import pytest

from benchmarks import tracker_files as made
from shapefit.io import open_landmarks
from shapefit.io.foreign import sources

READ = """
import resource, sys
from pathlib import Path
from shapefit.io import open_landmarks
from shapefit.io.foreign import sources

sources.HELD_BYTES = 1 << 20

def peak():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024

def read(name):
    with open_landmarks([Path(sys.argv[1]) / name]) as source:
        return sum(len(chunk) for chunk in source.chunks(2000))

short = read("short" + sys.argv[2])
before = peak()
long = read("long" + sys.argv[2])
print(short, long, peak() - before)
"""

SHORT, LONG, LANDMARKS = 6_000, 30_000, 100
"""Frames; the points and confidences of the long file take 72 MB."""


@pytest.mark.slow
@pytest.mark.parametrize("name", [".csv", ".h5", ".analysis.h5", ".slp"])
def test_memory_is_flat_in_the_number_of_frames(tmp_path, run_python, name):
    write = {
        ".csv": made.write_deeplabcut_csv,
        ".h5": made.write_deeplabcut_hdf5,
        ".analysis.h5": made.write_sleap_analysis,
        ".slp": made.write_slp,
    }[name]
    for stem, frames in (("short", SHORT), ("long", LONG)):
        points = np.random.default_rng(0).integers(1, 640, (frames, 1, LANDMARKS, 2)).astype(float)
        write(tmp_path / f"{stem}{name}", points, np.full((frames, 1, LANDMARKS), 0.5))
    done = run_python(READ, tmp_path, name)
    assert done.stderr == ""
    short, long, more = map(int, done.stdout.split())
    assert (short, long) == (SHORT, LONG)
    assert more < 20e6


@pytest.mark.parametrize("name", made.WRITERS)
def test_files_that_are_not_kept_give_the_same(tmp_path, monkeypatch, points, confidence, name):
    path = tmp_path / name
    made.WRITERS[name](path, points, confidence)
    with open_landmarks([path]) as source:
        (want,) = source.chunks(100)
    monkeypatch.setattr(sources, "HELD_BYTES", 0)
    with open_landmarks([path]) as source:
        parts = list(source.chunks(3))
    assert [item for part in parts for item in part.items] == list(want.items)
    got = np.concatenate([part.landmarks for part in parts])
    np.testing.assert_array_equal(got, want.landmarks)
    np.testing.assert_array_equal(
        np.concatenate([part.confidence for part in parts]), want.confidence
    )
