"""Sums over sequences and groups, computed by hand."""

import numpy as np
import pytest

from shapefit.evaluation.report import Run, Solving, sum_up_runs
from shapefit.evaluation.summaries import ImageErrors, group_sequences, summarise

NAN = float("nan")


def errors(**sequences):
    names = tuple(name for name, values in sequences.items() for _ in values)
    values = np.array([v for values in sequences.values() for v in values], dtype=float)
    items = tuple(f"item{i}" for i in range(len(values)))
    return ImageErrors("convex", "similarity", "m", items, names, values)


def test_group_mean_is_the_mean_of_sequence_means_not_of_images():
    whole, long, short = summarise(errors(a=[1, 1, 1, 1], b=[3]), {"all": ("a", "b")})
    assert (long.mean, short.mean) == (1, 3)
    assert whole.mean == 2  # over images it would be 1.4
    assert (whole.images, whole.sequence, whole.group) == (5, None, "all")


def test_median_and_p90_of_a_group_are_means_over_its_sequences():
    a = list(range(11))  # median 5, 90th percentile 9
    b = [20, 20, 50]  # median 20, 90th percentile 20 + 0.8 * 30
    whole, first, second = summarise(errors(a=a, b=b), {"all": ("a", "b")})
    assert (first.median, first.p90) == (5, 9)
    assert (second.median, second.p90) == pytest.approx((20, 44))
    assert (whole.median, whole.p90) == pytest.approx((12.5, 26.5))


def test_failed_images_are_counted_and_left_out_of_the_mean():
    whole, a, b = summarise(errors(a=[1, NAN, 3], b=[NAN, NAN]), {"all": ("a", "b")})
    assert (a.images, a.failed, a.mean) == (2, 1, 2)
    assert (b.images, b.failed) == (0, 2)
    assert np.isnan([b.mean, b.median, b.p90]).all()
    assert (whole.images, whole.failed, whole.mean) == (2, 3, 2)


def test_images_of_a_sequence_need_not_stand_together():
    mixed = ImageErrors("m", "x", "u", tuple("pqrs"), tuple("abab"), np.array([1.0, 10, 3, 30]))
    _, a, b = summarise(mixed, {"all": ("a", "b")})
    assert (a.sequence, a.mean, b.sequence, b.mean) == ("a", 2, "b", 20)


def test_groups_take_their_sequences_by_glob_in_order_of_appearance():
    names = ["14_02", "13_01", "14_01", "13_01"]
    grouping, warnings = group_sequences(
        {"thirteen": "13_*", "fourteen": "14_*", "none": "15_*"}, names
    )
    assert grouping == {"thirteen": ("13_01",), "fourteen": ("14_02", "14_01"), "none": ()}
    assert warnings == ["group none: no sequence matches '15_*'"]


def test_groups_and_sequences_without_an_image_are_left_out():
    rows = summarise(errors(a=[1]), {"one": ("a", "elsewhere"), "none": ("elsewhere",)})
    assert [(row.group, row.sequence) for row in rows] == [("one", None), ("one", "a")]


def test_each_image_weighs_the_same():
    found = sum_up_runs([Run(5, np.array([1.0, 2.0, 3.0, np.nan, 10.0]), 3, 0.75)])
    assert found.mean_objective == pytest.approx((1 + 2 + 3 + 10) / 4)
    assert found.milliseconds == pytest.approx(750 / 5)
    assert found.solved == pytest.approx(3 / 5)


def test_what_is_not_told_is_unknown():
    assert sum_up_runs([Run(1)]) == Solving()
    assert sum_up_runs([Run(1, np.array([1.0]), 1, 0.5)]) == Solving(1.0, 500.0, 1.0)


def test_without_a_known_objective_there_is_no_mean():
    for objective in (np.nan, np.inf, 1e300):
        run = Run(1, np.array([objective]), 0, 0.5)
        assert sum_up_runs([run]) == Solving(None, 500.0, 0.0)
