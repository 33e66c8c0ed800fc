"""Motion as text and C3D: worked out by hand, against other people's kinematics, in all
forms.
"""

import struct

import numpy as np
import pytest

from shapefit.errors import InputError
from shapefit.io import open_shapes, read_shapes
from shapefit.io.options import InputOptions
from shapefit.io.source import find_kind
from tests.io.files import load_shapes

from .made import read_images

NAN = [np.nan] * 3

# TRC

HEAD = (
    "PathFileType\t4\t(X/Y/Z)\twalk.trc\n"
    "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\n"
    "50\t50\t3\t2\tmm\n"
    "Frame#\tTime\tknee\t\t\tankle\t\t\n"
    "\t\tX1\tY1\tZ1\tX2\tY2\tZ2\n"
)
ROWS = (
    "0\t0.00\t1\t2\t3\t4\t5\t6\n"
    "1\t0.02\t7\t8\t9\t0\t0\t0\n"
    "2\t0.04\tnan\t\t\t-1e2\t.5\t6.\n"
)
TRC = HEAD + ROWS
MARKERS = np.array([[[1, 2, 3], [4, 5, 6]], [[7, 8, 9], NAN], [NAN, [-100, 0.5, 6]]])


@pytest.fixture
def read(tmp_path):
    """Write a text under a name and read it as shapes, with warnings."""

    def read(name, text):
        (tmp_path / name).write_bytes(text.encode("utf-8", "surrogateescape"))
        return load_shapes(tmp_path / name)

    return read


@pytest.mark.parametrize(
    "text",
    [
        TRC,
        HEAD + "\t\t\n" + ROWS + "\n\n",
        (HEAD + "\n" + ROWS).replace("\t", ","),
        TRC.replace("\n", "\r\n"),
        "\ufeff" + TRC,
        HEAD + ROWS.replace("\t0\t0\t0", ""),
        TRC.replace("6\n", "6\t\t\n"),
        HEAD + ROWS.replace("0.02\t7\t8\t9", "0.02\t7\t8\t9  "),
    ],
)
def test_trc_in_all_its_forms(read, text):
    shapes, _ = read("walk.trc", text)
    assert shapes.landmark_names == ("knee", "ankle")
    assert shapes.items == ("walk/0", "walk/1", "walk/2")
    assert (shapes.unit, shapes.frame_rate) == ("m", 50.0)
    np.testing.assert_allclose(shapes.points, MARKERS / 1000)


def test_points_after_the_named_ones_are_left_out(read):
    """Cortex writes markers without names there, in some rows."""
    text = TRC.replace("4\t5\t6\n", "4\t5\t6\t\t\t\t9\t9\t9\n")
    shapes, notes = read(
        "walk.trc", text.replace("1e2\t.5\t6.", "1e2\t.5\t6.\t8\t8\t8")
    )
    np.testing.assert_allclose(shapes.points, MARKERS / 1000)
    assert any("2 points without a name left out" in note for note in notes)


def test_columns_that_the_header_counts_without_names_are_left_out(read):
    head = HEAD.replace("\tX2\tY2\tZ2", "\tX2\tY2\tZ2\tX3\tY3\tZ3")
    rows = ROWS.replace("4\t5\t6\n", "4\t5\t6\t7\t8\t9\n")
    shapes, notes = read("walk.trc", head + rows)
    np.testing.assert_allclose(shapes.points, MARKERS / 1000)
    assert any("1 point without a name left out" in note for note in notes)


PLANE = np.array([[[n, -20, 0], [40, -50 - n, 0]] for n in range(3)], float)


def write_plane_as_trc(path):
    rows = [[n, n / 50, *points.ravel()] for n, points in enumerate(PLANE)]
    lines = ["\t".join(map(str, row)) for row in rows]
    path.write_text(HEAD.replace("mm", "px") + "\n".join(lines) + "\n")


