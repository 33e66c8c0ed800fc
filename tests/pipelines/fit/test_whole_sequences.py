"""Batches are divided between sequences, long sequences into clips."""

from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from shapefit.errors import InputError
from shapefit.lifting.sequences import clips
from shapefit.pipelines.fit.whole_sequences import whole_sequences
from shapefit.records import Landmarks


@pytest.mark.parametrize(("one", "other"), [(7, 7), (9, 4)])
def test_two_images_of_one_frame_are_refused(one, other):
    images = frames_of("aa").replaced(frames=np.array([one, other]))
    fault = f"is of the frame {one}, and then 'image1' of {other}"
    with pytest.raises(InputError, match=fault):
        list(whole_sequences([images]))


@pytest.mark.parametrize(("one", "other"), [(7, 7), (9, 4)])
def test_two_sequences_may_have_images_of_one_frame(one, other):
    images = frames_of("ab").replaced(frames=np.array([one, other]))
    parts = list(whole_sequences([images]))
    assert sum(map(len, parts)) == 2


SEQUENCES = ["aaabbbbcd", "a", "aaaaaaa", "abcdefgh", "aabbcc", ""]


def frames_of(names):
    """Return images of sequences that are so named, a letter an image."""
    count = len(names)
    return Landmarks(
        np.arange(6.0 * count).reshape(count, 3, 2),
        landmark_names=("a", "b", "c"),
        items=tuple(f"image{i}" for i in range(count)),
        sequences=tuple(names),
    )


def items_of(parts):
    return tuple(item for part in parts for item in part.items)


@pytest.mark.parametrize("size", [1, 2, 3, 5, 100])
@pytest.mark.parametrize("names", SEQUENCES)
def test_no_run_is_divided_and_nothing_lost(names, size):
    whole = frames_of(names)
    starts = range(0, max(len(names), 1), size)
    batches = [whole.take(slice(start, start + size)) for start in starts]
    parts = list(whole_sequences(batches))
    landmarks = np.concatenate([part.landmarks for part in parts])
    assert items_of(parts) == whole.items
    assert_array_equal(landmarks, whole.landmarks)
    for before, after in pairwise(parts):
        assert before.sequences[-1] != after.sequences[0]
    for part in parts:
        assert len(part) < size + 8


def test_ended_sequences_are_given_out_before_the_stream_ends():
    def stream():
        yield frames_of("aab")
        yield frames_of("bbc")
        raise AssertionError("read too far")

    first = next(whole_sequences(stream()))
    assert first.sequences == ("a", "a")


def test_an_image_without_a_sequence_is_by_itself():
    names = ["", "", "a", "a", "", "b", ""]
    sizes = [piece.stop - piece.start for piece in clips.split_into_clips(names)]
    assert sizes == [1, 1, 2, 1, 1, 1]
    images = frames_of(names)
    assert items_of(whole_sequences([images])) == images.items


LONG_SEQUENCES = ["", "aab", "aaaaaaaaab", "aaabbbbbbbbbcc", "abcdefgh"]


@pytest.mark.parametrize("names", LONG_SEQUENCES)
def test_long_sequences_are_lifted_in_the_pieces_that_are_refined(names, monkeypatch):
    for module in ("lifting.sequences.clips", "pipelines.fit.whole_sequences"):
        monkeypatch.setattr(f"shapefit.{module}.MAX_CLIP_FRAMES", 4)
    whole = frames_of(names)
    pieces = list(whole_sequences([whole]))
    sizes = [len(piece) for piece in pieces]
    ends_of_clips = {clip.stop for clip in clips.split_into_clips(tuple(names))}
    assert items_of(pieces) == whole.items
    assert set(np.cumsum(sizes)) <= ends_of_clips | {0}
    assert max(sizes) <= 4
    for size, next_size in pairwise(sizes[:-1]):
        assert size + next_size > 4
