"""Problems of an input are listed, at most ten of them."""

import numpy as np
import pytest

from shapefit.errors import InputError
from shapefit.io.checks import LIMIT, check_mesh, input_problems


@pytest.mark.parametrize("count", [1, LIMIT, LIMIT + 1, LIMIT + 2])
def test_all_problems_are_told_or_counted(count):
    told = [f"line {number}" for number in range(count)]
    left = count - LIMIT
    expected = told[:LIMIT] + [f"... and {left} more"] * (left > 0)
    assert str(input_problems(told)).split("\n") == expected
    assert str(input_problems(told[:LIMIT], count)).split("\n") == expected


def test_a_vertex_that_is_no_number_is_named_by_its_row():
    vertices = np.zeros((3, 3, 4))
    vertices[2, :, 1] = np.nan
    with pytest.raises(InputError, match=r"mesh_vertices\[2\]: vertex 1"):
        check_mesh(lambda name, row: f"{name}[{row}]", {"mesh_vertices": vertices}, 5)