def write_plane_as_vicon(path):
    rows = [[n, 0, *points.ravel()] for n, points in enumerate(PLANE)]
    lines = [",".join(map(str, row)) for row in rows]
    head = VICON[: VICON.index("7,0")].replace("mm", "px")
    path.write_text(head + "\n".join(lines) + "\n")


def write_plane_as_c3d(path):
    ezc3d = pytest.importorskip("ezc3d", reason="ezc3d is the extra `c3d`")
    file = ezc3d.c3d()
    file["parameters"]["POINT"]["LABELS"]["value"] = ["knee", "ankle"]
    file["parameters"]["POINT"]["UNITS"]["value"] = ["px"]
    file["parameters"]["POINT"]["RATE"]["value"] = [50.0]
    points = np.ones((4, 2, 3))
    points[:3] = PLANE.transpose(2, 1, 0)
    file["data"]["points"] = points
    file.write(str(path))


def write_plane_as_table(path):
    rows = [
        [n, landmark, *point]
        for n, points in enumerate(PLANE)
        for landmark, point in zip(("knee", "ankle"), points, strict=True)
    ]
    lines = [";".join(map(str, row)) for row in rows]
    path.write_text("frame;landmark;x;y;z\n" + "\n".join(lines) + "\n")


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(
    ("name", "write"),
    [
        ("walk.trc", write_plane_as_trc),
        ("walk.c3d", write_plane_as_c3d),
        ("walk.csv", write_plane_as_vicon),
        ("table.csv", write_plane_as_table),
    ],
)
def test_points_in_a_plane_are_landmarks(tmp_path, monkeypatch, name, write, sign):
    """y of markers points up; that of pixels below 0 is negated, as Sports2D writes the
    landmarks of an image. A table does not say where y points.
    """
    plane = PLANE * [1.0, sign, 1.0]
    monkeypatch.setitem(globals(), "PLANE", plane)
    path = tmp_path / name
    write(path)
    assert find_kind(path) == "landmarks"
    images, notes = read_images(path)
    stated = name != "table.csv"
    negated = stated and sign == 1
    factors = [1, -1] if negated else [1, 1]
    np.testing.assert_array_equal(images.landmarks, plane[..., :2] * factors)
    assert images.y_axis == ("up" if stated and not negated else "down")
    assert images.unit == ("px" if stated else "unknown")
    note = "z is 0 everywhere: x and y are read as landmarks"
    assert any(one.endswith(note) for one in notes)
    assert negated == notes[-1].endswith("its sign is changed: y points down")
    assert (images.y_axis == "up") == notes[-1].endswith(
        "y points up, as that of markers"
    )
    with pytest.raises(InputError, match="of 2D points: z is 0 everywhere; give 3D sh"):
        load_shapes(path)


def test_negative_pixels_stay_where_y_is_said_to_point_up(tmp_path):
    path = tmp_path / "walk.trc"
    write_plane_as_trc(path)
    images, _ = read_images(path, y_axis="up")
    np.testing.assert_array_equal(images.landmarks, PLANE[..., :2])
    assert images.y_axis == "up"


def test_markers_in_space_are_no_landmarks(tmp_path):
    path = tmp_path / "walk.trc"
    path.write_text(TRC)
    with pytest.raises(InputError, match="of 3D points; give 2D landmarks"):
        read_images(path)


@pytest.mark.parametrize(
    ("unit", "factor", "name"),
    [
        ("m", 1, "m"),
        ("cm", 0.01, "m"),
        ("Meters", 1, "m"),
        ("", 1, "unknown"),
        ("ell", 1, "ell"),
    ],
)
def test_lengths_are_metres_where_the_unit_is_known(read, unit, factor, name):
    shapes, _ = read("walk.trc", TRC.replace("mm", unit))
    assert shapes.unit == name
    np.testing.assert_allclose(shapes.points, factor * MARKERS)


