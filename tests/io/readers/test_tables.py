"""Tables of no known tool: order of rows, names that are numbers, decimal commas."""

from pathlib import Path

from .conftest import read_images as read


def table(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def test_videos_stand_as_they_appear_and_begin_at_0(tmp_path):
    text = "video,frame,a_x,a_y,b_x,b_y\nw,9,1,2,3,4\nv,5,5,6,7,8\nw,7,9,10,11,12\n"
    images, _ = read(table(tmp_path / "t.csv", text))
    assert images.items == ("t/w/7", "t/w/9", "t/v/5")
    assert images.columns["frame"].tolist() == [0, 2, 0]


def test_numbers_that_do_not_begin_at_0_or_1_are_names(tmp_path):
    text = "frame,x5,y5,x6,y6\n0,10,20,30,40\n"
    images, _ = read(table(tmp_path / "t.csv", text), keypoints="numbered")
    assert images.landmark_names == ("5", "6")
    images, _ = read(table(tmp_path / "u.csv", text.replace("5", "1").replace("6", "2")))
    assert images.landmark_names == ("0", "1")


def test_a_landmark_whose_confidence_is_left_empty_has_1(tmp_path):
    text = "frame,joint,x,y,score\n0,a,10,20,\n0,b,30,40,.5\n"
    images, _ = read(table(tmp_path / "t.csv", text))
    assert images.confidence.tolist() == [[1.0, 0.5]]
