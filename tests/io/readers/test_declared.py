"""JSON checked by declared kinds: what is wrong is an error of the format."""

from typing import Any

import pytest

from shapefit.io.readers.declared import check_json
from shapefit.io.readers.poses import FormatError


@pytest.mark.parametrize(
    ("kind", "content"),
    [
        (list[tuple[float, float]], [[1.0]]),
        (list[tuple[float, float]], [[1.0, 2.0, 3.0]]),
        (dict[str, tuple[int, int]], {"a": [1]}),
        (tuple[float, float], []),
    ],
    ids=str,
)
def test_lists_of_another_length_are_errors_of_the_format(kind: Any, content: Any):
    with pytest.raises(FormatError):
        check_json(kind, content)
