"""C3D: files of ezc3d, and such whose header and parameters contradict one another."""

import struct

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.errors import InputError
from tests.io.files import load_shapes


@pytest.fixture
def c3d(tmp_path):
    """Write a file by ezc3d in which the last point is missing in the third frame;
    return its path and its points (n, p, 3) in mm.
    """
    ezc3d = pytest.importorskip("ezc3d", reason="ezc3d is the extra `c3d`")

    def write(labels=("knee", "ankle"), n=4, channels=0, trial=None, **lists):
        file = ezc3d.c3d()
        parameters = file["parameters"]["POINT"]
        parameters["LABELS"]["value"] = list(labels)
        parameters["UNITS"]["value"] = ["mm"]
        parameters["RATE"]["value"] = [100.0]
        for name, value in lists.items():
            file.add_parameter("POINT", name, value)
        for name, value in (trial or {}).items():
            file.add_parameter("TRIAL", name, value)
        coordinates = np.arange(3.0 * len(labels) * n).reshape(3, len(labels), n)
        coordinates[:, -1, 2] = np.nan
        homogeneous = np.ones((4, len(labels), n))
        homogeneous[:3] = coordinates
        file["data"]["points"] = homogeneous
        if channels:
            add_analog_values(file, channels, n)
        path = tmp_path / "walk.c3d"
        file.write(str(path))
        return path, coordinates.transpose(2, 1, 0)

    return write


def add_analog_values(file, channels, n):
    """Add so many channels, of two values a frame."""
    parameters = file["parameters"]["ANALOG"]
    parameters["RATE"]["value"] = [200.0]
    parameters["LABELS"]["value"] = [f"force {number}" for number in range(channels)]
    file["data"]["analogs"] = np.full((1, channels, 2 * n), 700.0)


def test_units_rate_and_missing_points(c3d, check_points):
    path, points = c3d()
    shapes, notes = load_shapes(path)
    assert shapes.landmark_names == ("knee", "ankle")
    assert shapes.items == ("walk/0", "walk/1", "walk/2", "walk/3")
    assert shapes.unit == "m"
    assert shapes.frame_rate == 100.0
    assert notes == ()
    check_points(shapes, points / 1000)
    assert np.isnan(shapes.shapes[2, 1]).all()


SUBJECTS = [
    (("Ann:knee", "Ann:hip", ""), ("knee", "hip", "*2"), "walk/Ann"),
    (("Ann:knee", "Bob:knee", "hip"), ("Ann:knee", "Bob:knee", "hip"), "walk"),
]
"""Labels, the names of landmarks, and the sequence."""


@pytest.mark.parametrize(("labels", "names", "sequence"), SUBJECTS)
def test_one_subject_is_the_individual(c3d, labels, names, sequence):
    path, _ = c3d(labels=labels)
    shapes, _ = load_shapes(path)
    assert shapes.landmark_names == names
    assert set(shapes.sequences) == {sequence}


def test_what_a_model_computed_is_no_point(c3d):
    path, _ = c3d(labels=("knee", "KneeAngle"), ANGLES=["KneeAngle"])
    shapes, notes = load_shapes(path)
    assert shapes.landmark_names == ("knee",)
    assert any("KneeAngle" in note for note in notes)


@pytest.mark.parametrize(("count", "channels"), [(2, 0), (40, 3), (300, 1)])
def test_what_ezc3d_reads(c3d, count, channels):
    """Every point, label and rate, of files with analog values and missing points."""
    import ezc3d

    labels = tuple(f"marker {number}" for number in range(count))
    path, _ = c3d(labels=labels, n=7, channels=channels)
    homogeneous = ezc3d.c3d(str(path))["data"]["points"]
    expected = homogeneous[:3].transpose(2, 1, 0) / 1000
    shapes, notes = load_shapes(path)
    assert_array_equal(np.isnan(shapes.shapes), np.isnan(expected))
    assert_allclose(shapes.shapes, expected, rtol=1e-12)
    assert shapes.landmark_names == labels
    assert shapes.frame_rate == 100.0
    assert notes == ()


CONTRADICTED = "read by its header, which its parameters contradict"

USED = b"USED\x07\x00\x02\x00"
"""What stands before how many points, or analog channels, a group of C3D has."""


def changed(path, offset: int, *numbers: int) -> None:
    """Write whole numbers of two bytes into a file."""
    data = bytearray(path.read_bytes())
    struct.pack_into(f"<{len(numbers)}H", data, offset, *numbers)
    path.write_bytes(data)


def check_damage_is_told(path):
    with pytest.raises(InputError, match=r"walk\.c3d: (is cut|has|cannot be read)"):
        load_shapes(path)


