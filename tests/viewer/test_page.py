"""The page in a browser, used as a person would, checked by numbers."""

import re
import subprocess

import numpy as np
import pytest
from shapefit.cli.main import run

from shapefit.viewer.page import resource

from .conftest import require

SHOWN = "return [...shapefit.view.shown].map((layer) => layer.name)"
CAMERA = "return [shapefit.view.yaw, shapefit.view.pitch]"
SLIDE = """
  const slider = document.getElementById("slider");
  slider.value = arguments[0];
  slider.dispatchEvent(new Event("input", {bubbles: true}));
"""


@pytest.fixture(scope="module")
def made(view, sequence):
    return view({"walker": (sequence.result,)}, truth=(sequence.truth,))


@pytest.fixture
def page(made, open_page):
    return open_page(made.path)


def test_the_slider_shows_the_landmarks_of_its_frame(page, sequence):
    page.run(SLIDE, 310)
    page.settle()
    assert (page.state("view.frame"), page.state("item")) == (310, "walk/0310")
    shown = (
        np.array(
            page.run("return Array.from(shapefit.data.seen(shapefit.view.frame))"), dtype=float
        )
        .reshape(-1, 2)
        .T
    )
    np.testing.assert_allclose(shown, sequence.landmarks[310], atol=0.01)
    assert "frame 311 of 400" in page.text("#state")
    assert "residual_variance in the image" in page.text("#state")
    assert page.text("#summary").startswith("No error bars and no verdict, against the truth")


def test_a_drag_by_a_quarter_turn_turns_the_projected_points(page, sequence):
    page.run(SLIDE, 42)
    page.settle()
    before = np.array(page.state("view.projected.walker"))
    page.drag("#space", 180, 0)
    camera, after = page.run(CAMERA), np.array(page.state("view.projected.walker"))
    page.drag("#space", 0, 300)
    assert page.state("view.pitch") == 90  # and no farther
    assert camera == [90, 0]
    points = sequence.shapes[42] * np.array([[1], [-1], [-1]])  # upright, y down in the image
    zoom = np.ptp(before[:, 0]) / np.ptp(points[0])
    for shown, x in ((before, points[0]), (after, points[2])):
        expected = zoom * np.stack([x, -points[1]], axis=1)
        np.testing.assert_allclose(
            shown - shown.mean(axis=0), expected - expected.mean(axis=0), atol=0.1
        )


@pytest.fixture(scope="module")
def walkers(view, project, tmp_path_factory):
    """Two people of one video, the second of whom is not to be trusted in two frames."""
    import h5py

    walk = tmp_path_factory.mktemp("walkers") / "walk.h5"
    keys = ["--set", "keypoints=body_25", "--set", "track=nearest", "-c", "people"]
    sample = str(project / "sample_data/openpose")
    assert run(["fit", sample, "-d", "people", "-o", str(walk), *keys]) == 0
    with h5py.File(walk, "r+") as file:
        reasons = file["reasons"].asstr()[()].astype(object)
        reasons[:] = ""
        reasons[[36 + 9, 36 + 20]] = "wide error bars"
        del file["reasons"]
        file["reasons"] = reasons
    return view({"walk": (walk,)})


def test_individuals_of_a_moment_are_in_one_scene(walkers, open_page):
    page = open_page(walkers.path)
    page.run("shapefit.go(3)")
    page.settle()
    assert page.run("return shapefit.data.items[39]") == "openpose/person 2/3"
    framed = "return look.bodiesOf(shapefit.data, shapefit.view).map(({ frame }) => frame)"
    assert page.run(framed) == [3, 39]
    assert page.text("#layers").split("\n") == ["person 1", "person 2"]
    before = np.array(page.state("view.projected.walk"))
    page.click("#layers label:nth-of-type(2) input")
    assert page.run(framed) == [3]
    alone = np.array(page.state("view.projected.walk"))
    assert np.ptp(alone[:, 1]) == pytest.approx(np.ptp(before[:, 1]))  # the scale is that of all
    page.keys("ARROW_DOWN")
    assert page.state("item") == "openpose/person 2/0"
    assert page.run(framed) == [0, 36]  # whose frame it is stays
    assert page.complaints() == []


def test_left_and_right_have_one_legend(walkers, open_page):
    """Limbs have the same colours on everybody, as the legend says; the middle is one's own."""
    page = open_page(walkers.path)
    tints = "return look.bodiesOf(shapefit.data, shapefit.view).map(({ tints }) => tints)"
    assert page.run(tints) == [["body-0", "left", "right"], ["body-1", "left", "right"]]
    assert page.text("#sides") == "left right"
    page.click("#layers label:nth-of-type(2) input")
    assert page.run(tints) == [["body-0", "left", "right"]]
    assert page.find("#sides").is_displayed()


