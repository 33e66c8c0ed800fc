"""What stops an evaluation, and what it leaves behind then."""

import errno

import pytest

from shapefit.errors import InputError
from shapefit.io import atomic


def test_an_item_in_two_files_of_one_method_is_an_error(desk, results):
    desk.write("again.h5", results.take([3]))
    files = {"convex": [desk.folder / "convex.h5", desk.folder / "again.h5"]}
    with pytest.raises(InputError, match=r"again.h5: has the item 'item3', which .*convex.h5"):
        desk.run(results=files)


@pytest.mark.parametrize(
    "fault", [OSError(errno.ENOSPC, "No space left on device"), OSError("No space left (os 28)")]
)
def test_a_full_disk_is_told_and_replaces_nothing(desk, monkeypatch, fault):
    desk.run()
    old = {path.name: path.read_bytes() for path in desk.config.output.iterdir()}

    def fill(write, path):
        raise fault

    monkeypatch.setattr(atomic, "write_and_sync", fill)
    with pytest.raises(InputError, match=r"report/report.csv: cannot be written: No space left"):
        desk.run(metrics=["similarity"])
    assert {path.name: path.read_bytes() for path in desk.config.output.iterdir()} == old


class TestInputErrors:
    def test_groups_match_no_sequence(self, desk):
        with pytest.raises(InputError, match=r"groups: no sequence matches.*13_01, 13_02, 14_01"):
            desk.run(groups={"Subject 15": "15_*"})
        assert not desk.config.output.exists()

    def test_results_of_other_items(self, desk, results):
        desk.write("convex.h5", results.replaced(items=tuple("abcdefg")))
        with pytest.raises(InputError, match="none of its 7 images is in the truth"):
            desk.run()
        assert not desk.config.output.exists()

    def test_output_is_a_file(self, desk):
        (desk.folder / "report").write_text("kept")
        with pytest.raises(InputError, match="report: it is not a folder"):
            desk.begin()
        assert (desk.folder / "report").read_text() == "kept"


@pytest.mark.parametrize("seconds", [float("nan"), float("inf"), -1.0, "soon"])
def test_a_time_that_is_none_is_unknown(desk, results, seconds):
    desk.write("convex.h5", results.replaced(attributes={"solve_seconds": seconds}))
    desk.run()
    assert "solving alone" not in (desk.config.output / "report.md").read_text()


def test_what_overflows_is_a_failure_of_the_image(desk, results):
    fitted = results.landmarks_fitted.copy()
    fitted[2] = 1e300
    desk.write("convex.h5", results.replaced(landmarks_fitted=fitted))
    outcomes = desk.run(metrics=["similarity", "reprojection"])
    (failure,) = [failure for outcome in outcomes for failure in outcome.failures]
    assert failure.item == "item2"
    assert "reprojection" in failure.reason
