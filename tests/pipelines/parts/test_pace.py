"""The line on how far the parts are."""

from __future__ import annotations

import pytest

from shapefit.pipelines.parts.run import tell_pace


@pytest.mark.parametrize(
    ("numbers", "line"),
    [
        ((0, 1, 0, 0, 0, 0.0), "0 of 1 part done"),
        ((12, 40, 1, 20_000, 10, 10.0), "12 of 40 parts done, 1 failed, 2,000 images/s, 27 s left"),
        ((2, 40, 0, 20_000, 2, 60.0), "2 of 40 parts done, 333 images/s, 19 min left"),
        ((1, 1001, 0, 3600, 1, 36.0), "1 of 1001 parts done, 100 images/s, 10.0 h left"),
        ((9, 10, 1, 900, 9, 1.0), "9 of 10 parts done, 1 failed, 900 images/s"),
    ],
)
def test_tells(numbers, line):
    assert tell_pace(*numbers) == line