@pytest.mark.parametrize(
    ("text", "names", "note"),
    [
        (
            HEAD.replace("\t3\t2\t", "\t9\t2\t") + ROWS,
            "knee ankle",
            "6 frames are announced",
        ),
        (TRC, "knee ankle", "1 points at exactly 0, 0, 0"),
        (TRC.replace("ankle", "knee"), "knee knee_2", ""),
        (TRC.replace("ankle", ""), "knee", "2 points without a name left out"),
        (TRC.replace("knee", "kn\udce9e"), "knée ankle", ""),
    ],
)
def test_names_and_warnings_of_trc(read, text, names, note):
    shapes, notes = read("walk.trc", text)
    assert shapes.landmark_names == tuple(names.split())
    assert note in "\n".join(notes)


# anipose

ANIPOSE = "nose_x,nose_y,nose_z,nose_error,nose_ncams,nose_score,"
ANIPOSE += "tail_1_x,tail_1_y,tail_1_z,tail_1_error,tail_1_ncams,tail_1_score,"
ANIPOSE += "M_00,center_0,fnum\n"
FLY = "1,2,3,0.5,3,0.9,4,5,6,0.4,2,0.8,1,0,7\n1.5,2,3,0.5,3,0.9,,,,,,,1,0,8\n"
FLY += "nan,nan,nan,nan,nan,nan,4,5,6,0.4,2,nan,1,0,9\n"


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_points_scores_and_frame_numbers_of_anipose(read, end):
    shapes, _ = read("fly.csv", (ANIPOSE + FLY).replace("\n", end))
    assert shapes.landmark_names == ("nose", "tail_1")
    assert shapes.items == ("fly/7", "fly/8", "fly/9")
    assert shapes.sequences == ("fly",) * 3
    expected = [[[1, 2, 3], [4, 5, 6]], [[1.5, 2, 3], NAN], [NAN, [4, 5, 6]]]
    np.testing.assert_array_equal(shapes.points, expected)
    np.testing.assert_array_equal(
        shapes.column("confidence"), [[0.9, 0.8], [0.9, 0], [0, 1]]
    )


# BVH

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


@pytest.mark.parametrize(
    "text",
    [
        BVH,
        BVH.replace("\n", "\r\n"),
        TREE.replace("ROOT Hips\n{", "ROOT Hips {").replace("  }\n}", "  } }") + FRAMES,
        TREE.replace("rotation", "Rotation").replace("position", "POSITION")
        + "\n"
        + FRAMES,
        TREE.replace("Frame Time:", "FRAME TIME:").replace("MOTION", "Motion") + FRAMES,
    ],
)
def test_bvh_worked_out_by_hand(read, text):
    """Channels turn in their order, each in the frame of those before; positions
    replace offsets.

    Second frame: the root turns -y to x. The leg turns about x, then about its new y,
    which takes its z through its own axes to x; the root takes that to y.
    """
    shapes, notes = read("walk.bvh", text)
    assert shapes.landmark_names == ("Hips", "Left Leg", "Left Leg_end")
    assert shapes.items == ("walk/0", "walk/1")
    assert (shapes.unit, shapes.frame_rate, notes) == ("unknown", 25.0, ())
    assert shapes.edges.tolist() == [[0, 1], [1, 2]]
    np.testing.assert_allclose(
        shapes.points[0], [[0, 0, 0], [0, -4, 0], [0, -4, 2]], atol=1e-12
    )
    np.testing.assert_allclose(
        shapes.points[1], [[1, 2, 3], [5, 2, 3], [5, 4, 3]], atol=1e-12
    )


def test_an_offset_holds_where_no_channel_replaces_it(read):
    tree = TREE.replace("6 Xposition Yposition Zposition", "3")
    shapes, _ = read("walk.bvh", tree + "0 0 0 0 0 0\n0 0 0 0 0 0\n")
    np.testing.assert_allclose(shapes.points[0], [[0, 10, 0], [0, 6, 0], [0, 6, 2]])


def test_frames_of_bvh_that_are_announced_and_not_there(read):
    shapes, notes = read("w.bvh", BVH.replace("Frames: 2", "Frames: 5"))
    assert len(shapes) == 2
    assert any("3 frames are announced in the header, but not th" in n for n in notes)


