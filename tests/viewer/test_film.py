"""A film under the landmarks, in a browser: frame k of the film under frame k of the
page, read from the pixels of the panel.
"""

from pathlib import Path

import numpy as np
import pytest

from tests.pipelines.view.conftest import write_result

COUNT = 36
FILMS = Path(__file__).with_name("films")
PLAYED = ("constant.mp4", "variable.mp4", "constant.webm", "variable.webm")

SOUGHT = (0, 7, 3, 35, 34, 12, 13, 14, 1, 20, 35, 0, 17, 18, 5)
"""Frames that a test goes to: forwards, backwards, both ends."""

MIN_RIGHT_SHARE = 0.98
"""Of the frames that are drawn while the film plays."""

WATCH = """
const {draw} = plane;
const {drawImage} = CanvasRenderingContext2D.prototype;
const copy = Object.assign(document.createElement('canvas'), {height: 1});
let box = null;
CanvasRenderingContext2D.prototype.drawImage = function(what, ...rest) {
    if (this.canvas.id === 'plane') box = rest;
    return drawImage.call(this, what, ...rest);
};
const barcode = () => {
    const canvas = document.getElementById('plane');
    const ratio = canvas.width / canvas.clientWidth;
    const [left, top, wide] = box;
    const cell = wide / 8;
    const row = Math.round(ratio * (top + cell / 2));
    copy.width = canvas.width;
    const pen = copy.getContext('2d', {willReadFrequently: true});
    drawImage.call(pen, canvas, 0, -row);
    const {data} = pen.getImageData(0, 0, canvas.width, 1);
    return [0, 1, 2, 3, 4, 5, 6, 7].reduce((code, bit) => {
        const x = Math.round(ratio * (left + (bit + 0.5) * cell));
        return code + ((data[4 * x + 1] > 128) << bit);
    }, 0);
};
window.seen = [];
plane.draw = (canvas, data, view) => {
    box = null;
    draw(canvas, data, view);
    if (box) window.seen.push([view.frame, barcode(), Boolean(view.playing)]);
};
"""
"""Makes the page note of what it draws: its frame, the film's, whether it plays."""


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    """36 frames of a body that fills the lower part of the image."""
    rng = np.random.default_rng(4)
    shapes = rng.normal(size=(COUNT, 3, 5)) * 8 + np.array([160, 120, 0])[:, None]
    frames = tuple(f"walk/{number:03d}" for number in range(COUNT))
    return write_result(
        tmp_path_factory.mktemp("film") / "walk.h5",
        shapes,
        {
            "landmarks": shapes[:, :2].swapaxes(1, 2),
            "image_size": np.tile([320.0, 180.0], (COUNT, 1)),
        },
        items=frames,
        sequences=("walk",) * COUNT,
        frame_rate=25.0,
        y_axis="down",
    )


@pytest.fixture
def filmed(request, view, result, open_page):
    """The page of a film, with all of the image in view, and noted what is drawn."""
    made = view({"walk": (result,)}, images=FILMS / request.param)
    page = open_page(made.path)
    page.run(WATCH)
    page.click("#whole")
    page.until("return shapefit.view.film.ready && shapefit.view.film.there")
    return page


def check_quiet(page):
    assert page.complaints() == []
    assert [url for url in page.requests() if not url.startswith("blob:")] == []


@pytest.mark.parametrize("filmed", PLAYED, indirect=True)
def test_every_frame_that_is_sought_is_that_of_the_film(filmed):
    for frame in SOUGHT:
        filmed.run("window.seen = []; shapefit.go(arguments[0])", frame)
        filmed.until("return shapefit.view.film.there && window.seen.length")
        filmed.settle()
        assert filmed.run("return window.seen.at(-1).slice(0, 2)") == [frame, frame]
    check_quiet(filmed)


@pytest.mark.parametrize("filmed", PLAYED, indirect=True)
@pytest.mark.parametrize("speed", ["1", "0.25"])
def test_while_it_plays_the_film_is_the_clock(filmed, speed):
    filmed.run(
        "const speed = document.getElementById('speed');"
        "speed.value = arguments[0]; speed.dispatchEvent(new Event('change'))",
        speed,
    )
    filmed.click("#play")
    filmed.until(
        "return new Set(window.seen.filter((each) => each[2]).map(([frame]) => frame))"
        ".size > 15",
        seconds=30,
    )
    filmed.click("#play")
    filmed.until("return shapefit.view.film.there")
    filmed.settle()
    seen = np.array(filmed.run("return window.seen"))
    played = seen[seen[:, 2] == 1]
    assert (played[:, 0] == played[:, 1]).mean() >= MIN_RIGHT_SHARE, played
    assert seen[-1, 0] == seen[-1, 1]  # it came back to the frame of the page
    check_quiet(filmed)


