"""Results with their proofs, written in chunks and read in others."""

import h5py
import numpy as np
import pytest

from shapefit.errors import InputError
from shapefit.io import read_results
from shapefit.io.source import open_results
from tests.io.files import save

COUNTS = np.array([2, 0, 1, 3, 0])


@pytest.fixture
def proved(results, rng):
    """Results with a dual and six transforms in all."""
    return results.replaced(
        dual=rng.normal(size=(5, 2, 4)),
        convex_translation=rng.normal(size=(5, 2)),
        transform_count=COUNTS,
        transform_atom=np.array([4, 5, 6, 0, 1, 2]),
        active_transforms=rng.normal(size=(6, 2, 3)),
    )


@pytest.fixture
def path(tmp_path, proved):
    path = tmp_path / "result.h5"
    save(path, proved.take([0, 1]), proved.take([2]), proved.take([3, 4]))
    return path


@pytest.mark.parametrize("size", [1, 2, 3, 5, 9])
def test_chunks_hold_the_transforms_of_their_images(path, proved, size):
    with open_results([path], proofs=True) as results:
        chunks = list(results.batches(size))
        assert results.count == 5
        assert results.head.landmark_names == proved.landmark_names
        assert results.head.attributes["method"] == "convex"
    start = 0
    for chunk in chunks:
        part = proved.take(slice(start, start + len(chunk)))
        start += len(chunk)
        for name in ("dual", "convex_translation", "transform_count", "transform_atom",
                     "active_transforms", "shapes", "coefficients"):  # fmt: skip
            np.testing.assert_array_equal(getattr(chunk, name), getattr(part, name))
        assert (chunk.items, chunk.sequences) == (part.items, part.sequences)
    assert start == 5


def test_results_are_read_without_their_proofs(path, proved):
    found = read_results(path)
    assert found.dual is None
    assert found.transform_count is None
    assert found.active_transforms is None
    np.testing.assert_array_equal(found.shapes, proved.shapes)


@pytest.mark.parametrize(("count", "message"), [(-1, "is -1, not a number"), (9, "is 9, not a"),
                                                (1, "holds 6 active transforms, and"),
                                                (4, "holds 6 active transforms, and")])  # fmt: skip
def test_counts_that_do_not_fit_are_refused(path, count, message):
    with h5py.File(path, "r+") as file:
        file["transform_count"][3] = count
    with pytest.raises(InputError, match=message), open_results([path], proofs=True) as results:
        list(results.batches(2))
