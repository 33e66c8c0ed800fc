"""Parts whose item names lie apart share none of them."""

from __future__ import annotations

from itertools import combinations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from shapefit.pipelines.parts.equal_items import Span, overlapping

names = st.text("ab01/", min_size=1, max_size=4)


@given(st.lists(st.lists(names, min_size=1, max_size=5), max_size=8))
def test_no_pair_with_a_common_name_is_left_out(parts):
    groups = overlapping({key: Span.of(items) for key, items in enumerate(parts)})
    together = {frozenset(pair) for group in groups for pair in combinations(group, 2)}
    for a, b in combinations(range(len(parts)), 2):
        if set(parts[a]) & set(parts[b]):
            assert frozenset((a, b)) in together


@pytest.mark.parametrize(
    "form", ["image{:06}", "image{}", "{}.jpg"], ids=["fixed width", "numbers", "files"]
)
def test_numbered_images_are_apart(form):
    parts = {
        start: [form.format(n) for n in range(start, start + 250)] for start in range(0, 5000, 250)
    }
    assert overlapping({key: Span.of(items) for key, items in parts.items()}) == []


def test_folders_are_apart():
    cameras = {key: [f"{key}/{n}" for n in range(0, 2000, 7)] for key in ("a", "bee", "c")}
    assert overlapping({key: Span.of(items) for key, items in cameras.items()}) == []


def test_only_those_that_may_share_a_name_are_together():
    parts = {1: "ad", 2: "be", 3: "x", 4: "yz", 5: "z"}
    groups = overlapping({key: Span.of(items) for key, items in parts.items()})
    assert sorted(map(sorted, groups)) == [[1, 2], [4, 5]]


@given(st.lists(names, min_size=1), st.lists(names, min_size=1))
def test_a_span_of_two_is_that_of_all(one, two):
    assert Span.of(one) | Span.of(two) == Span.of([*one, *two])
