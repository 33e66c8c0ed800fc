"""The verdict of `make bench`: what makes it fail, and where its floors are kept."""

import pytest

from benchmarks import comparing
from benchmarks.comparing import Comparison, Table, Turn, compare, compared


def faults(found: Comparison, **options) -> list[str]:
    table = Table({"case": 4.0})
    table.add(compared("case", found, **options))
    return table.faults


@pytest.mark.parametrize(("ratio", "told"), [(4.1, 0), (3.9, 1)])
def test_a_ratio_under_its_floor_is_a_fault(ratio, told):
    assert len(faults(Comparison(ratio, ratio, 1.0, 1.0, 1.0))) == told


def test_an_image_without_certificate_is_a_fault():
    (told,) = faults(Comparison(9.0, 9.0, 1.0, 0.999, 0.999), certified=True)
    assert "99.90%" in told


def test_images_that_ended_well_before_must_do_so_now():
    (told,) = faults(Comparison(9.0, 9.0, 1.0, 0.9, 0.8))
    assert "80.00%" in told


def test_both_sides_must_have_solved_the_same():
    (told,) = faults(Comparison(9.0, 9.0, 1.0, 1.0, 1.0, change=0.1), certified=True)
    assert "sum" in told


def test_the_ratio_is_the_median_of_neighbouring_turns():
    before = iter([Turn(6.0), Turn(8.0), Turn(90.0)])
    now = iter([Turn(2.0), Turn(2.0), Turn(9.0)])
    found = compare(lambda: next(before), lambda: next(now), 3)
    assert (found.ratio, found.before, found.now) == (4.0, 8.0, 2.0)


def test_floors_are_a_fifth_under_and_others_stay(tmp_path, monkeypatch):
    monkeypatch.setattr(comparing, "FLOORS", tmp_path / "floors.toml")
    comparing.write_floors("v1", "x86_64_v4", {"a case, 30% hidden": 10.0, "other": 2.0})
    comparing.write_floors("v1", "x86_64_v3", {"other": 1.5})
    comparing.write_floors("v1", "x86_64_v4", {"other": 3.0})
    assert comparing.read_floors() == {
        "v1": {
            "x86_64_v3": {"other": 1.2},
            "x86_64_v4": {"a case, 30% hidden": 8.0, "other": 2.4},
        }
    }
