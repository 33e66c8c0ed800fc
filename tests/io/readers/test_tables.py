"""Tables of no known tool: what is read does not depend on how it is written down."""

from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shapefit.errors import InputError

from .conftest import read_images as read

NUMBERS = st.integers(2000, 900_000).map(lambda n: n / 1000)
NAMES = ("nose", "tail", "left ear", "paw")


@dataclass(frozen=True)
class Scene:
    """Points (n, p, 2) and scores (n, p) of frames (n,) of videos (n,); known (n, p)."""

    points: np.ndarray
    scores: np.ndarray
    known: np.ndarray
    frames: list[int]
    videos: list[str]
    names: list[str]


@st.composite
def scenes(draw) -> Scene:
    """One or two videos, of a frame at least in which a landmark is known."""
    videos = [name for name in ("b", "a")[: draw(st.integers(1, 2))] for _ in range(2)]
    n, p = len(videos), draw(st.integers(2, 4))
    values = draw(st.lists(NUMBERS, min_size=2 * n * p, max_size=2 * n * p))
    scores = draw(st.lists(st.integers(1, 8), min_size=n * p, max_size=n * p))
    lost = draw(st.lists(st.booleans(), min_size=n * p, max_size=n * p))
    known = ~np.array(lost).reshape(n, p)
    known[:, draw(st.integers(0, p - 1))] = True
    known[0] = True  # numbers of landmarks are those that occur
    first = draw(st.integers(0, 500))
    numbered = draw(st.booleans())
    return Scene(
        np.array(values).reshape(n, p, 2),
        np.array(scores).reshape(n, p) / 8,
        known,
        [first + 3 * number + 7 * (name == "b") for number, name in enumerate(videos)],
        videos,
        [str(j) for j in range(p)] if numbered else list(NAMES[:p]),
    )


@dataclass(frozen=True)
class Dress:
    """How a table is written: of rows or of columns, in which order, with which letters."""

    long: bool
    delimiter: str
    comma: bool
    order: int
    empty: str
    end: str

    def cell(self, value: float) -> str:
        return str(value).replace(".", ",") if self.comma else str(value)

    def table(self, scene: Scene) -> str:
        """Return the text, its rows and columns in an order of its own."""
        rng = np.random.default_rng(self.order)
        rows = self._long(scene, rng) if self.long else self._wide(scene)
        header, *body = rows
        columns = rng.permutation(len(header))
        lines = [header, *(body[row] for row in rng.permutation(len(body)))]
        if not self.long:
            lines = [header, *body]
        return self.end.join(self.delimiter.join(line[c] for c in columns) for line in lines)

    def _long(self, scene: Scene, rng: np.random.Generator) -> list[list[str]]:
        rows = [["Video", "frame", "BodyPart".lower(), "x", "Y", "likelihood"]]
        for i, j in np.ndindex(*scene.known.shape):
            x, y = map(self.cell, scene.points[i, j].tolist())
            if not scene.known[i, j]:
                if rng.random() < 0.5:
                    continue  # a landmark without a row is missing, as one with empty cells
                x = self.empty
            score = self.cell(scene.scores[i, j])
            rows.append([scene.videos[i], str(scene.frames[i]), scene.names[j], x, y, score])
        return rows

    def _wide(self, scene: Scene) -> list[list[str]]:
        numbered = scene.names[0] == "0"
        named = "{1}{0}" if numbered else "{0}_{1}"
        roles = ("x", "y", "v") if numbered else ("x", "y", "score")
        rows = [["clip", "Frame", *(named.format(n, r) for n in scene.names for r in roles)]]
        for i, (video, frame) in enumerate(zip(scene.videos, scene.frames, strict=True)):
            cells = []
            for j, known in enumerate(scene.known[i]):
                x, y = map(self.cell, scene.points[i, j].tolist())
                cells += [x if known else self.empty, y, self.cell(scene.scores[i, j])]
            rows.append([video, str(frame), *cells])
        return rows


dresses = st.builds(
    Dress,
    long=st.booleans(),
    delimiter=st.sampled_from(",;\t"),
    comma=st.booleans(),
    order=st.integers(0, 10_000),
    empty=st.sampled_from(["", "NaN", "na", " "]),
    end=st.sampled_from(["\n", "\r\n"]),
).filter(lambda dress: not (dress.comma and dress.delimiter == ","))


@settings(max_examples=150)
@given(scene=scenes(), dress=dresses)
def test_order_delimiters_and_decimal_commas_do_not_matter(scene, dress):
    with TemporaryDirectory() as folder:
        path = Path(folder) / "t.csv"
        path.write_text(dress.table(scene), encoding="utf-8", newline="")
        numbered = {"keypoints": "numbered"} if scene.names[0] == "0" else {}
        images, notes = read(path, **numbered)
    assert notes == ()
    assert sorted(images.landmark_names) == sorted(scene.names)
    column = [images.landmark_names.index(name) for name in scene.names]
    if scene.names[0] == "0":
        assert column == list(range(len(column)))
    starts = {v: min(f for f, w in zip(scene.frames, scene.videos, strict=True) if w == v)
              for v in scene.videos}  # fmt: skip
    for i, (video, frame) in enumerate(zip(scene.videos, scene.frames, strict=True)):
        row = images.items.index(f"t/{video}/{frame}")
        points = np.where(scene.known[i, :, None], scene.points[i], np.nan)
        np.testing.assert_array_equal(images.landmarks[row].T[column], points)
        scores = np.where(scene.known[i], scene.scores[i], 0)
        np.testing.assert_array_equal(images.confidence[row][column], scores)
        assert images.sequences[row] == f"t/{video}"
        assert images.columns["frame"][row] == frame - starts[video]


@settings(max_examples=30)
@given(scene=scenes(), dress=dresses.filter(lambda dress: dress.long), data=st.data())
def test_a_row_that_repeats_is_refused_with_both_lines(scene, dress, data):
    header, *rows = dress.table(scene).replace("\r\n", "\n").split("\n")
    again = data.draw(st.integers(0, len(rows) - 1))
    with TemporaryDirectory() as folder:
        path = Path(folder) / "t.csv"
        path.write_text("\n".join([header, *rows, rows[again]]), encoding="utf-8")
        with pytest.raises(InputError, match=rf":{len(rows) + 2}: .* is also in line {again + 2};"):
            read(path)


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


def test_a_comma_beside_decimal_points_is_no_decimal_comma(tmp_path):
    text = "frame;a_x;a_y;b_x;b_y\n0;1,234;2;3;4\n1;5.5;6;7;8\n"
    with pytest.raises(InputError, match=r"csv:2: '1,234' is no number \(column a_x\)"):
        read(table(tmp_path / "t.csv", text))
