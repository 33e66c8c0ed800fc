"""TRC is read back, cell by cell, by a parser that shares nothing with the writer."""

import numpy as np

from tests.io.files import save


def parse(path):
    """Return the header, the names, and the numbers (f, 2 + 3 p), nan in empty cells."""
    lines = path.read_text(encoding="utf-8").split("\n")
    assert lines.pop() == ""
    header = dict(zip(lines[1].split("\t"), lines[2].split("\t"), strict=True))
    cells = [line.split("\t") for line in lines[3:]]
    assert len({len(row) for row in cells}) == 1
    names, axes = cells[0][2::3], cells[1][2:]
    assert cells[0][:2] == ["Frame#", "Time"]
    assert axes == [f"{axis}{n}" for n in range(1, len(names) + 1) for axis in "XYZ"]
    rows = [[float(cell) if cell else np.nan for cell in row] for row in cells[2:]]
    return lines[0].split("\t"), header, names, np.array(rows)


def test_points_and_times_come_back(tmp_path, scene):
    target = tmp_path / "man.trc"
    summary = save(target, scene.result.take(slice(0, 3)), scene.result.take([3]))
    first, header, names, rows = parse(target)
    assert first[:3] == ["PathFileType", "4", "(X/Y/Z)"]
    assert first[4].startswith("y up, the axis z of the extrinsics; position from the camera")
    assert header["Units"] == "m"
    assert (header["DataRate"], header["NumFrames"], header["NumMarkers"]) == ("25", "4", "15")
    assert header["OrigDataStartFrame"] == "7"
    assert names == list(scene.result.landmark_names)
    np.testing.assert_array_equal(rows[:, 0], [7, 8, 9, 10])
    np.testing.assert_allclose(rows[:, 1], np.array([7, 8, 9, 10]) / 25)
    points = rows[:, 2:].reshape(4, 15, 3).swapaxes(1, 2)
    np.testing.assert_allclose(points, scene.y_up, atol=1e-12)
    assert summary.written == (target, tmp_path / "man_angles.csv")
    assert "in m by the size of the training shapes, y up, the axis z" in summary.note
    assert summary.warnings == ()


def test_frames_are_sorted_and_those_missing_are_gaps(tmp_path, scene):
    result = scene.result.take([3, 0, 2])
    shapes = result.shapes.copy()
    shapes[2] = np.nan  # frame 9 failed
    result = result.replaced(shapes=shapes, frame_rate=None)
    target = tmp_path / "man.trc"
    summary = save(target, result)
    _, header, _, rows = parse(target)
    np.testing.assert_array_equal(rows[:, 0], [7, 8, 9, 10])
    np.testing.assert_array_equal(rows[:, 1], [7, 8, 9, 10])
    np.testing.assert_array_equal(np.isnan(rows).all(axis=1), False)
    np.testing.assert_array_equal(np.isnan(rows[:, 2:]).all(axis=1), [False, True, True, False])
    assert header["NumFrames"] == "4"
    gap, missing, rate = summary.warnings
    assert gap == "1 item without a shape of film/anna: gaps"
    assert missing == "1 frame without an item of film/anna: gaps"
    assert rate.startswith("the frame rate is unknown")


def test_an_unknown_landmark_is_an_empty_cell(tmp_path, shapes, scene):
    points = shapes.shapes.copy()
    points[1, :, 4] = np.nan
    target = tmp_path / "walk.trc"
    save(target, shapes.replaced(shapes=points), up="z")
    rows = parse(target)[3]
    found = rows[:, 2:].reshape(4, 15, 3).swapaxes(1, 2)
    assert np.isnan(found[1, :, 4]).all()
    found[1, :, 4] = scene.y_up[1, :, 4]
    np.testing.assert_allclose(found, scene.y_up, atol=1e-12)


def test_each_individual_has_a_file(tmp_path, scene, rng):
    several = scene.result.replaced(
        items=("film/anna/0", "film/anna/1", "film/person 2/0", "film/person 2/1"),
        sequences=("film/anna",) * 2 + ("film/person 2",) * 2,
        further=scene.result.further | {"frame": np.array([0, 1, 0, 1])},
    )
    summary = save(tmp_path / "man.trc", several)
    names = [path.name for path in summary.written]
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(names)
    names = [name for name in names if name.endswith(".trc")]
    assert names == ["man_anna.trc", "man_person_2.trc"]
    np.testing.assert_array_equal(parse(tmp_path / names[1])[3][:, 0], [0, 1])


def test_names_with_tabs_do_not_shift_columns(tmp_path, shapes):
    odd = shapes.replaced(landmark_names=("a\tb", "c\nd", *shapes.landmark_names[2:]))
    save(tmp_path / "odd.trc", odd)
    assert parse(tmp_path / "odd.trc")[2][:2] == ["a\\tb", "c\\nd"]


def test_two_items_of_one_frame(tmp_path, scene, problems):
    twice = scene.result.replaced(further=scene.result.further | {"frame": np.array([0, 0, 1, 2])})
    (line,) = problems(save, tmp_path / "man.trc", twice)
    assert "'film/anna/0' and 'film/anna/1' are of one frame" in line
    assert "track: nearest" in line
    assert not list(tmp_path.iterdir())


def test_times_of_a_rate_that_is_nearly_25_are_short(tmp_path, scene):
    """Other tools state rates such as 1 / 0.04: 99 frames end at 3.96 s, not 3.9599...95."""
    result = scene.result.replaced(frame_rate=25.000000000000004, frame=np.arange(96, 100))
    save(tmp_path / "man.trc", result)
    cells = [line.split("\t")[1] for line in (tmp_path / "man.trc").read_text().splitlines()[5:]]
    assert cells == ["3.84", "3.88", "3.92", "3.96"]
