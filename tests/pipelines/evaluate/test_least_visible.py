"""Images that show too few landmarks are left out, and said to be."""

import numpy as np
import pytest

from shapefit.errors import InputError

SEEN = (5, 4, 3, 5, 2, 4, 5)
"""Observed landmarks of each image; shapes are whole all the same."""


@pytest.fixture
def partly_seen(desk, results):
    observed = results.columns["landmarks"].copy()
    for image, seen in zip(observed, SEEN, strict=True):
        image[seen:] = np.nan
    seen = results.replaced(further={**results.further, "landmarks": observed})
    desk.write("convex.h5", seen)
    return seen


@pytest.mark.parametrize(("least", "judged"), [(0, 7), (2, 7), (3, 6), (4, 5), (5, 3)])
def test_images_with_at_least_so_many_are_judged(desk, partly_seen, least, judged):
    outcome, last = desk.run(least_visible=least)
    kept = [i for i, seen in enumerate(SEEN) if seen >= least]
    rows = [row["item"] for row in desk.rows("per_image.csv") if row["metric"] == "rotation"]
    assert rows == [f"item{i}" for i in kept]
    assert (outcome.done, outcome.failures) == (judged, ())
    out = f"{7 - judged} of 7 images left out: fewer than {least} observed landmarks"
    assert (out in " ".join(outcome.warnings)) == (judged < 7)
    assert (out in last.note) == (judged < 7)


def test_an_image_that_could_not_be_lifted_counts_by_what_it_shows(desk, partly_seen):
    shapes = partly_seen.shapes.copy()
    shapes[[0, 2]] = np.nan  # five landmarks, on one line perhaps, and three
    desk.write("convex.h5", partly_seen.replaced(shapes=shapes))
    outcome, _ = desk.run(least_visible=4)
    assert [failure.item for failure in outcome.failures] == ["item0"]
    assert outcome.done == 5


def test_results_without_observed_landmarks_are_an_error(desk, results):
    desk.write("table.csv", results)
    with pytest.raises(InputError, match=r"table\.csv: has no dataset 'landmarks'.*least_visible"):
        desk.run(results=[desk.folder / "table.csv"], least_visible=1)


def test_no_image_left_is_an_error(desk, partly_seen):
    with pytest.raises(InputError, match=r"none of its 7 images has 6 .*`least_visible` to 5 or"):
        desk.run(least_visible=6)
    assert not desk.config.output.exists()