CUTS = {
    "behind the header": lambda data: data[:600],
    "in the middle": lambda data: data[: len(data) // 2],
    "before the end": lambda data: data[:-500],
}


@pytest.mark.parametrize("cut", CUTS.values(), ids=CUTS)
def test_c3d_that_is_cut_off_is_refused(c3d, cut):
    path, _ = c3d()
    data = path.read_bytes()
    path.write_bytes(cut(data))
    check_damage_is_told(path)


@pytest.mark.parametrize("size", [127, 130])
def test_a_name_that_is_too_long_leads_nowhere(c3d, size):
    path, _ = c3d()
    data = bytearray(path.read_bytes())
    place_of_size = data.index(b"POINT") - 2
    data[place_of_size] = size
    path.write_bytes(data)
    check_damage_is_told(path)


BLOCK_SIZE = 512
"""Bytes of a block, in which C3D counts."""


def end_of_parameters(data: bytes) -> int:
    """Return where the record without a name is, that ends the parameters."""
    place = BLOCK_SIZE * (data[0] - 1) + 4
    while data[place]:
        (length,) = struct.unpack_from("b", data, place)
        end_of_name = place + 2 + abs(length)
        (following,) = struct.unpack_from("<H", data, end_of_name)
        place = end_of_name + following
    return place


def group_record(number: int, size: int) -> bytes:
    """Return the record of a group of so many bytes, most of them its description."""
    head = struct.pack("bb", 1, -number) + b"A"
    description = b"d" * (size - len(head) - 3)
    return head + struct.pack("<HB", size - len(head), len(description)) + description


@pytest.mark.parametrize("size_of_last", [7, 8, 60])
def test_parameters_may_fill_their_section_to_its_last_byte(
    c3d, check_points, size_of_last
):
    path, points = c3d()
    data = bytearray(path.read_bytes())
    place = end_of_parameters(data)
    (block_of_data,) = struct.unpack_from("<H", data, 16)
    room = BLOCK_SIZE * (block_of_data - 1) - place - size_of_last
    sizes = [100] * (room // 100 - 1) + [100 + room % 100, size_of_last]
    records = [group_record(50 + i, size) for i, size in enumerate(sizes)]
    data[place : place + sum(sizes)] = b"".join(records)
    path.write_bytes(data)

    shapes, notes = load_shapes(path)

    check_points(shapes, points / 1000)
    assert notes == ()


FRAMES_OF_HEADER = 6
"""Where the header says the first and the last frame."""


def place_of(path, *words: bytes) -> int:
    """Return what follows these words, one after the other, in a file."""
    data = path.read_bytes()
    place = 0
    for word in words:
        place = data.index(word, place) + len(word)
    return place


def state_no_channels(path):
    """Let the parameters say that there are no analog values."""
    changed(path, place_of(path, b"ANALOG", USED), 0)


@pytest.mark.parametrize("channels", [1, 3])
def test_analog_values_that_only_the_header_counts_are_no_points(
    c3d, check_points, channels
):
    path, points = c3d(n=60, channels=channels)
    whole, _ = load_shapes(path)
    state_no_channels(path)
    shapes, notes = load_shapes(path)
    check_points(shapes, points / 1000)
    assert_array_equal(shapes.shapes, whole.shapes)
    assert any(CONTRADICTED in note for note in notes)


def test_frames_that_only_the_header_announces_are_none(c3d, check_points):
    """As many are read as the file has, not those of a longer recording."""
    path, points = c3d(n=29)
    changed(path, FRAMES_OF_HEADER, 1, 1149)
    shapes, notes = load_shapes(path)
    check_points(shapes, points / 1000)
    assert notes == ()


def announce(path, count):
    """Let the header and the parameters of points announce so many frames."""
    changed(path, FRAMES_OF_HEADER, 1, count)
    changed(path, place_of(path, b"POINT", b"FRAMES") + 4, count)


def test_frames_that_only_the_parameters_announce_are_none(c3d, check_points):
    path, points = c3d(n=29)
    changed(path, place_of(path, b"POINT", b"FRAMES") + 4, 1149)
    shapes, notes = load_shapes(path)
    check_points(shapes, points / 1000)
    assert notes == ()


REVERSED = {"ACTUAL_START_FIELD": [29, 0], "ACTUAL_END_FIELD": [1, 0]}
"""A trial whose last frame is before its first."""


@pytest.mark.parametrize("trial", [None, REVERSED])
def test_frames_that_header_and_parameters_announce_are_none(c3d, check_points, trial):
    path, points = c3d(n=29, trial=trial)
    announce(path, 1149)
    start = 512 * (path.read_bytes()[16] - 1)
    data_section = 29 * 2 * 16
    without_padding = path.read_bytes()[: start + data_section]
    path.write_bytes(without_padding)
    shapes, notes = load_shapes(path)
    check_points(shapes, points / 1000)
    assert any("1120 frames are announced in the header" in note for note in notes)


ACTUAL_FIELDS = [
    ([1, 0], [60, 0]),
    ([65_530, 0], [53, 1]),  # to 65 589, in two halves
    ([3, 2], [62, 2]),
]
"""The first and the last of 60 frames, as the group TRIAL states them."""


@pytest.mark.parametrize(("first", "last"), ACTUAL_FIELDS)
def test_frames_are_those_of_the_trial_where_other_counts_are_too_small(
    c3d, check_points, first, last
):
    """As those of long recordings are, which two bytes cannot count."""
    trial = {"ACTUAL_START_FIELD": first, "ACTUAL_END_FIELD": last}
    path, points = c3d(n=60, trial=trial)
    announce(path, 20)
    shapes, notes = load_shapes(path)
    check_points(shapes, points / 1000)
    assert notes == ()


@pytest.mark.parametrize(
    "trial",
    [
        {"ACTUAL_START_FIELD": [1, 0]},
        {"ACTUAL_START_FIELD": [1], "ACTUAL_END_FIELD": [60]},
        REVERSED,
    ],
)
def test_a_trial_without_both_ends_says_nothing(c3d, check_points, trial):
    path, points = c3d(n=60, trial=trial)
    shapes, notes = load_shapes(path)
    check_points(shapes, points / 1000)
    assert notes == ()
    announce(path, 20)
    with pytest.raises(InputError, match=r"its data section has .* bytes, and 20 fra"):
        load_shapes(path)


def test_a_header_whose_frames_and_parameters_whose_channels_are_wrong(
    c3d, check_points
):
    path, points = c3d(n=60, channels=2)
    changed(path, FRAMES_OF_HEADER, 1, 1149)
    state_no_channels(path)
    shapes, _ = load_shapes(path)
    check_points(shapes, points / 1000)


def test_points_without_parameters_are_read_by_the_header(c3d, check_points):
    path, points = c3d(n=30)
    without_group = path.read_bytes().replace(b"POINT", b"PXINT")
    path.write_bytes(without_group)
    shapes, notes = load_shapes(path)
    note = "read by its header, as its parameters state no"
    check_points(shapes, points)
    assert shapes.unit == "unknown"
    assert shapes.landmark_names == ("*0", "*1")
    assert any(note in line for line in notes)


def as_dec(data: bytearray, place: int) -> None:
    """Write a number of an Intel processor as a DEC has it: its halves exchanged, and
    four times as large.
    """
    (value,) = struct.unpack_from("<f", data, place)
    low, high = struct.unpack("<HH", struct.pack("<f", 4 * value))
    struct.pack_into("<HH", data, place, high, low)


def test_numbers_of_a_dec(c3d, check_points):
    path, points = c3d(n=30)
    data = bytearray(path.read_bytes())
    parameters = 512 * (data[0] - 1)
    start = 512 * (data[16] - 1)
    as_dec(data, 12)
    as_dec(data, place_of(path, b"RATE\x09\0\4\0"))
    as_dec(data, place_of(path, b"SCALE\x09\0\4\0"))
    for place in range(start, len(data), 4):
        as_dec(data, place)
    data[parameters + 3] = DEC
    path.write_bytes(data)
    shapes, notes = load_shapes(path)
    check_points(shapes, points / 1000)
    assert shapes.frame_rate == 100.0
    assert notes == ()


INTEL = 84


DEC = 85


MIPS = 86
"""Processors, as the fourth byte of the parameters names them."""


def write_whole_numbers(path, processor):
    """Write points (20, 4, 3) without parameters, to be times 0.5, the processor that
    writes them so named; returns them.
    """
    points = np.arange(12 * 20).reshape(20, 4, 3)
    words = np.zeros((20, 4, 4), "<i2")
    words[..., :3] = points
    words[3, 1, 3] = -1
    numbers = struct.pack("<HHHHHfHHf", 4, 0, 1, 20, 0, 0.5, 3, 0, 50.0)
    header = b"\x02\x50" + numbers
    parameters = bytes((1, 80, 1, processor))
    blocks = [in_blocks(part) for part in (header, parameters, words.tobytes())]
    path.write_bytes(b"".join(blocks))
    expected = 0.5 * points
    expected[3, 1] = np.nan
    return expected


def in_blocks(part: bytes) -> bytes:
    """Fill a part of a file with zeros, to whole blocks of 512 bytes."""
    block_count = -(-len(part) // 512)
    return part.ljust(block_count * 512, b"\0")


def test_points_in_whole_numbers_are_read_by_the_header(tmp_path):
    path = tmp_path / "walk.c3d"
    expected = write_whole_numbers(path, INTEL)
    shapes, _ = load_shapes(path)
    assert_array_equal(shapes.shapes, expected)
    assert shapes.frame_rate == 50


def test_numbers_of_a_mips_processor_are_refused(tmp_path):
    path = tmp_path / "walk.c3d"
    write_whole_numbers(path, MIPS)
    fault = r"of a MIPS processor.; save it in the order of"
    with pytest.raises(InputError, match=fault):
        load_shapes(path)


def test_counts_below_and_beyond_the_frames_that_there_are_are_refused(c3d):
    path, _ = c3d(n=29)
    changed(path, FRAMES_OF_HEADER, 1, 1149)
    changed(path, place_of(path, b"POINT", b"FRAMES") + 4, 5)
    with pytest.raises(InputError, match=r"its data section has .* bytes, and 5 fra"):
        load_shapes(path)


@pytest.mark.parametrize("change", [-500, -300, 512, 5000])
def test_a_data_section_that_no_count_fills_is_refused(c3d, change):
    path, _ = c3d(n=200)
    data = path.read_bytes()
    changed_data = data[:change] if change < 0 else data + bytes(change)
    path.write_bytes(changed_data)
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
