"""What a dictionary says of its training shapes must be numbers that a fit can use."""

from pathlib import Path

import h5py
import numpy as np
import pytest

import shapefit
from shapefit.errors import InputError
from shapefit.io import read_dictionary, write_dictionary

PEOPLE = Path(shapefit.__file__).parent / "data" / "people.h5"


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("acceleration", np.nan),
        ("acceleration", -0.1),
        ("bone_tolerance", -0.1),
        ("edge_length", np.inf),
        ("p_value_table", np.nan),
        ("p_value_table", -1.0),
    ],
)
def test_numbers_of_no_use_are_refused(tmp_path: Path, name: str, value: float):
    path = tmp_path / "dictionary.h5"
    write_dictionary(path, read_dictionary(PEOPLE))
    with h5py.File(path, "r+") as file:
        file[name][0] = value
    with pytest.raises(InputError, match=f"{name}.*holds .*make the dictionary again"):
        read_dictionary(path)
