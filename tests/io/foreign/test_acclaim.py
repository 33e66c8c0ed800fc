"""ASF/AMC against other people's kinematics of the same motions, and what can be wrong with it."""

import numpy as np
import pytest

from shapefit.errors import InputError
from shapefit.io import open_shapes, read_shapes
from shapefit.io.options import InputOptions

CMU = {
    "root": "pelvis",
    "rhipjoint": "rhip",
    "rfemur": "rknee",
    "rtibia": "rankle",
    "lhipjoint": "lhip",
    "lfemur": "lknee",
    "ltibia": "lankle",
    "thorax": "neck",
    "rclavicle": "rshoulder",
    "rhumerus": "relbow",
    "lclavicle": "lshoulder",
    "lhumerus": "lelbow",
}
"""Ends of bones -> joints, as docs/formats.md gives them; head, rwrist, lwrist keep their names."""

ASF = """# made
:version 1.10
:units
  mass 1.0
  length 0.5
  angle deg
:root
  order TX TY TZ RX RY RZ
  axis XYZ
  position 0 0 0
  orientation 0 0 0
:bonedata
  begin
    id 1
    name thigh
    direction 0 -1 0
    length 2
    axis 0 0 90 XYZ
    dof rx
  end
  begin
    id 2
    name shin
    direction 0 -1 0
    length 1
    axis 0 0 0 XYZ
    dof rx rz
  end
:hierarchy
  begin
    root thigh
    thigh shin
  end
"""

AMC = """#!OML:ASF made
:FULLY-SPECIFIED
:DEGREES
1
root 1 2 3 0 0 0
thigh 0
shin 0 0
2
root 1 2 3 0 0 90
thigh 90
shin 0 90
"""

HALF_INCH = 0.0254 / 0.5


@pytest.fixture
def motion(tmp_path):
    def make(asf=ASF, amc=AMC, name="01_02.amc", skeleton="01.asf"):
        (tmp_path / skeleton).write_text(asf)
        (tmp_path / name).write_text(amc)
        return tmp_path / name

    return make


@pytest.mark.real_data
@pytest.mark.parametrize(
    ("motions", "exact", "step", "bound"),
    [
        (["86/86_01", "86/86_09"], "subject86_120fps_exact", 1, 2.5e-6),
        (["13/13_29"], "subject13_29_120fps_exact", 1, 1e-6),
        ([f"02/02_{n:02d}" for n in range(1, 11)], "other_subjects_24fps", 5, 1e-6),
    ],
)
def test_it_equals_the_exact_kinematics(real_data, motions, exact, step, bound):
    """Of subjects 86 and 13 the exact joints are relative to the root; so they are compared.

    Those of subject 86 were computed from angles with fewer digits: they are off by 2 micrometres.
    """
    mocap = real_data / "mocap"
    paths = [mocap / f"asfamc/{motion}.amc" for motion in motions]
    with open_shapes(paths, InputOptions(rename=CMU)) as source:
        (found,) = source.batches(source.count)
    known = read_shapes([mocap / f"{exact}.h5"])
    columns = [found.landmark_names.index(name) for name in known.landmark_names]
    assert found.unit == "m"
    for motion in motions:
        name = motion.partition("/")[2]
        ours = found.shapes[np.array(found.sequences) == name][::step][:, :, columns]
        theirs = known.shapes[np.array(known.sequences) == name]
        assert len(ours) == len(theirs)
        if step == 1:
            ours = ours - ours[:, :, :1]
            theirs = theirs - theirs[:, :, :1]
        assert np.abs(ours - theirs).max() < bound


def test_bones_turn_in_their_own_frames(motion):
    """Worked out by hand: the thigh's x axis points along y, so that it turns about y."""
    shapes = read_shapes([motion()])
    assert shapes.landmark_names == ("root", "thigh", "shin")
    assert shapes.items == ("01_02/1", "01_02/2")
    assert shapes.edges.tolist() == [[0, 1], [1, 2]]
    still = [[1, 2, 3], [1, 0, 3], [1, -1, 3]]
    np.testing.assert_allclose(shapes.shapes[0].T, HALF_INCH * np.array(still), atol=1e-12)
    # The root turns -y to x; the thigh turns about its length; the shin turns by z -y to x first,
    # which the thigh turns to -z.
    moved = [[1, 2, 3], [3, 2, 3], [3, 2, 2]]
    np.testing.assert_allclose(shapes.shapes[1].T, HALF_INCH * np.array(moved), atol=1e-12)


def test_radians_and_lengths_without_a_unit(motion):
    right = str(np.pi / 2)
    amc = AMC.replace(":DEGREES", ":RADIANS").replace(" 90", f" {right}")
    degrees = read_shapes([motion()])
    radians = read_shapes([motion(asf=ASF.replace("length 0.5", "length 1"), amc=amc)])
    assert radians.unit == "unknown"
    np.testing.assert_allclose(radians.shapes, degrees.shapes / HALF_INCH, atol=1e-9)


@pytest.mark.parametrize(
    ("asf", "amc", "words"),
    [
        (ASF, AMC.replace("shin 0 0", "shin 0"), ["01_02.amc:7", "2 degrees of freedom of shin"]),
        (ASF, AMC.replace("shin", "calf"), ["01_02.amc:7", "no bone 'calf'"]),
        (ASF, AMC.replace("thigh 90", "thigh x"), ["01_02.amc:10", "'x' is no number"]),
        (ASF, AMC.removesuffix("shin 0 90\n"), ["01_02.amc", "lacks bones"]),
        (ASF.replace("thigh shin", "thigh calf"), AMC, ["01.asf:32", "calf"]),
        (ASF.replace("length 2", "length two"), AMC, ["01.asf:13", "two"]),
        (ASF.partition(":bonedata")[0], AMC, ["01.asf", "no bones"]),
        (ASF.partition(":hierarchy")[0], AMC, ["01.asf", "thigh, shin"]),
    ],
)
def test_errors_name_file_and_line(motion, asf, amc, words):
    with pytest.raises(InputError) as error:
        read_shapes([motion(asf=asf, amc=amc)])
    assert all(word in str(error.value) for word in words), error.value


def test_the_skeleton_is_found_by_its_name(motion, tmp_path):
    path = motion()
    (tmp_path / "02.asf").write_text(ASF.replace("length 2", "length 20"))
    assert read_shapes([path]).shapes[0, 1, 1] == pytest.approx(0)
    path = path.rename(tmp_path / "walk.amc")
    with pytest.raises(InputError, match="none of the ASF files"):
        read_shapes([path])
    given = read_shapes([path, tmp_path / "02.asf"])
    assert given.shapes[0, 1, 1] == pytest.approx(-18 * HALF_INCH)
    with pytest.raises(InputError, match="a skeleton without a motion"):
        read_shapes([tmp_path / "02.asf"])
