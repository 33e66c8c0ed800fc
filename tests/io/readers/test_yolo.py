"""Labels of YOLO without a data.yaml: the numbers of a line say what they are."""

import numpy as np
import pytest

from shapefit.io import open_landmarks

TAILS = ("", " 0.9", " 0.9 7")
"""Nothing, a score, a score and a track."""

LAYOUTS = [(count, " 2", tail) for count in (4, 5, 17) for tail in TAILS]


@pytest.mark.parametrize(("count", "mark", "tail"), LAYOUTS)
def test_the_layout_of_lines_is_found(rng, tmp_path, read, count, mark, tail):
    points = np.round(rng.uniform(0.1, 0.9, (3, count, 2)), 3)
    for frame, person in enumerate(points):
        cells = " ".join(f"{x} {y}{mark}" for x, y in person.tolist())
        (tmp_path / f"{frame}.txt").write_text(f"0 0.5 0.5 0.2 0.4 {cells}{tail}\n")
    found = read(tmp_path)
    assert np.allclose(found.landmarks.swapaxes(1, 2), points)
    assert (found.landmark_names[0] == "nose") == (count == 17)


def test_files_in_any_order_are_read_by_their_names(rng, tmp_path, read):
    paths = [tmp_path / f"a_{frame}.txt" for frame in (1, 2, 10)]
    for path in paths:
        cells = " ".join(f"{x:.3f} {y:.3f} 2" for x, y in rng.uniform(0.1, 0.9, (4, 2)))
        path.write_text(f"0 0.5 0.5 0.2 0.4 {cells}\n")
    with open_landmarks(paths) as first, open_landmarks(paths[::-1]) as last:
        in_order, reversed_order = first.whole(), last.whole()
    assert [item.split("/")[1] for item in in_order.items] == ["1", "2", "10"]
    assert in_order.items == reversed_order.items
    np.testing.assert_array_equal(in_order.landmarks, reversed_order.landmarks)
