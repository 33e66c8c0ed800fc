"""Images are read in whole sequences, none of which is divided."""

from itertools import pairwise

import numpy as np
import pytest

from shapefit.io import LandmarkSet
from shapefit.pipelines.fit.sequences import whole_sequences


def images(names):
    n = len(names)
    return LandmarkSet(
        landmarks=np.arange(6.0 * n).reshape(n, 2, 3),
        landmark_names=("a", "b", "c"),
        items=tuple(f"image{i}" for i in range(n)),
        sequences=tuple(names),
    )


@pytest.mark.parametrize("size", [1, 2, 3, 5, 100])
@pytest.mark.parametrize("names", ["aaabbbbcd", "a", "aaaaaaa", "abcdefgh", "aabbcc", ""])
def test_no_run_is_divided_and_nothing_lost(names, size):
    whole = images(names)
    chunks = [whole.take(slice(at, at + size)) for at in range(0, max(len(names), 1), size)]
    parts = list(whole_sequences(chunks))
    assert [item for part in parts for item in part.items] == list(whole.items)
    np.testing.assert_array_equal(np.concatenate([p.landmarks for p in parts]), whole.landmarks)
    for before, after in pairwise(parts):
        assert before.sequences[-1] != after.sequences[0]
    assert all(len(part) < size + 8 for part in parts)


def test_ended_sequences_are_given_out_before_the_stream_ends():
    def stream():
        yield images("aab")
        yield images("bbc")
        raise AssertionError("read too far")

    assert next(whole_sequences(stream())).sequences == ("a", "a")
