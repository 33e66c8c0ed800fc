"""The tables of films, and which films a page does not take."""

import struct
from base64 import b64decode
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.errors import InputError
from shapefit.pipelines.view import film
from shapefit.pipelines.view.film import read_mp4, read_webm

FILMS = Path(__file__).parents[2] / "viewer/films"
COUNT = 36

NUMBERS = np.arange(COUNT)
UNEVEN = 0.3 * (NUMBERS % 3)
PAUSE = 6 * (NUMBERS >= 12)
STARTS = {"constant": NUMBERS / 25, "variable": (NUMBERS + UNEVEN + PAUSE) / 25}
"""As the films were made; in their files in milliseconds."""


def read(path):
    reader = read_webm if path.suffix == ".webm" else read_mp4
    return reader(path.read_bytes())


@pytest.mark.parametrize("suffix", [".mp4", ".webm"])
@pytest.mark.parametrize(("name", "starts"), STARTS.items(), ids=STARTS)
def test_the_times_of_frames_are_those_of_the_film(name, suffix, starts):
    table = read(FILMS / f"{name}{suffix}")
    assert table.fault == ""
    assert_allclose(table.starts, starts, atol=1.01e-3)
    assert starts[-1] < table.end < starts[-1] + 0.1


def box(name, *content):
    inner = b"".join(content)
    header = struct.pack(">I4s", 8 + len(inner), name.encode())
    return header + inner