def test_the_next_doubtful_frame_is_that_of_anybody(walkers, open_page):
    page = open_page(walkers.path)
    for moment in (9, 20, 9):
        page.keys("d")
        assert page.run("return shapefit.data.timeOf(shapefit.view.frame)") == moment
        assert page.text("#badge") == "not to be trusted: person 2: wide error bars"
    page.click("#layers label:nth-of-type(2) input")  # who is switched off is not looked at
    page.run("shapefit.go(0)")
    page.keys("d")
    assert page.state("frame") is None
    assert page.state("view.frame") == 0
    assert page.text("#badge") == "trusted"


def test_the_strip_has_a_row_for_each_individual_and_a_legend(walkers, open_page):
    page = open_page(walkers.path)
    drawn = """
      const drawn = strip.draw;
      strip.draw = (pen, rows, axis) => (window.rows = [rows, axis], drawn(pen, rows, axis));
      const measure = document.getElementById("measure");
      measure.value = arguments[0];
      measure.dispatchEvent(new Event("change"));
    """
    assert page.text("#states") == "not to be trusted no shape"
    assert page.run("return document.getElementById('measure').value") == "expected error"
    page.run(drawn, "p_value")
    page.settle()
    rows, axis = page.run("return window.rows")
    assert [row["name"] for row in rows] == ["person 1", "person 2"]
    assert [len(row["bars"]) for row in rows] == [36, 36]
    doubtful = [i for i, bar in enumerate(rows[1]["bars"]) if bar["state"] == "doubtful"]
    assert doubtful == [9, 20]
    assert {bar["state"] for bar in rows[0]["bars"]} == {"trusted"}
    assert 0 < axis["limit"] < 0.5
    assert page.find("#strip").size["height"] == 16 + 2 * 26


@pytest.mark.parametrize(("width", "height"), [(1280, 757), (1280, 640), (390, 800)])
def test_nothing_is_cut_off_in_a_small_window(walkers, open_page, width, height):
    page = open_page(walkers.path)
    size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 500}
    page.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    try:
        page.settle()
        seen = page.run("""
          const boxes = [...document.querySelectorAll("button, select, canvas, #told")];
          return boxes.filter((e) => e.offsetParent).map((e) => e.getBoundingClientRect())
            .map(({ left, right, bottom, height }) => [left, right, bottom, height]);""")
        left, right, bottom, tall = np.array(seen).T
        assert left.min() >= 0
        assert right.max() <= width
        assert tall.min() > 15
        if width > 500:
            assert bottom.max() <= height
            assert page.run("return document.getElementById('space').clientHeight") >= 220
        assert page.run("return document.documentElement.scrollWidth") == width
    finally:
        page.driver.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def test_named_views_zoom_and_reset(page):
    page.keys("3")
    assert page.state("view.pitch") == 90
    page.keys("2", "+", "+")
    assert (page.state("view.yaw"), page.state("view.pitch")) == (-90, 0)
    assert page.state("view.zoom") == pytest.approx(1.44)
    page.keys("ARROW_RIGHT", "ARROW_UP", alt=True)
    assert (page.state("view.yaw"), page.state("view.pitch")) == (-85, -5)
    page.click("#reset")
    first = "const { yaw, pitch, zoom, pan } = shapefit.view; return [yaw, pitch, zoom, ...pan]"
    assert page.run(first) == [0, 0, 1, 0, 0]


def test_play_advances_at_the_frame_rate_and_pauses(page):
    page.find("body").send_keys(" ")
    assert page.state("view.playing")
    start, began = page.run("return [shapefit.view.frame, performance.now()]")
    page.until("return shapefit.view.frame > 20")
    end, ended = page.run("return [shapefit.view.frame, performance.now()]")
    assert (end - start) / (ended - began) * 1000 == pytest.approx(50, rel=0.35)
    page.keys(" ")
    stopped = page.state("view.frame")
    page.settle()
    assert not page.state("view.playing")
    assert page.state("view.frame") == stopped
    assert page.text("#play") == "Play"


def test_keys_step_through_frames_and_sequences(page):
    page.keys("ARROW_RIGHT", "ARROW_RIGHT", "ARROW_LEFT")
    assert page.state("view.frame") == 1
    page.run("document.getElementById('slider').focus()")
    page.keys("ARROW_RIGHT")
    assert page.state("view.frame") == 2  # once, not also by the slider itself
    page.keys("END")
    assert page.state("view.frame") == 399
    page.keys("ARROW_DOWN")
    assert page.state("item") == "jump/0400"
    page.keys("HOME", "ARROW_UP")
    assert page.state("view.frame") == 0


