"""Names by their hashes."""

import numpy as np

from shapefit.io.names import NameIndex, hashed, repeated, repetitions


def test_names_are_found_at_their_rows(rng):
    names = [f"item {i}" for i in range(500)]
    index = NameIndex.of([names[:200], [], names[200:]])
    assert len(index) == 500
    wanted = rng.permutation(500)
    np.testing.assert_array_equal(index.find([names[i] for i in wanted]), wanted)
    np.testing.assert_array_equal(index.find(["nobody", names[3], ""]), [-1, 3, -1])
    np.testing.assert_array_equal(NameIndex.of([]).find(["nobody"]), [-1])


def test_what_is_there_twice(monkeypatch):
    lists = [lambda: [["a", "b"], ["c"]], lambda: [["d", "a", "c", "a"]]]
    expected = [("a", (0, 0), (0, 0), (1, 1)), ("c", (0, 2), (0, 2), (1, 2))]
    expected.append(("a", (0, 0), (1, 1), (1, 3)))
    assert list(repetitions(lists)) == expected
    monkeypatch.setattr("shapefit.io.names.hashed", lambda n: np.zeros(len(n), np.uint64))
    assert list(repetitions(lists)) == expected  # names of one hash are told apart
    assert list(repetitions([lambda: [["a", "b"]]])) == []
    assert len(repeated(hashed(["a", "b", "a", "a"]))) == 1