def rows(kind, *numbers):
    """A table of pairs of numbers of a kind of `struct`."""
    count = len(numbers)
    return struct.pack(f">II{count}{kind}", 0, count // 2, *numbers)


def made_film(edits=b"", offsets=b"", codec=b"avc1", durations=(4, 10)):
    """An MP4 of four frames of 10 ticks, 100 a second; a movie has 50 a second."""
    entry = struct.pack(">I4s", 86, codec) + bytes(78)
    codecs = box("stsd", struct.pack(">II", 0, 1), entry)
    tables = box("stbl", codecs, box("stts", rows("I", *durations)), offsets)
    clock = box("mdhd", struct.pack(">IIIII", 0, 0, 0, 100, 40))
    video = box("hdlr", bytes(8), b"vide")
    pictures = box("trak", edits, box("mdia", clock, video, box("minf", tables)))
    sound = box("trak", box("mdia", box("hdlr", bytes(8), b"soun")))
    movie = box("mvhd", struct.pack(">IIIII", 0, 0, 0, 50, 20))
    return box("ftyp", b"isom") + box("moov", movie, sound, pictures) + bytes(100)


def edit_list(*entries):
    """Of (duration in ticks of the movie, start in ticks of the track; -1: empty)."""
    count = struct.pack(">II", 0, len(entries))
    edits = [struct.pack(">IiI", *entry, 1 << 16) for entry in entries]
    return box("edts", box("elst", count, *edits))


B_FRAMES = box("ctts", rows("i", 1, 10, 1, 30, 1, 0, 1, 0))
"""Shown at 10, 40, 20, 30 ticks."""


FROM_THE_FIRST = edit_list((20, 10))
TWO_FRAMES_CUT_OFF = edit_list((20, 20))
AFTER_A_PAUSE = edit_list((25, -1), (20, 0))
TIMES = [
    ({}, [0, 0.1, 0.2, 0.3], 0.4),
    ({"offsets": B_FRAMES}, [0.1, 0.2, 0.3, 0.4], 0.5),
    ({"offsets": B_FRAMES, "edits": FROM_THE_FIRST}, [0, 0.1, 0.2, 0.3], 0.4),
    ({"edits": TWO_FRAMES_CUT_OFF}, [0, 0.1], 0.2),
    ({"edits": AFTER_A_PAUSE}, [0.5, 0.6, 0.7, 0.8], 0.9),
    ({"durations": (1, 10, 3, 20)}, [0, 0.1, 0.3, 0.5], 0.7),
]
"""Tables of a film, and the times of its frames and of its end in seconds."""


@pytest.mark.parametrize(("keys", "starts", "end"), TIMES)
def test_offsets_and_edits_move_the_times(keys, starts, end):
    table = read_mp4(made_film(**keys))
    assert_allclose(table.starts, starts, atol=1e-12)
    assert table.end == pytest.approx(end)


TWO_PARTS = edit_list((5, 0), (5, 20))
FAULTS = [
    ({"codec": b"mp4v"}, "has the codec 'mp4v', which not all browsers play"),
    ({"codec": b"hvc1"}, "has the codec 'hvc1', which not all browsers play"),
    ({"durations": ()}, "is in fragments"),
    ({"edits": TWO_PARTS}, "is cut together from several parts"),
]


@pytest.mark.parametrize(("keys", "fault"), FAULTS)
def test_films_that_cannot_be_followed(keys, fault):
    table = read_mp4(made_film(**keys))
    assert table.fault.startswith(fault)


def test_colours_of_full_size_are_not_played_by_all():
    table = read(FILMS / "colours.mp4")
    assert "4:4:4" in table.fault


@pytest.fixture
def walk(desk):
    """36 frames of one video, and a function that gives their page a film."""

    def view(path, n=COUNT, **keys):
        names = {
            "items": tuple(f"walk/{i:03d}" for i in range(n)),
            "sequences": ("walk",) * n,
        }
        result = desk.result(n=n, **(names | keys))
        return desk.view(result, images=path)

    return view


def notes_on_film(made):
    return [note for note in made.outcome.warnings if "constant" in note]


def numbers_in(block):
    """The numbers of a block of the data of a page."""
    return np.frombuffer(b64decode(block["data"]), "<f4")


def test_the_film_is_in_the_page(walk):
    path = FILMS / "variable.mp4"
    made = walk(path)
    shown = made.data["film"]
    places = numbers_in(shown["places"])
    starts = numbers_in(shown["starts"])
    assert notes_on_film(made) == []
    assert shown["kind"] == "video/mp4"
    assert b64decode(shown["data"]) == path.read_bytes()
    assert_array_equal(places, NUMBERS)
    assert len(starts) == COUNT + 1


def test_frames_that_the_files_state_are_those_of_the_film(walk):
    frames = np.arange(30) + 4
    made = walk(FILMS / "constant.mp4", n=30, frames=frames)
    places = numbers_in(made.data["film"]["places"])
    assert_array_equal(places, frames)
    note = "constant.mp4 has 36 frames, the landmarks end at frame 34."
    assert notes_on_film(made) == [note]


def test_a_film_shorter_than_the_landmarks_is_said(walk):
    made = walk(FILMS / "constant.webm", n=40)
    places = numbers_in(made.data["film"]["places"])
    (note,) = notes_on_film(made)
    assert_array_equal(np.isnan(places), np.arange(40) >= 36)
    assert note == (
        "constant.webm has 36 frames, the landmarks go to frame 40: 4 of them are shown"
        " without it. Is it the same film?"
    )


@pytest.fixture
def refused(walk, desk):
    """Check that a film is refused with a fault, and that no page is written."""

    def check(path, fault, **keys):
        with pytest.raises(InputError, match=fault):
            walk(path, **keys)
        assert not (desk.folder / "page.html").exists()

    return check


def test_a_film_that_browsers_do_not_play_is_refused(refused, desk):
    path = desk.folder / "my film.avi"
    path.write_bytes(b"RIFF")
    command = r"ffmpeg -i 'my film.avi' -pix_fmt yuv420p -an 'my film_page.mp4'"
    fault = f"is no film that browsers play .*; convert it: `{command}`"
    refused(path, fault)


def test_a_damaged_film_is_refused(refused, desk):
    path = desk.folder / "damaged.mp4"
    without_times = made_film()[:-110].replace(b"stts", b"sttx")
    path.write_bytes(without_times)
    refused(path, "is damaged: .*; convert it: `ffmpeg -i damaged.mp4")


def test_an_empty_film_is_refused(refused, desk):
    path = desk.folder / "empty.webm"
    path.write_bytes(b"")
    fault = "holds no film that can be read; convert it: `ffmpeg -i empty.webm"
    refused(path, fault)


def test_a_film_with_colours_of_full_size_is_refused(refused):
    fault = "4:4:4.*ffmpeg -i colours.mp4 -pix_fmt yuv420p"
    refused(FILMS / "colours.mp4", fault)


def test_a_film_that_is_not_there_is_refused(refused, desk):
    refused(desk.folder / "none.mp4", "there is no such file")


def test_a_film_of_other_frames_is_refused(refused):
    frames = np.arange(3) + 50
    fault = "has 36 frames, and none of the landmarks"
    refused(FILMS / "constant.mp4", fault, n=3, frames=frames)


SIZE = (FILMS / "constant.mp4").stat().st_size


def test_a_film_may_have_as_many_bytes_as_a_page_holds(walk, monkeypatch):
    monkeypatch.setattr(film, "MAX_FILM_BYTES", SIZE)
    assert "film" in walk(FILMS / "constant.mp4").data


def test_a_film_that_is_too_large_for_a_page_is_refused(refused, monkeypatch):
    monkeypatch.setattr(film, "MAX_FILM_BYTES", SIZE - 1)
    fault = r"a page holds 0; .* -vf scale=960:-2 -crf 28"
    refused(FILMS / "constant.mp4", fault)


def test_one_film_is_of_one_recording(refused):
    half = COUNT // 2
    of_two = {
        "items": tuple(f"v{i // half}/{i % half}" for i in range(COUNT)),
        "sequences": ("v0",) * half + ("v1",) * half,
    }
    fault = r"of 2 recordings; .*`items`, such as 'v0/\*'"
    refused(FILMS / "constant.mp4", fault, **of_two)


@pytest.mark.parametrize("name", ["constant.mp4", "variable.webm"])
def test_damaged_films_are_refused_or_read(walk, desk, rng, name):
    """A film with some wrong bytes is refused in words, or shown."""
    whole = bytearray((FILMS / name).read_bytes())
    frames = np.arange(float(COUNT))
    path = desk.folder / name
    for _ in range(60):
        spoilt = whole.copy()
        for place in rng.integers(0, len(whole), 12):
            spoilt[place] = rng.integers(0, 256)
        end = rng.integers(1, len(whole))
        path.write_bytes(spoilt[:end])
        with suppress(InputError):
            film.embed_film(path, frames)