def test_search_finds_and_enter_goes_there(page):
    page.keys("/")
    page.keys("JUMP/05")
    assert page.text("#found") == "100 of 600 found"
    page.keys("ENTER")
    assert page.state("item") == "jump/0500"
    assert page.text("#list option:checked") == "jump/0500"
    page.keys("nowhere")
    assert page.text("#found") == "0 of 600 found"


def test_the_strip_leads_to_the_worst_frame(page, sequence):
    measure = "return Array.from(shapefit.layer('walker').measures.at(-1).values.subarray(0, 400))"
    order = np.argsort(-np.array(page.run(measure)), kind="stable")
    choose = (
        "const m = document.getElementById('measure'); m.value = 'residual_variance in the image';"
    )
    page.run(f"{choose} m.dispatchEvent(new Event('change'))")
    page.click("#worst")
    assert page.state("view.frame") == order[0]
    page.keys("w")
    assert page.state("view.frame") == order[1]
    page.run("shapefit.go(123)")
    assert "iteration limit" in page.text("#state")


def test_a_click_on_the_strip_goes_to_that_frame(page):
    page.click("#strip")
    marker, strip = (page.find(name).rect for name in ("#marker", "#strip"))
    left = page.run("return strip.LEFT")
    clicked = (strip["width"] / 2 - left) / (strip["width"] - left)
    assert abs(page.state("view.frame") - 400 * clicked) <= 1
    share = (page.state("view.frame") + 0.5) / 400
    there = strip["x"] + left + share * (strip["width"] - left)
    assert marker["x"] + 1 == pytest.approx(there, abs=1.5)


def test_layers_are_switched_off_and_on(page):
    assert page.run(SHOWN) == ["walker", "truth"]
    page.click("#layers label:nth-of-type(2) input")
    assert page.run(SHOWN) == ["walker"]
    assert list(page.state("view.projected")) == ["walker"]


def test_the_truth_lies_on_the_result(page, sequence):
    page.settle()
    found, truth = (np.array(page.state(f"view.projected.{name}")) for name in ("walker", "truth"))
    assert 0 < np.abs(found - truth).max() < 0.15 * np.ptp(found)


def test_an_address_leads_to_an_item(made, open_page):
    assert open_page(made.path, "#item=jump%2F0450").state("item") == "jump/0450"


def test_both_panels_are_drawn_in_light_and_dark(page):
    seen = {page.run("return getComputedStyle(document.body).backgroundColor")}
    for _ in range(2):
        for canvas in ("plane", "space", "strip"):
            image = _pixels(page, canvas)
            assert len(np.unique(image.reshape(-1, 3), axis=0)) > 5, canvas
        page.click("#theme")
        seen.add(page.run("return getComputedStyle(document.body).backgroundColor"))
    assert len(seen) == 2
    assert page.complaints() == []
    assert page.requests() == []


def _pixels(page, canvas):
    import io

    from PIL import Image

    png = page.find(f"#{canvas}").screenshot_as_png
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB"))


def test_no_text_is_small_and_everything_has_a_name(page):
    page.click("#names")
    small = page.run("""
      return [...document.querySelectorAll("body *")].filter((e) => e.offsetParent &&
        [...e.childNodes].some((n) => n.nodeType === 3 && n.textContent.trim()) &&
        parseFloat(getComputedStyle(e).fontSize) < 12).map((e) => e.outerHTML)""")
    assert small == []
    unnamed = page.run("""
      const kinds = "button, input, select, canvas";
      const controls = [...document.querySelectorAll(kinds)];
      return controls.filter((e) => !(e.getAttribute("aria-label") || e.textContent.trim() ||
        [...(e.labels ?? [])].some((l) => l.textContent.trim()))).map((e) => e.outerHTML)""")
    assert unnamed == []


def test_the_colours_can_be_told_from_the_background():
    """Contrast as in WCAG 2.1: 4.5 for text, 3 for what is drawn."""
    palette = resource("palette.css")
    light, dark = re.findall(r"^:root.*?{(.*?)^}", palette, re.DOTALL | re.MULTILINE)
    for style in (light, dark):
        colours = dict(re.findall(r"--([\w-]+): #(\w{6})", style))
        assert len(colours) == 17
        parts = np.array(
            [[int(c[i : i + 2], 16) / 255 for i in (0, 2, 4)] for c in colours.values()]
        )
        linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
        light_of = dict(zip(colours, linear @ [0.2126, 0.7152, 0.0722] + 0.05, strict=True))
        for name in colours.keys() - {"background", "surface", "line"}:
            low, high = sorted([light_of[name], light_of["background"]])
            assert high / low >= (4.5 if name in ("ink", "faint") else 3), name


def test_the_scripts_pass_their_own_tests(project):
    """The mathematics of the page runs without a browser."""
    tests = project / "tests/viewer/geometry.test.mjs"
    line = [require("node"), "--test", str(tests)]
    done = subprocess.run(line, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
