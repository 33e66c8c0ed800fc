"""Which items a config key chooses, and which are subsample over all."""

import pytest

from shapefit.errors import InputError
from shapefit.pipelines.items import ChosenItems, MatchKeys, find_truth, subsample

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


@pytest.mark.parametrize(
    ("wanted", "count", "places"),
    [(0, 9, ()), (1, 9, (4,)), (3, 9, (1, 4, 7)), (9, 3, (0, 1, 2)), (4, 0, ())],
)
def test_spread(wanted, count, places):
    assert subsample(wanted, count) == places


def rows(match, own, truth):
    return find_truth("r.h5", match, own, truth).tolist()


class TestTruthByFrame:
    ANNA = MatchKeys(("a", "b", "c"), ("anna",) * 3, [0, 1, 2])

    @pytest.mark.parametrize(
        ("own", "expected"),
        [
            (MatchKeys(("x", "y"), ("anna",) * 2, [2, 1]), [2, 1]),
            (MatchKeys(("x", "y"), ("cam1/anna", "cam2/anna"), [1, 1]), [1, 1]),
            (MatchKeys(("x", "y"), ("berta", "berta"), [0, 7]), [0, -1]),
            (MatchKeys(("x", "y")), [0, 1]),
            (MatchKeys(("x", "y"), ("cam1", "cam2")), [0, 0]),
        ],
    )
    def test_frames_are_of_the_same_sequence_one_that_ends_so_or_the_only_one(
        self, own, expected
    ):
        assert rows("frame", own, self.ANNA) == expected

    def test_times_that_are_stated_come_before_frames(self):
        """Frames count from the first of a file, times need not."""
        truth = MatchKeys("abcd", None, [0, 1, 2, 3], 25.0, [0.0, 0.04, 0.08, 0.12])
        later = MatchKeys("xy", None, [0, 1], 25.0, [0.08, 0.1201])
        assert rows("frame", later, truth) == [2, 3]

    def test_frames_of_a_known_rate_have_times(self):
        truth = MatchKeys("ab", None, [0, 1], 25.0, [0.08, 0.12])
        own = MatchKeys("wxyz", None, [0, 1, 2, 3], 25.0)
        assert rows("frame", own, truth) == [-1, -1, 0, 1]

    def test_clocks_that_have_no_time_in_common_are_left_out(self):
        truth = MatchKeys("ab", None, [0, 1], 25.0, [100.0, 100.04])
        own = MatchKeys("xy", None, [0, 1], 25.0, [0.0, 0.04])
        assert rows("frame", own, truth) == [0, 1]

    def test_times_where_rates_differ(self):
        own = MatchKeys(("x", "y", "z"), None, [0, 1, 2], 60.0)
        assert rows("frame", own, MatchKeys("abcde", None, None, 120.0)) == [0, 2, 4]
        assert rows("frame", own, MatchKeys("abcde", None, None, 30.0)) == [0, -1, 1]

    def test_a_frame_in_two_sequences_of_other_names_is_none(self):
        two = MatchKeys(("a", "b"), ("anna", "berta"), [0, 0])
        assert rows("frame", MatchKeys(("x",), ("berta",)), two) == [1]
        told = r"name the sequences alike \('carla' here, 'anna' there\)"
        with pytest.raises(InputError, match=told):
            rows("frame", MatchKeys(("x",), ("carla",)), two)

    def test_by_item_what_fails_names_the_alternative(self):
        assert rows("item", MatchKeys(("b", "x")), self.ANNA) == [1, -1]
        with pytest.raises(InputError, match="set `match`: to `frame` where both"):
            rows("item", MatchKeys(("x",)), self.ANNA)