@pytest.mark.parametrize("filmed", ["constant.mp4"], indirect=True)
def test_it_plays_in_a_round(filmed):
    filmed.run("shapefit.go(30)")
    filmed.click("#play")
    filmed.until("return window.seen.some((each) => each[2] && each[0] < 9)")
    assert filmed.state("view.playing.byFilm")


@pytest.mark.parametrize("filmed", ["constant.mp4", "variable.webm"], indirect=True)
def test_pictures_and_recordings_hold_the_film(filmed):
    """Keys S and R: what they save is looked into."""
    filmed.run("""
        window.saved = [];
        const make = URL.createObjectURL;
        URL.createObjectURL = (blob) => (window.saved.push(blob), make(blob));
        const {captureStream} = HTMLCanvasElement.prototype;
        HTMLCanvasElement.prototype.captureStream = function(rate) {
            window.recorded = [this.width, this.height];
            return captureStream.call(this, rate);
        };
        const {stop} = MediaRecorder.prototype;
        MediaRecorder.prototype.stop = function() {
            window.ended = shapefit.view.frame;
            stop.call(this);
        };
        document.getElementById('plane').parentElement.style.marginRight = '1px';
    """)
    filmed.keys("s")
    filmed.until("return window.saved.length")
    filmed.keys("r")
    filmed.until("return window.saved.length > 1", seconds=30)
    picture, film = filmed.run("return window.saved.map(({type}) => type)")
    assert picture == "image/png"
    assert film.startswith("video/webm")
    assert filmed.run("return window.saved[0].size") > 5000
    assert filmed.run("return window.ended") > COUNT - 6  # it goes once through all
    assert [side % 2 for side in filmed.run("return window.recorded")] == [0, 0]
    check_quiet(filmed)


def test_landmarks_go_on_where_the_film_is_over(view, result, open_page, tmp_path):
    from shapefit.io import read_results, result_writer

    longer = read_results(result)
    longer = longer.take([*range(COUNT), *range(10)]).replaced(
        items=tuple(f"walk/{number:03d}" for number in range(COUNT + 10)),
        sequences=("walk",) * (COUNT + 10),
    )
    with result_writer(tmp_path / "longer.h5") as writer:
        writer.append(longer)
    made = view({"longer": (tmp_path / "longer.h5",)}, images=FILMS / PLAYED[0])
    (note,) = [text for text in made.outcome.warnings if "constant.mp4" in text]
    assert note.startswith("constant.mp4 has 36 frames, the landmarks go to frame 46:")
    page = open_page(made.path)
    page.run("shapefit.go(33)")
    page.click("#play")
    page.until("return shapefit.view.frame > 40")
    assert not page.state("view.film.ready")  # no picture of another frame under it
    page.until("return shapefit.view.frame < 9 && shapefit.view.playing.byFilm")
    assert page.complaints() == []


def test_a_film_that_this_browser_does_not_play_is_said(
    view, result, open_page, tmp_path, monkeypatch
):
    from shapefit.pipelines.view import film

    monkeypatch.setattr(film, "H264_PROFILES", (66, 77, 88, 100, 244))
    cut = tmp_path / "cut.mp4"
    whole = (FILMS / "colours.mp4").read_bytes()
    start = whole.index(b"mdat") + 4
    size = int.from_bytes(whole[start - 8 : start - 4]) - 8
    cut.write_bytes(whole[:start] + bytes(size) + whole[start + size :])
    page = open_page(view({"walk": (result,)}, images=cut).path)
    page.until("return shapefit.view.film === null")
    assert "does not play the film" in page.text("#notes")
    page.run("shapefit.go(7)")
    page.settle()
    assert page.state("view.frame") == 7


def test_only_a_page_with_a_film_plays_one(view, result):
    with_film = view({"walk": (result,)}, images=FILMS / PLAYED[0]).text
    without = view({"walk": (result,)}).text
    assert "img-src data:; media-src blob:; base-uri" in with_film
    assert "media-src" not in without.partition("</head>")[0]
    assert "default-src 'none'" in with_film


def test_the_time_is_passed_on_frame_by_frame(tmp_path):
    """The film's frame at a time is that which begins nearest, by its own times."""
    import subprocess

    from shapefit.viewer.page import resource

    from .conftest import require

    script = tmp_path / "place.mjs"
    script.write_text(
        resource("scripts/film.js")
        + "const starts = [0, 0.05, 0.054, 0.1, 0.3];"
        + "const at = [0, 0.049, 0.05, 0.054, 0.1, 0.2999, 9];"
        + "console.log(at.map((time) => film.placeAt(starts, time)).join());"
    )
    done = subprocess.run(
        [require("node"), str(script)], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "0,1,1,2,3,3,3"
