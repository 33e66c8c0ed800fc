"""ASF and AMC: joints worked out by hand, and against other people's kinematics."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

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
"""Ends of bones -> joints, as docs/formats.md gives them; head, rwrist, lwrist keep
their names.
"""

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
    """Write a skeleton and a motion, and return the path of the motion."""

    def write(asf=ASF, amc=AMC):
        skeleton = tmp_path / "01.asf"
        motion = tmp_path / "01_02.amc"
        skeleton.write_text(asf)
        motion.write_text(amc)
        return motion

    return write


SUBJECT_86 = ["86/86_01", "86/86_09"]


SUBJECT_13 = ["13/13_29"]


SUBJECT_2 = [f"02/02_{number:02d}" for number in range(1, 11)]


@pytest.fixture
def recordings(real_data):
    """Read motions with the names of joints, and the exact joints that are known."""
    mocap = real_data / "mocap"

    def read(motions, exact):
        paths = [mocap / f"asfamc/{motion}.amc" for motion in motions]
        with open_shapes(paths, InputOptions(rename=CMU)) as source:
            (shapes,) = source.batches(source.count)
        known = read_shapes([mocap / f"{exact}.h5"])
        return shapes, known

    return read


def points_of(shapes, sequence, names):
    """Return the points (n, p, 3) of a sequence, landmarks in this order."""
    columns = [shapes.landmark_names.index(name) for name in names]
    rows = np.array(shapes.sequences) == sequence
    return shapes.shapes[rows][:, columns]


def relative_to_the_root(points):
    return points - points[:, :1]


@pytest.mark.real_data
@pytest.mark.parametrize(
    ("motions", "exact", "bound"),
    [
        (SUBJECT_86, "subject86_120fps_exact", 2.5e-6),
        (SUBJECT_13, "subject13_29_120fps_exact", 1e-6),
    ],
)
def test_acclaim_equals_the_exact_kinematics(recordings, motions, exact, bound):
    """Of subjects 86 and 13 the exact joints are relative to the root; so they are
    compared.

    Those of subject 86 were computed from angles with fewer digits: they are off by 2
    micrometres.
    """
    shapes, known = recordings(motions, exact)
    names = known.landmark_names
    assert shapes.unit == "m"
    for motion in motions:
        sequence = motion.partition("/")[2]
        ours = relative_to_the_root(points_of(shapes, sequence, names))
        theirs = relative_to_the_root(points_of(known, sequence, names))
        assert len(ours) == len(theirs)
        assert np.abs(ours - theirs).max() < bound


@pytest.mark.real_data
def test_acclaim_equals_the_kinematics_of_other_subjects(recordings):
    """Every fifth frame of 120 a second is known, in the world."""
    shapes, known = recordings(SUBJECT_2, "other_subjects_24fps")
    names = known.landmark_names
    for motion in SUBJECT_2:
        sequence = motion.partition("/")[2]
        ours = points_of(shapes, sequence, names)[::5]
        theirs = points_of(known, sequence, names)
        assert len(ours) == len(theirs)
        assert np.abs(ours - theirs).max() < 1e-6


STILL = [[1, 2, 3], [1, 0, 3], [1, -1, 3]]
"""Root, thigh and shin where nothing turns."""


TURNED = [[1, 2, 3], [3, 2, 3], [3, 2, 2]]
"""The root turns -y to x; the thigh turns about its length; the shin turns by z -y to x
first, which the thigh turns to -z.
"""


def test_bones_turn_in_their_own_frames(motion):
    """Worked out by hand: the thigh's x axis points along y, so that it turns about
    y.
    """
    shapes = read_shapes([motion()])
    expected = HALF_INCH * np.array([STILL, TURNED])
    assert_allclose(shapes.shapes, expected, atol=1e-12)


def test_names_and_edges_of_acclaim(motion):
    shapes = read_shapes([motion()])
    assert shapes.landmark_names == ("root", "thigh", "shin")
    assert shapes.items == ("01_02/1", "01_02/2")
    assert shapes.edges.tolist() == [[0, 1], [1, 2]]


def test_lengths_without_a_unit(motion):
    in_metres = read_shapes([motion()])
    unknown = read_shapes([motion(asf=ASF.replace("length 0.5", "length 1"))])
    expected = in_metres.shapes / HALF_INCH
    assert unknown.unit == "unknown"
    assert_allclose(unknown.shapes, expected, atol=1e-9)


BAD_MOTIONS = [
    (AMC.replace("shin 0 0", "shin 0"), ["01_02.amc:7", "1 numbers of 'shin', not 2"]),
    (AMC.replace("shin", "calf"), ["01_02.amc:7", "numbers of 'calf'"]),
    (AMC.replace("thigh 90", "thigh x"), ["01_02.amc", "'x' is no number"]),
    (AMC.removesuffix("shin 0 90\n"), ["01_02.amc"]),
    (AMC.replace(":DEGREES", ":RADIANS"), ["01_02.amc", "angles in radians"]),
]


BAD_SKELETONS = [
    (ASF.replace("angle deg", "angle rad"), ["01.asf", "angles in radians"]),
    (ASF.replace("thigh shin", "thigh calf"), ["01.asf", "calf"]),
    (ASF.replace("name shin", "name thigh"), ["01.asf", "the bone 'thigh' twice"]),
    (ASF.replace("position 0 0 0", "position 0 0 x"), ["01.asf:1:", "'x'"]),
    (ASF.replace("length 2", "length two"), ["01.asf:13", "two"]),
    (ASF.partition(":hierarchy")[0], ["01.asf", "every bone once"]),
]
"""A file, where the error says it is wrong, and further words of the error."""


def check_error(path, words):
    with pytest.raises(InputError) as caught:
        read_shapes([path])
    told = str(caught.value)
    place, *others = words
    assert told.startswith(f"{path.parent}/{place}")
    for word in others:
        assert word in told


@pytest.mark.parametrize(("amc", "words"), BAD_MOTIONS)
def test_errors_of_motions_name_file_and_line(motion, amc, words):
    check_error(motion(amc=amc), words)


@pytest.mark.parametrize(("asf", "words"), BAD_SKELETONS)
def test_errors_of_skeletons_name_file_and_line(motion, asf, words):
    check_error(motion(asf=asf), words)


def test_the_skeleton_is_found_by_its_name(motion, tmp_path):
    path = motion()
    other = tmp_path / "02.asf"
    other.write_text(ASF.replace("length 2", "length 20"))
    knee = read_shapes([path]).shapes[0, 1]
    assert knee[1] == pytest.approx(0)


def test_of_several_skeletons_none_is_guessed(motion, tmp_path):
    other = tmp_path / "02.asf"
    other.write_text(ASF)
    path = motion().rename(tmp_path / "walk.amc")
    with pytest.raises(InputError, match="none of the 2 skeletons beside it"):
        read_shapes([path])


def test_a_skeleton_has_no_motion(motion):
    skeleton = motion().parent / "01.asf"
    with pytest.raises(InputError, match="a skeleton without a motion"):
        read_shapes([skeleton])
