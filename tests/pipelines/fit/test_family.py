"""Batches of a fit: as many images as take a second, in whole blocks of the solver."""

import numpy as np

from shapefit.core import IMAGES_PER_BLOCK
from shapefit.io import open_landmarks
from shapefit.io.options import AS_THEY_ARE
from shapefit.io.source import source_of_stream
from shapefit.pipelines.fit.family import Pace, read_blocks
from shapefit.records import Landmarks
from tests.io.files import save


def test_a_pace_follows_the_last_batch():
    pace = Pace.of(4096, threads=2)
    assert pace.images == 2 * IMAGES_PER_BLOCK
    for expected in (512, 2048, 4096, 4096):
        pace.follow(pace.images, 0.01)
        assert pace.images == expected
    pace.follow(4096, 0.5)
    assert pace.images == 4096
    for expected in (1024, 256, IMAGES_PER_BLOCK, IMAGES_PER_BLOCK):
        pace.follow(pace.images, 9.0)
        assert pace.images == expected


def test_batches_of_any_pace_end_with_a_block(rng):
    count = 5 * IMAGES_PER_BLOCK + 3
    items = tuple(map(str, range(count)))
    images = Landmarks(
        300 + rng.random((count, 4, 2)), landmark_names="abcd", items=items
    )
    source = source_of_stream(images, "images", AS_THEY_ARE)
    pace = Pace.of(4096, threads=1)
    sizes = []
    read = []
    for batch in read_blocks(source, pace):
        sizes.append(len(batch.images))
        read += batch.images.items
        pace.images = IMAGES_PER_BLOCK + 1  # as a pace may say
    assert sizes == [IMAGES_PER_BLOCK, *[2 * IMAGES_PER_BLOCK] * 2, 3]
    assert tuple(read) == items
    nobody = source_of_stream(images.take(np.arange(0)), "images", AS_THEY_ARE)
    assert [len(batch.images) for batch in read_blocks(nobody, pace)] == [0]


def test_small_files_are_lifted_together_and_a_block_is_never_cut(tmp_path, rng):
    counts = (1, 2, IMAGES_PER_BLOCK + 1, 1, 3 * IMAGES_PER_BLOCK)
    paths = []
    for number, count in enumerate(counts):
        items = tuple(map(str, range(count)))
        points = 300 + rng.random((count, 4, 2))
        paths.append(tmp_path / f"{number}.h5")
        save(paths[-1], Landmarks(points, landmark_names="abcd", items=items))
    pace = Pace.of(4096, threads=1)
    with open_landmarks(paths) as source:
        batches = [batch.group.tolist() for batch in read_blocks(source, pace)]
    assert batches == [
        [0, 1, 1, *[2] * IMAGES_PER_BLOCK],
        [2, 3, *[4] * IMAGES_PER_BLOCK],
        [4] * IMAGES_PER_BLOCK,
        [4] * IMAGES_PER_BLOCK,
    ]