# ASF/AMC

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
    def make(asf=ASF, amc=AMC):
        (tmp_path / "01.asf").write_text(asf)
        (tmp_path / "01_02.amc").write_text(amc)
        return tmp_path / "01_02.amc"

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
def test_acclaim_equals_the_exact_kinematics(real_data, motions, exact, step, bound):
    """Of subjects 86 and 13 the exact joints are relative to the root; so they are
    compared.

    Those of subject 86 were computed from angles with fewer digits: they are off by 2
    micrometres.
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
        ours = found.as_columns()[np.array(found.sequences) == name][::step][
            :, :, columns
        ]
        theirs = known.as_columns()[np.array(known.sequences) == name]
        assert len(ours) == len(theirs)
        if step == 1:
            ours = ours - ours[:, :, :1]
            theirs = theirs - theirs[:, :, :1]
        assert np.abs(ours - theirs).max() < bound


def test_bones_turn_in_their_own_frames(motion):
    """Worked out by hand: the thigh's x axis points along y, so that it turns about
    y.
    """
    shapes = read_shapes([motion()])
    assert shapes.landmark_names == ("root", "thigh", "shin")
    assert shapes.items == ("01_02/1", "01_02/2")
    assert shapes.edges.tolist() == [[0, 1], [1, 2]]
    still = [[1, 2, 3], [1, 0, 3], [1, -1, 3]]
    np.testing.assert_allclose(
        shapes.points[0], HALF_INCH * np.array(still), atol=1e-12
    )
    # The root turns -y to x; the thigh turns about its length; the shin turns by z -y
    # to x first, which the thigh turns to -z.
    moved = [[1, 2, 3], [3, 2, 3], [3, 2, 2]]
    np.testing.assert_allclose(
        shapes.points[1], HALF_INCH * np.array(moved), atol=1e-12
    )


def test_lengths_without_a_unit(motion):
    metres = read_shapes([motion()])
    unknown = read_shapes([motion(asf=ASF.replace("length 0.5", "length 1"))])
    assert unknown.unit == "unknown"
    np.testing.assert_allclose(unknown.points, metres.points / HALF_INCH, atol=1e-9)


@pytest.mark.parametrize(
    ("asf", "amc", "words"),
    [
        (
            ASF,
            AMC.replace("shin 0 0", "shin 0"),
            ["01_02.amc:7", "1 numbers of 'shin', not 2"],
        ),
        (ASF, AMC.replace("shin", "calf"), ["01_02.amc:7", "numbers of 'calf'"]),
        (ASF, AMC.replace("thigh 90", "thigh x"), ["01_02.amc", "'x' is no number"]),
        (ASF, AMC.removesuffix("shin 0 90\n"), ["01_02.amc"]),
        (ASF, AMC.replace(":DEGREES", ":RADIANS"), ["01_02.amc", "angles in radians"]),
        (ASF.replace("angle deg", "angle rad"), AMC, ["01.asf", "angles in radians"]),
        (ASF.replace("thigh shin", "thigh calf"), AMC, ["01.asf", "calf"]),
        (
            ASF.replace("name shin", "name thigh"),
            AMC,
            ["01.asf", "the bone 'thigh' twice"],
        ),
        (ASF.replace("position 0 0 0", "position 0 0 x"), AMC, ["01.asf:1:", "'x'"]),
        (ASF.replace("length 2", "length two"), AMC, ["01.asf:13", "two"]),
        (ASF.partition(":hierarchy")[0], AMC, ["01.asf", "every bone once"]),
    ],
)
def test_errors_of_acclaim_name_file_and_line(motion, asf, amc, words):
    path = motion(asf=asf, amc=amc)
    with pytest.raises(InputError) as error:
        read_shapes([path])
    assert str(error.value).startswith(f"{path.parent}/{words[0]}")
    assert all(word in str(error.value) for word in words), error.value


def test_the_skeleton_is_found_by_its_name(motion, tmp_path):
    path = motion()
    (tmp_path / "02.asf").write_text(ASF.replace("length 2", "length 20"))
    assert read_shapes([path]).as_columns()[0, 1, 1] == pytest.approx(0)
    path = path.rename(tmp_path / "walk.amc")
    with pytest.raises(InputError, match="none of the 2 skeletons beside it"):
        read_shapes([path])
    with pytest.raises(InputError, match="a skeleton without a motion"):
        read_shapes([tmp_path / "02.asf"])


# C3D, written by ezc3d


@pytest.fixture
def c3d(tmp_path):
    ezc3d = pytest.importorskip("ezc3d", reason="ezc3d is the extra `c3d`")

    def make(labels=("knee", "ankle"), n=4, channels=0, **lists):
        file = ezc3d.c3d()
        parameters = file["parameters"]["POINT"]
        parameters["LABELS"]["value"] = list(labels)
        parameters["UNITS"]["value"] = ["mm"]
        parameters["RATE"]["value"] = [100.0]
        for name, value in lists.items():
            file.add_parameter("POINT", name, value)
        points = np.ones((4, len(labels), n))
        points[:3] = np.arange(3 * len(labels) * n).reshape(3, len(labels), n)
        points[:3, -1, 2] = np.nan
        file["data"]["points"] = points
        if channels:
            file["parameters"]["ANALOG"]["RATE"]["value"] = [200.0]
            names = [f"force {number}" for number in range(channels)]
            file["parameters"]["ANALOG"]["LABELS"]["value"] = names
            file["data"]["analogs"] = np.full((1, channels, 2 * n), 700.0)
        path = tmp_path / "walk.c3d"
        file.write(str(path))
        return path, points[:3].transpose(2, 0, 1)

    return make


def test_units_rate_and_missing_points(c3d):
    path, points = c3d()
    shapes, notes = load_shapes(path)
    assert shapes.landmark_names == ("knee", "ankle")
    assert (shapes.unit, shapes.frame_rate, notes) == ("m", 100.0, ())
    assert shapes.items == ("walk/0", "walk/1", "walk/2", "walk/3")
    np.testing.assert_allclose(shapes.as_columns(), points / 1000, rtol=1e-6)
    assert np.isnan(shapes.as_columns()[2, :, 1]).all()


@pytest.mark.parametrize(
    ("labels", "names", "sequence"),
    [
        (("Ann:knee", "Ann:hip", ""), ("knee", "hip", "*2"), "walk/Ann"),
        (("Ann:knee", "Bob:knee", "hip"), ("Ann:knee", "Bob:knee", "hip"), "walk"),
    ],
)
def test_one_subject_is_the_individual(c3d, labels, names, sequence):
    shapes, _ = load_shapes(c3d(labels=labels)[0])
    assert shapes.landmark_names == names
    assert {*shapes.sequences} == {sequence}


def test_what_a_model_computed_is_no_point(c3d):
    shapes, notes = load_shapes(
        c3d(labels=("knee", "KneeAngle"), ANGLES=["KneeAngle"])[0]
    )
    assert shapes.landmark_names == ("knee",)
    assert any("KneeAngle" in note for note in notes)


def test_what_ezc3d_reads(c3d):
    """Every point, label and rate, of files with analog values and missing points."""
    import ezc3d

    for number, channels in ((2, 0), (40, 3), (300, 1)):
        labels = [f"marker {n}" for n in range(number)]
        path, _ = c3d(labels=labels, n=7, channels=channels)
        theirs = ezc3d.c3d(str(path))
        shapes, notes = load_shapes(path)
        points = theirs["data"]["points"][:3].transpose(2, 0, 1) / 1000
        np.testing.assert_array_equal(np.isnan(shapes.as_columns()), np.isnan(points))
        np.testing.assert_allclose(shapes.as_columns(), points, rtol=1e-12)
        assert shapes.landmark_names == tuple(labels)
        assert (shapes.frame_rate, notes) == (100.0, ())


def test_damaged_c3d_is_refused(c3d):
    """Cut off; and a record of a name too long, which leads anywhere."""
    path, _ = c3d()
    whole = path.read_bytes()
    place = whole.index(b"POINT") - 2
    wrong = [whole[:place] + bytes([size]) + whole[place + 1 :] for size in (127, 130)]
    for data in (whole[:600], whole[: len(whole) // 2], whole[:-500], *wrong):
        path.write_bytes(data)
        with pytest.raises(InputError, match=r"walk\.c3d: (is cut|has|cannot be read)"):
            load_shapes(path)


CONTRADICTED = "read by its header, which its parameters contradict"

USED = b"USED\x07\x00\x02\x00"
"""What stands before how many points, or analog channels, a group of C3D has."""


def changed(path, offset: int, *numbers: int) -> None:
    """Write whole numbers of two bytes into a file."""
    data = bytearray(path.read_bytes())
    struct.pack_into(f"<{len(numbers)}H", data, offset, *numbers)
    path.write_bytes(data)


def place_of(path, *words: bytes) -> int:
    """Return what follows these words, one after the other, in a file."""
    data, place = path.read_bytes(), 0
    for word in words:
        place = data.index(word, place) + len(word)
    return place


@pytest.mark.parametrize("channels", [1, 3])
def test_analog_values_that_only_the_header_counts_are_no_points(c3d, channels):
    path, points = c3d(n=60, channels=channels)
    whole, _ = load_shapes(path)
    changed(path, place_of(path, b"ANALOG", USED), 0)
    shapes, notes = load_shapes(path)
    np.testing.assert_allclose(shapes.as_columns(), points / 1000, rtol=1e-6)
    np.testing.assert_array_equal(shapes.points, whole.points)
    assert any(CONTRADICTED in note for note in notes)


def test_frames_are_as_many_as_the_file_has(c3d):
    """Not those of a longer recording, that the header names, and the parameters."""
    path, points = c3d(n=29)
    changed(path, 6, 1, 1149)
    shapes, notes = load_shapes(path)
    np.testing.assert_allclose(shapes.as_columns(), points / 1000, rtol=1e-6)
    assert notes == ()
    changed(path, place_of(path, b"FRAMES") + 4, 1149)
    path.write_bytes(path.read_bytes()[: 1536 + 29 * 2 * 16])  # without padding
    shapes, notes = load_shapes(path)
    np.testing.assert_allclose(shapes.as_columns(), points / 1000, rtol=1e-6)
    assert any("1120 frames are announced in the header" in note for note in notes)


def test_a_header_whose_frames_and_parameters_whose_channels_are_wrong(c3d):
    path, points = c3d(n=60, channels=2)
    changed(path, 6, 1, 1149)
    changed(path, place_of(path, b"ANALOG", USED), 0)
    shapes, _ = load_shapes(path)
    np.testing.assert_allclose(shapes.as_columns(), points / 1000, rtol=1e-6)


def test_points_without_parameters_are_read_by_the_header(c3d):
    path, points = c3d(n=30)
    data = path.read_bytes()
    path.write_bytes(data.replace(b"POINT", b"PXINT"))
    shapes, notes = load_shapes(path)
    np.testing.assert_allclose(shapes.as_columns(), points, rtol=1e-6)
    assert (shapes.unit, shapes.landmark_names) == ("unknown", ("*0", "*1"))
    assert any("read by its header, as its parameters state no" in n for n in notes)


def test_numbers_of_a_dec(c3d, tmp_path):
    """Their halves are exchanged, and they are four times as large."""
    path, points = c3d(n=30)
    data = bytearray(path.read_bytes())
    start = 512 * (data[16] - 1)
    places = [*range(start, len(data), 4), 12, place_of(path, b"RATE\x09\0\4\0")]
    places.append(place_of(path, b"SCALE\x09\0\4\0"))
    for place in places:
        (value,) = struct.unpack_from("<f", data, place)
        low, high = struct.unpack("<HH", struct.pack("<f", 4 * value))
        struct.pack_into("<HH", data, place, high, low)
    data[512 * (data[0] - 1) + 3] = 85
    path.write_bytes(data)
    shapes, notes = load_shapes(path)
    np.testing.assert_allclose(shapes.as_columns(), points / 1000, rtol=1e-6)
    assert (shapes.frame_rate, notes) == (100.0, ())


def write_whole_numbers(path, processor):
    """Write points (20, 4, 3) without parameters, to be times 0.5, the processor that
    writes them so named; returns them.
    """
    points = np.arange(12 * 20).reshape(20, 4, 3)
    words = np.zeros((20, 4, 4), "<i2")
    words[..., :3] = points
    words[3, 1, 3] = -1
    header = struct.pack("<HHHHHfHHf", 4, 0, 1, 20, 0, 0.5, 3, 0, 50.0)
    parts = [b"\x02\x50" + header, bytes((1, 80, 1, processor)), words.tobytes()]
    path.write_bytes(
        b"".join(part.ljust(-(-len(part) // 512) * 512, b"\0") for part in parts)
    )
    expected = 0.5 * points
    expected[3, 1] = np.nan
    return expected


def test_points_in_whole_numbers_are_read_by_the_header(tmp_path):
    path = tmp_path / "walk.c3d"
    expected = write_whole_numbers(path, 84)
    shapes, _ = load_shapes(path)
    np.testing.assert_array_equal(shapes.points, expected)
    assert shapes.frame_rate == 50
    write_whole_numbers(path, 86)
    with pytest.raises(
        InputError, match=r"of a MIPS processor.; save it in the order of"
    ):
        load_shapes(path)


@pytest.mark.parametrize("size", [-500, -300, 512, 5000])
def test_a_data_section_that_no_count_fills_is_refused(c3d, size):
    path, _ = c3d(n=200)
    data = path.read_bytes()
    path.write_bytes(data[:size] if size < 0 else data + bytes(size))
    with pytest.raises(InputError, match=r"its data section has .* bytes, and 200 fra"):
        load_shapes(path)


@pytest.mark.parametrize(
    ("axes", "problem"), [(200, "of no known kind"), (7, "USED does not fit in its")]
)
def test_parameters_beyond_their_records_are_refused(c3d, axes, problem):
    path, _ = c3d()
    data = bytearray(path.read_bytes())
    data[place_of(path, b"USED") + 3] = axes
    path.write_bytes(data)
    with pytest.raises(InputError, match=problem):
        load_shapes(path)


def test_labels_that_are_not_utf8_are_latin1(c3d):
    path, _ = c3d(labels=("ZZpaule", "Köper"))
    whole = path.read_bytes()
    path.write_bytes(whole.replace(b"ZZpaule", b"\xc9paule "))
    shapes, _ = load_shapes(path)
    assert shapes.landmark_names == ("Épaule", "Köper")


VICON = """Trajectories,,,,,,,
100,,,,,,,
,,Anna:LASI,,,Anna:RASI,,
Frame,Sub Frame,X,Y,Z,X,Y,Z
,,mm,mm,mm,mm,mm,mm
7,0,1000,2000,3000,10,20,30
8,0,1001,2001,3001,,,

"""
DEVICES = "Devices\n1000\n,,Force,,\nFrame,Sub Frame,Fx,Fy,Fz\n,,N,N,N\n7,0,1,2,3\n\n"


@pytest.mark.parametrize("before", ["", DEVICES])
def test_trajectories_of_vicon(tmp_path, before):
    path = tmp_path / "walk.csv"
    path.write_text("\ufeff" * (not before) + before + VICON.replace("\n", "\r\n"))
    shapes, notes = load_shapes(path)
    assert (shapes.landmark_names, shapes.unit, shapes.frame_rate) == (
        ("LASI", "RASI"),
        "m",
        100,
    )
    assert shapes.items == ("walk/Anna/7", "walk/Anna/8")
    np.testing.assert_allclose(shapes.points[0], [[1, 2, 3], [0.01, 0.02, 0.03]])
    assert np.isnan(shapes.as_columns()[1, :, 1]).all()
    assert notes == ()
