"""BVH: joints worked out by hand."""

import pytest
from numpy.testing import assert_allclose

TREE = """HIERARCHY
ROOT Hips
{
  OFFSET 0 10 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT Left Leg
  {
    OFFSET 0 -4 0
    CHANNELS 3 Xrotation Yrotation Zrotation
    End Site
    {
      OFFSET 0 0 2
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.04
"""
FRAMES = "0 0 0 0 0 0 0 0 0\n1 2 3 90 0 0 90 90 0\n"
BVH = TREE + FRAMES


BRACES_ON_ONE_LINE = TREE.replace("ROOT Hips\n{", "ROOT Hips {").replace(
    "  }\n}", "  } }"
)


OTHER_CASE = TREE.replace("rotation", "Rotation").replace("position", "POSITION")


CAPITALS = TREE.replace("Frame Time:", "FRAME TIME:").replace("MOTION", "Motion")


FORMS = {
    "plain": BVH,
    "CRLF": BVH.replace("\n", "\r\n"),
    "braces on one line": BRACES_ON_ONE_LINE + FRAMES,
    "case of channels": OTHER_CASE + "\n" + FRAMES,
    "case of keywords": CAPITALS + FRAMES,
}


STILL = [[0, 0, 0], [0, -4, 0], [0, -4, 2]]
"""Hips, leg and its end in the first frame: nothing turns."""


TURNED = [[1, 2, 3], [5, 2, 3], [5, 4, 3]]
"""The second frame: the root turns -y to x. The leg turns about x, then about its new
y, which takes its z through its own axes to x; the root takes that to y.
"""


@pytest.mark.parametrize("text", FORMS.values(), ids=FORMS)
def test_bvh_worked_out_by_hand(read_motion, text):
    """Channels turn in their order, each in the frame of those before; positions
    replace offsets.
    """
    shapes, _ = read_motion("walk.bvh", text)
    assert_allclose(shapes.shapes, [STILL, TURNED], atol=1e-12)


@pytest.mark.parametrize("text", FORMS.values(), ids=FORMS)
def test_names_edges_and_rate_of_bvh(read_motion, text):
    shapes, notes = read_motion("walk.bvh", text)
    assert shapes.landmark_names == ("Hips", "Left Leg", "Left Leg_end")
    assert shapes.items == ("walk/0", "walk/1")
    assert shapes.edges.tolist() == [[0, 1], [1, 2]]
    assert shapes.unit == "unknown"
    assert shapes.frame_rate == 25.0
    assert notes == ()


def test_an_offset_holds_where_no_channel_replaces_it(read_motion):
    tree = TREE.replace("6 Xposition Yposition Zposition", "3")
    shapes, _ = read_motion("walk.bvh", tree + "0 0 0 0 0 0\n0 0 0 0 0 0\n")
    expected = [[0, 10, 0], [0, 6, 0], [0, 6, 2]]
    assert_allclose(shapes.shapes[0], expected)


def test_frames_of_bvh_that_are_announced_and_not_there(read_motion):
    shapes, notes = read_motion("w.bvh", BVH.replace("Frames: 2", "Frames: 5"))
    note = "3 frames are announced in the header, but not th"
    assert len(shapes) == 2
    assert any(note in line for line in notes)
