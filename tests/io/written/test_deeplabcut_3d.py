"""Tables of 3D points as DeepLabCut writes them, read by csv and by our reader of such tables."""

import csv

import numpy as np

from shapefit.io import read_shapes
from tests.io.files import save


def table(path):
    rows = list(csv.reader(path.open(encoding="utf-8", newline="")))
    header = {row[0]: row[1:] for row in rows if not row[0].isdigit()}
    numbers = [
        [float(cell) if cell else np.nan for cell in row] for row in rows if row[0].isdigit()
    ]
    return header, np.array(numbers)


def test_one_individual(tmp_path, scene):
    target = tmp_path / "man.csv"
    names = ("a,b", 'c"d', *scene.result.landmark_names[2:])
    summary = save(target, scene.result.replaced(landmark_names=names), to="deeplabcut-3d")
    assert summary.written == (target,)
    header, numbers = table(target)
    assert list(header) == ["scorer", "bodyparts", "coords"]
    assert header["bodyparts"] == [name for name in names for _ in "xyz"]
    assert header["coords"] == list("xyz") * 15
    assert set(header["scorer"]) == {"shapefit"}
    np.testing.assert_array_equal(numbers[:, 0], [7, 8, 9, 10])
    points = numbers[:, 1:].reshape(4, 15, 3).swapaxes(1, 2)
    np.testing.assert_allclose(points, scene.y_up, atol=1e-12)


def test_several_individuals_share_a_file_and_videos_do_not(tmp_path, scene):
    result = scene.result.replaced(
        items=("film/anna/0", "film/bob/2", "film/anna/2", "other/bob/0"),
        sequences=("film/anna", "film/bob", "film/anna", "other/bob"),
        further=scene.result.further | {"frame": np.array([0, 2, 2, 0])},
    )
    film, other = save(tmp_path / "man.csv", result, to="deeplabcut-3d").written
    assert (film.name, other.name) == ("man_film.csv", "man_other.csv")
    header, numbers = table(film)
    assert header["individuals"] == ["anna"] * 45 + ["bob"] * 45
    np.testing.assert_array_equal(numbers[:, 0], [0, 1, 2])
    anna, bob = (
        numbers[:, 1 + start : 46 + start].reshape(3, 15, 3).swapaxes(1, 2) for start in (0, 45)
    )
    np.testing.assert_allclose(anna[[0, 2]], scene.y_up[[0, 2]], atol=1e-12)
    np.testing.assert_allclose(bob[2], scene.y_up[1], atol=1e-12)
    assert np.isnan(anna[1]).all()
    assert np.isnan(bob[:2]).all()


def test_our_reader_takes_it(tmp_path, scene):
    target = tmp_path / "man.csv"
    save(target, scene.result, to="deeplabcut-3d")
    shapes = read_shapes([target])
    assert shapes.landmark_names == scene.result.landmark_names
    assert shapes.items == tuple(f"man/{frame}" for frame in range(7, 11))
    np.testing.assert_allclose(shapes.shapes, scene.y_up, atol=1e-12)
