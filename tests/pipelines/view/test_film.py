"""The tables of films, and which films a page does not take."""

import struct
from base64 import b64decode
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from shapefit.errors import InputError
from shapefit.pipelines.view import film
from shapefit.pipelines.view.film import read_mp4, read_webm

FILMS = Path(__file__).parents[2] / "viewer/films"
COUNT = 36

CONSTANT = np.arange(COUNT) / 25
number = np.arange(COUNT)
VARIABLE = (number + 0.3 * (number % 3) + 6 * (number >= 12)) / 25
"""As the films were made; in their files in milliseconds."""


def read(path):
    reader = read_webm if path.suffix == ".webm" else read_mp4
    return reader(path.read_bytes())


@pytest.mark.parametrize("suffix", [".mp4", ".webm"])
@pytest.mark.parametrize(
    ("name", "starts"), [("constant", CONSTANT), ("variable", VARIABLE)]
)
def test_the_times_of_frames_are_those_of_the_film(name, suffix, starts):
    table = read(FILMS / f"{name}{suffix}")
    assert table.fault == ""
    np.testing.assert_allclose(table.starts, starts, atol=1.01e-3)
    assert starts[-1] < table.end < starts[-1] + 0.1


def box(name, *content):
    inner = b"".join(content)
    return struct.pack(">I4s", 8 + len(inner), name.encode()) + inner


