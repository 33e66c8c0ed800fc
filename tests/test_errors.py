"""Numbers with their nouns."""

from shapefit.errors import counted


def test_one_is_not_many():
    assert [counted(n, "atom") for n in (0, 1, 2)] == ["0 atoms", "1 atom", "2 atoms"]
