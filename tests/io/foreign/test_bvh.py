"""BVH: the tree, the order of its channels, and what can be wrong with it."""

import numpy as np
import pytest

from shapefit.errors import InputError
from tests.io.files import load_shapes

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


def read(tmp_path, text):
    path = tmp_path / "walk.bvh"
    path.write_text(text)
    return load_shapes(path)


@pytest.mark.parametrize(
    "text",
    [
        TREE + FRAMES,
        (TREE + FRAMES).replace("\n", "\r\n"),
        TREE.replace("ROOT Hips\n{", "ROOT Hips {").replace("  }\n}", "  } }") + FRAMES,
        TREE.replace("rotation", "Rotation").replace("position", "POSITION") + "\n" + FRAMES,
    ],
)
def test_worked_out_by_hand(tmp_path, text):
    """Channels turn in their order, each in the frame of those before; positions replace offsets.

    Second frame: the root turns -y to x. The leg turns about x, then about its new y, which takes
    its z through its own axes to x; the root takes that to y.
    """
    shapes, notes = read(tmp_path, text)
    assert shapes.landmark_names == ("Hips", "Left Leg", "Left Leg_end")
    assert shapes.items == ("walk/0", "walk/1")
    assert (shapes.unit, shapes.frame_rate, notes) == ("unknown", 25.0, ())
    assert shapes.edges.tolist() == [[0, 1], [1, 2]]
    np.testing.assert_allclose(shapes.shapes[0].T, [[0, 0, 0], [0, -4, 0], [0, -4, 2]], atol=1e-12)
    np.testing.assert_allclose(shapes.shapes[1].T, [[1, 2, 3], [5, 2, 3], [5, 4, 3]], atol=1e-12)


def test_an_offset_holds_where_no_channel_replaces_it(tmp_path):
    tree = TREE.replace("6 Xposition Yposition Zposition", "3")
    shapes, _ = read(tmp_path, tree + "0 0 0 0 0 0\n0 0 0 0 0 0\n")
    np.testing.assert_allclose(shapes.shapes[0].T, [[0, 10, 0], [0, 6, 0], [0, 6, 2]])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (TREE + FRAMES.replace("90 90 0", "90 90"), ["walk.bvh:20", "8 cells for 9"]),
        (TREE + FRAMES.replace("90 90 0", "90 x 0"), ["walk.bvh:20", "'x'"]),
        (TREE + FRAMES.replace("90 90 0", "90 inf 0"), ["walk.bvh:20", "'inf'"]),
        (TREE.partition("MOTION")[0], ["walk.bvh", "no motion"]),
        (TREE.partition("    End")[0], ["walk.bvh", "no motion"]),
        (TREE.replace("  }\n}\n", "") + FRAMES, ["walk.bvh:16", "not complete"]),
        (TREE.replace("CHANNELS 3", "CHANNELS 4") + FRAMES, ["walk.bvh:9", "4 channels"]),
        (TREE.replace("Zrotation", "Wrotation") + FRAMES, ["walk.bvh:5", "'Wrotation'"]),
        (TREE.replace("OFFSET 0 -4 0", "x OFFSET 0 -4 0") + FRAMES, ["walk.bvh:8", "'x'"]),
        (TREE.replace("0 -4 0", "0 -4 nan") + FRAMES, ["walk.bvh:8", "3 numbers"]),
        (TREE.replace("Time: 0.04", "Time: soon") + FRAMES, ["walk.bvh:18", "soon"]),
        (TREE.replace("Frames: 2", "Frames: many") + FRAMES, ["walk.bvh:17", "many"]),
        (TREE.replace("Frames: 2", "Frames: 1e400") + FRAMES, ["walk.bvh:17"]),
    ],
)
def test_errors_name_file_and_line(tmp_path, text, words):
    with pytest.raises(InputError) as error:
        read(tmp_path, text)
    assert all(word in str(error.value) for word in words), error.value