def rows(kind, *numbers):
    return struct.pack(f">II{len(numbers)}{kind}", 0, len(numbers) // 2, *numbers)


def made_film(edits=b"", offsets=b"", codec=b"avc1", durations=(4, 10)):
    """An MP4 of four frames of 10 ticks, 100 a second; a movie has 50 a second."""
    header = struct.pack(">IIIII", 0, 0, 0, 100, 40)
    entry = struct.pack(">I4s", 86, codec) + bytes(78)
    tables = box(
        "stbl",
        box("stsd", struct.pack(">II", 0, 1) + entry),
        box("stts", rows("I", *durations)),
        offsets,
    )
    sound = box("trak", box("mdia", box("hdlr", bytes(8) + b"soun")))
    track = box(
        "trak",
        edits,
        box(
            "mdia",
            box("mdhd", header),
            box("hdlr", bytes(8) + b"vide"),
            box("minf", tables),
        ),
    )
    movie = box("mvhd", struct.pack(">IIIII", 0, 0, 0, 50, 20))
    return box("ftyp", b"isom") + box("moov", movie, sound, track) + bytes(100)


def edit_list(*entries):
    numbers = [number for entry in entries for number in (*entry, 1 << 16)]
    table = struct.pack(f">II{'IiI' * len(entries)}", 0, len(entries), *numbers)
    return box("edts", box("elst", table))


B_FRAMES = box("ctts", rows("i", 1, 10, 1, 30, 1, 0, 1, 0))
"""Shown at 10, 40, 20, 30 ticks."""


@pytest.mark.parametrize(
    ("keys", "starts", "end"),
    [
        ({}, [0, 0.1, 0.2, 0.3], 0.4),
        ({"offsets": B_FRAMES}, [0.1, 0.2, 0.3, 0.4], 0.5),
        ({"offsets": B_FRAMES, "edits": edit_list((20, 10))}, [0, 0.1, 0.2, 0.3], 0.4),
        ({"edits": edit_list((20, 20))}, [0, 0.1], 0.2),  # two frames are cut off
        ({"edits": edit_list((25, -1), (20, 0))}, [0.5, 0.6, 0.7, 0.8], 0.9),
        ({"durations": (1, 10, 3, 20)}, [0, 0.1, 0.3, 0.5], 0.7),
    ],
)
def test_offsets_and_edits_move_the_times(keys, starts, end):
    table = read_mp4(made_film(**keys))
    np.testing.assert_allclose(table.starts, starts, atol=1e-12)
    assert table.end == pytest.approx(end)


@pytest.mark.parametrize(
    ("keys", "fault"),
    [
        ({"codec": b"mp4v"}, "has the codec 'mp4v', which not all browsers play"),
        ({"codec": b"hvc1"}, "has the codec 'hvc1', which not all browsers play"),
        ({"durations": ()}, "is in fragments"),
        ({"edits": edit_list((5, 0), (5, 20))}, "is cut together from several parts"),
    ],
)
def test_films_that_cannot_be_followed(keys, fault):
    assert read_mp4(made_film(**keys)).fault.startswith(fault)


def test_colours_of_full_size_are_not_played_by_all():
    assert "4:4:4" in read(FILMS / "colours.mp4").fault


@pytest.fixture
def walk(desk):
    """36 frames of one video, and a function that gives their page a film."""

    def view(path, n=COUNT, **keys):
        names = {
            "items": tuple(f"walk/{i:03d}" for i in range(n)),
            "sequences": ("walk",) * n,
        }
        return desk.view(desk.result(n=n, **(names | keys)), images=path)

    return view


def notes_on_film(made):
    return [note for note in made.outcome.warnings if "constant" in note]


def test_the_film_is_in_the_page(walk):
    path = FILMS / "variable.mp4"
    made = walk(path)
    shown = made.data["film"]
    assert notes_on_film(made) == []
    assert shown["kind"] == "video/mp4"
    assert b64decode(shown["data"]) == path.read_bytes()
    places = np.frombuffer(b64decode(shown["places"]["data"]), "<f4")
    np.testing.assert_array_equal(places, np.arange(COUNT))
    starts = np.frombuffer(b64decode(shown["starts"]["data"]), "<f4")
    assert len(starts) == COUNT + 1


def test_frames_that_the_files_state_are_those_of_the_film(walk):
    frames = np.arange(30) + 4
    made = walk(FILMS / "constant.mp4", n=30, frames=frames)
    places = np.frombuffer(b64decode(made.data["film"]["places"]["data"]), "<f4")
    np.testing.assert_array_equal(places, frames)
    note = "constant.mp4 has 36 frames, the landmarks end at frame 34."
    assert notes_on_film(made) == [note]


def test_a_film_shorter_than_the_landmarks_is_said(walk):
    made = walk(FILMS / "constant.webm", n=40)
    (note,) = notes_on_film(made)
    assert note == (
        "constant.webm has 36 frames, the landmarks go to frame 40: 4 of them are shown"
        " without it. Is it the same film?"
    )


def test_films_that_a_page_does_not_take(walk, desk, monkeypatch):
    damaged = desk.folder / "damaged.mp4"
    damaged.write_bytes(made_film()[:-110].replace(b"stts", b"sttx"))
    empty = desk.folder / "empty.webm"
    empty.write_bytes(b"")
    other = desk.folder / "my film.avi"
    other.write_bytes(b"RIFF")
    line = (
        r"convert it: `ffmpeg -i 'my film.avi' -pix_fmt yuv420p -an 'my film_page.mp4'`"
    )
    for path, fault in (
        (other, f"is no film that browsers play .*; {line}"),
        (damaged, "is damaged: .*; convert it: `ffmpeg -i damaged.mp4"),
        (empty, "holds no film that can be read; convert it: `ffmpeg -i empty.webm"),
        (FILMS / "colours.mp4", "4:4:4.*ffmpeg -i colours.mp4 -pix_fmt yuv420p"),
        (desk.folder / "none.mp4", "there is no such file"),
    ):
        with pytest.raises(InputError, match=fault):
            walk(path)
    with pytest.raises(InputError, match="has 36 frames, and none of the landmarks"):
        walk(FILMS / "constant.mp4", n=3, frames=np.arange(3) + 50)
    monkeypatch.setattr(film, "MAX_FILM_BYTES", 1000)
    with pytest.raises(
        InputError, match=r"a page holds 0; .* -vf scale=960:-2 -crf 28"
    ):
        walk(FILMS / "constant.mp4")
    assert not (desk.folder / "page.html").exists()


def test_one_film_is_of_one_recording(walk):
    names = {
        "items": tuple(f"v{i // 18}/{i % 18}" for i in range(COUNT)),
        "sequences": tuple(f"v{i // 18}" for i in range(COUNT)),
    }
    with pytest.raises(
        InputError, match=r"of 2 recordings; .*`items`, such as 'v0/\*'"
    ):
        walk(FILMS / "constant.mp4", **names)


@pytest.mark.parametrize("name", ["constant.mp4", "variable.webm"])
def test_damaged_films_are_refused_or_read(walk, desk, rng, name):
    """A film with some wrong bytes is refused in words, or shown."""
    whole = bytearray((FILMS / name).read_bytes())
    path = desk.folder / name
    for _ in range(60):
        spoilt = whole.copy()
        for place in rng.integers(0, len(whole), 12):
            spoilt[place] = rng.integers(0, 256)
        path.write_bytes(spoilt[: rng.integers(1, len(whole))])
        with suppress(InputError):
            film.embed_film(path, np.arange(float(COUNT)))
