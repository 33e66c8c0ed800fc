"""Which items a config key chooses, and which are spread over all."""

import pytest

from shapefit.pipelines.items import ChosenItems, spread

ITEMS = ("a1", "a[1]", "a2", "b/1", "b/2", "A1")


@pytest.mark.parametrize(
    ("patterns", "expected"),
    [
        ((), ()),
        (("a2", "b/1"), ("a2", "b/1")),
        (("*",), ITEMS),
        (("b*", "a?"), ("a1", "a2", "b/1", "b/2")),
        (("a[1]",), ("a1", "a[1]")),
        (("a[[]1]",), ("a[1]",)),
        (("a[12]",), ("a1", "a2")),
    ],
)
def test_items_are_chosen_by_their_names_and_by_globs(patterns, expected):
    chosen = ChosenItems("key", patterns)
    assert tuple(item for item in ITEMS if item in chosen) == expected
    assert chosen.warnings == ()


def test_what_chose_nothing_is_named():
    chosen = ChosenItems("export.items", ("a2", "c*", "a[3]", "b/3"))
    assert [item for item in ITEMS if item in chosen] == ["a2"]
    assert chosen.warnings == tuple(
        f"export.items: no item has this name or matches '{pattern}'"
        for pattern in ("c*", "a[3]", "b/3")
    )


@pytest.mark.parametrize(
    ("wanted", "count", "places"),
    [(0, 9, ()), (1, 9, (4,)), (3, 9, (1, 4, 7)), (9, 3, (0, 1, 2)), (4, 0, ())],
)
def test_spread(wanted, count, places):
    assert spread(wanted, count) == places
