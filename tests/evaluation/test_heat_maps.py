"""What the heat maps show."""

import numpy as np

from shapefit.evaluation import plots
from shapefit.evaluation.experiment_plots import heat_maps

NAN = float("nan")
OURS = {(5, 1): 0.1, (5, 2): 0.0, (10, 1): 1.0, (10, 2): 0.55}
THEIRS = {(10, 1): 0.95}


def shown(axis):
    return np.ma.filled(axis.images[0].get_array(), NAN)


def test_rows_go_down_and_columns_across_in_rising_order():
    figure = heat_maps({"ours": dict(reversed(OURS.items()))}, "landmarks p", "atoms z")
    axis = figure.axes[0]
    np.testing.assert_array_equal(shown(axis), [[0.1, 0.0], [1.0, 0.55]])
    assert [text.get_text() for text in axis.get_yticklabels()] == ["5", "10"]
    assert [text.get_text() for text in axis.get_xticklabels()] == ["1", "2"]
    assert (axis.get_ylabel(), axis.get_xlabel()) == ("landmarks p", "atoms z")


def test_the_scale_goes_from_0_to_1_whatever_the_shares():
    figure = heat_maps({"ours": {(5, 1): 0.4, (5, 2): 0.6}}, "p", "z")
    assert figure.axes[0].images[0].get_clim() == (0, 1)


def test_every_share_is_written_into_its_cell_and_can_be_read():
    axis = heat_maps({"ours": OURS}, "p", "z").axes[0]
    numbers = {text.get_position(): text for text in axis.texts}
    assert {at: text.get_text() for at, text in numbers.items()} == {
        (0, 0): ".10",
        (1, 0): "0",
        (0, 1): "1",
        (1, 1): ".55",
    }
    assert numbers[1, 0].get_color() == "white"  # on black
    assert numbers[0, 1].get_color() == "black"  # on white


def test_panels_share_their_rows_and_columns_and_missing_cells_stay_empty():
    left, right, _ = heat_maps({"ours": OURS, "theirs": THEIRS}, "p", "z").axes
    assert (left.get_title("left"), right.get_title("left")) == ("ours", "theirs")
    np.testing.assert_array_equal(shown(right), [[NAN, NAN], [0.95, NAN]])
    assert len(right.texts) == 1


def test_files_are_the_same_every_time(tmp_path):
    for turn in ("first", "second"):
        for name, write in plots.writers(turn, heat_maps({"ours": OURS}, "p", "z")).items():
            write(tmp_path / name)
    for form in plots.FORMATS:
        first, second = (tmp_path / f"{turn}.{form}" for turn in ("first", "second"))
        assert first.read_bytes() == second.read_bytes()
