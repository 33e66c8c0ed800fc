"""A page says what its files lack, and shows the rest."""

from __future__ import annotations

import numpy as np


def test_a_result_with_all_it_needs_says_nothing(desk):
    edges = np.array([[0, 1], [1, 2]])
    made = desk.view(desk.result(), truth=(desk.truth(edges=edges),))
    assert made.notes == "Aligned with result by the best similarity: truth."
    assert made.data["edges"] == edges.tolist()
    assert [layer["name"] for layer in made.data["layers"]] == ["result", "truth"]
    assert made.outcome.done == 6


def test_without_observed_landmarks(desk):
    made = desk.view(desk.result(extras={}))
    assert "no observed landmarks; add the landmark file" in made.notes
    assert made.data["seen"] is None
    assert made.data["flat"]


def test_the_landmark_file_gives_the_observed_landmarks(desk):
    made = desk.view(desk.result(extras={}), desk.landmarks())
    assert "observed" not in made.notes
    assert made.data["seen"]["shape"] == [6, 5, 2]


def test_without_edges(desk):
    assert "No edges are known" in desk.view(desk.result()).notes


def test_edges_that_the_result_carries(desk):
    extras = {"edges": np.array([[0, 4]])}
    assert desk.view(desk.result(extras=extras)).data["edges"] == [[0, 4]]


def test_failed_items_are_counted_and_have_no_number(desk):
    shapes = desk.shapes(6)
    shapes[[1, 4]] = np.nan
    made = desk.view(desk.result(shapes=shapes))
    assert "result has no shape of 2 frames" in made.notes
    assert len(made.data["items"]) == 6


def test_all_failed(desk):
    assert "no shape of 6 frames" in desk.view(desk.result(shapes=np.full((6, 3, 5), np.nan))).notes


def test_one_frame(desk):
    made = desk.view(desk.result(n=1))
    assert made.data["sequences"] == [{"name": "", "start": 0}]


def test_landmarks_alone(desk):
    made = desk.view(desk.landmarks())
    assert "nothing in 3D" in made.notes
    assert made.data["layers"] == []


def test_shapes_alone_have_no_image(desk):
    made = desk.view(desk.truth(edges=np.array([[0, 1]])))
    assert (made.data["flat"], made.notes) == (False, "")


def test_csv_shows_points(desk):
    rows = [f"i{i},{name},{i},{j},1" for i in range(3) for j, name in enumerate("abc")]
    csv = desk.folder / "points.csv"
    csv.write_text("\n".join(["item,landmark,x,y,z", *rows]), encoding="utf-8")
    made = desk.view(csv)
    assert [layer["role"] for layer in made.data["layers"]] == ["result"]


def test_a_dictionary_that_is_gone_or_changed_is_named(desk):
    gone = '{"dictionary": "/nowhere/dict.h5"}'
    made = desk.view(desk.result(attributes={"config": gone}))
    assert "its dictionary dict.h5 no longer exists; -d DICT.h5 names another" in made.notes
    changed = desk.truth()
    made = desk.view(desk.result(attributes={"config": f'{{"dictionary": "{changed}"}}'}))
    assert "has changed since the fit" in made.notes


def test_frames_that_only_one_result_has(desk):
    one = desk.result("one.h5", n=2)
    other = desk.result("other.h5", n=3, items=("i1", "i2", "i3"))
    made = desk.view(one, other)
    assert made.data["items"] == ["i0", "i1", "i2", "i3"]
    assert "one has no shape of 2 frames" in made.notes


def test_landmarks_are_matched_by_name(desk):
    shapes = desk.shapes(2)
    one = desk.result("one.h5", n=2, shapes=shapes)
    order = [3, 0, 4]
    names = ("d", "a", "e")
    other = desk.result("other.h5", n=2, shapes=shapes[:, :, order], landmark_names=names)
    made = desk.view(one, other)
    assert made.data["landmarks"] == list("abcde")
    first, second = (layer["points"] for layer in made.data["layers"])
    assert first["shape"] == second["shape"] == [2, 5, 3]
