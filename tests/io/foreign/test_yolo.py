"""Labels of YOLO without a data.yaml: the numbers of a line say what they are."""

import numpy as np
import pytest

TAILS = ("", " 0.9", " 0.9 7")
"""Nothing, a score, a score and a track."""

LAYOUTS = [(count, " 2", tail) for count in (4, 5, 17) for tail in TAILS]


@pytest.mark.parametrize(("count", "mark", "tail"), [*LAYOUTS, (4, "", ""), (5, "", "")])
def test_the_layout_of_lines_is_found(rng, tmp_path, read, count, mark, tail):
    points = np.round(rng.uniform(0.1, 0.9, (3, count, 2)), 3)
    for frame, person in enumerate(points):
        cells = " ".join(f"{x} {y}{mark}" for x, y in person.tolist())
        (tmp_path / f"{frame}.txt").write_text(f"0 0.5 0.5 0.2 0.4 {cells}{tail}\n")
    found = read(tmp_path)
    assert np.allclose(found.landmarks.swapaxes(1, 2), points)
    assert (found.landmark_names[0] == "nose") == (count == 17)
