"""Images on which the checks are tried, and those of several inputs as one."""

import numpy as np
import pytest

from shapefit.io import LandmarkSet
from shapefit.pipelines.fit.checks import MOST, choose_sample
from shapefit.pipelines.fit.prepare import _joined


@pytest.mark.parametrize(("rate", "apart"), [(None, 12), (50.0, 25), (0.5, 1)])
def test_pairs_are_of_one_sequence_and_a_step_apart(rng, rate, apart):
    n = 3 * MOST
    images = LandmarkSet(
        rng.random((n, 2, 4)),
        tuple("abcd"),
        tuple(map(str, range(n))),
        sequences=tuple("walk" if number < MOST else "run" for number in range(n)),
        frame_rate=rate,
    )
    sample = choose_sample(images)
    first, later = (np.array(sample.images.items, int)[sample.pairs[:, at]] for at in (0, 1))
    assert (later - first == apart).all()
    assert ((first < MOST) == (later < MOST)).all()
    assert len(first) >= MOST // 3
    assert len(choose_sample(images.replaced(sequences=None)).pairs) == 0


@pytest.mark.parametrize("focal", [900.0, 950.0])
def test_a_dataset_of_the_file_stays_one_where_the_files_agree(rng, focal):
    def images(name, value):
        plain = LandmarkSet(
            rng.random((3, 2, 4)), tuple("abcd"), tuple(f"{name}{n}" for n in "123")
        )
        return plain.with_columns(whole={"focal": np.array(value)})

    joined = _joined([images("p", 900.0), images("q", focal)], ["focal"])
    assert joined.whole.keys() == ({"focal"} if focal == 900 else set())
    assert np.unique(joined.columns["focal"]).tolist() == sorted({900.0, focal})
