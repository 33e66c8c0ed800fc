"""The page in a browser, used as a person would; names by unknown become no markup or
script.
"""

import json
import re
import subprocess

import numpy as np
import pytest
from numpy.testing import assert_allclose
from shapefit.cli.main import run

from shapefit.viewer.page import resource
from tests.pipelines.view.conftest import write_result, write_truth

from .conftest import require

SHOWN = "return [...shapefit.view.shown].map((layer) => layer.name)"
CAMERA = "return [shapefit.view.yaw, shapefit.view.pitch]"
SLIDE = "shapefit.go(arguments[0])"


@pytest.fixture(scope="module")
def made(view, sequence):
    return view({"walker": (sequence.result,)}, truth=(sequence.truth,))


@pytest.fixture
def page(made, open_page):
    return open_page(made.path)


def test_a_frame_shows_its_landmarks(page, sequence):
    page.run(SLIDE, 310)
    page.settle()
    assert (page.state("view.frame"), page.state("item")) == (310, "walk/0310")
    shown = (
        np.array(
            page.run("return Array.from(shapefit.data.observed(shapefit.view.frame))"),
            dtype=float,
        )
        .reshape(-1, 2)
        .T
    )
    assert_allclose(shown, sequence.landmarks[310], atol=0.01)
    assert "frame 311 of 400" in page.text("#told")
    assert "reprojection" in page.text("#told")
    facts = page.text("#facts").split("\n")
    assert facts[:3] == ["2 sequences", "600 frames", "50 Hz"]
    assert facts[3].startswith("error against the truth")
    assert "best similarity" in page.find("#facts li:last-child").get_attribute("title")


def test_a_drag_by_a_quarter_turn_turns_the_projected_points(page, sequence):
    page.run(SLIDE, 42)
    assert page.run(CAMERA) == [30, 15]  # opens turned
    page.keys("1")
    before = np.array(page.state("view.projected.walker"))
    page.drag("#space", 180, 0)
    camera, after = page.run(CAMERA), np.array(page.state("view.projected.walker"))
    page.drag("#space", 0, 300)
    assert page.state("view.pitch") == 90  # and no farther
    assert camera == [90, 0]
    points = sequence.shapes[42] * np.array(
        [[1], [-1], [-1]]
    )  # upright, y down in the image
    zoom = np.ptp(before[:, 0]) / np.ptp(points[0])
    for shown, x in ((before, points[0]), (after, points[2])):
        expected = zoom * np.stack([x, -points[1]], axis=1)
        assert_allclose(
            shown - shown.mean(axis=0), expected - expected.mean(axis=0), atol=0.1
        )


@pytest.fixture(scope="module")
def walkers(view, project, tmp_path_factory):
    """Two people of one video, the second of whom is not to be trusted in two
    frames.
    """
    import h5py

    walk = tmp_path_factory.mktemp("walkers") / "walk.h5"
    keys = ["--set", "keypoints=body_25", "--set", "image_size=[1280, 720]"]
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
    framed = (
        "return look.bodiesOf(shapefit.data, shapefit.view).map(({ frame }) => frame)"
    )
    assert page.run(framed) == [3, 39]
    assert page.text("#layers").split("\n") == ["person 1", "person 2"]
    before = np.array(page.state("view.projected.walk"))
    page.click("#layers label:nth-of-type(2) input")
    assert page.run(framed) == [3]
    alone = np.array(page.state("view.projected.walk"))
    assert np.ptp(alone[:, 1]) == pytest.approx(
        np.ptp(before[:, 1])
    )  # the scale is that of all
    page.keys("ARROW_DOWN")
    assert page.state("item") == "openpose/person 2/0"
    assert page.run(framed) == [0, 36]  # whose frame it is stays
    assert page.complaints() == []


def test_the_next_doubtful_frame_is_that_of_anybody(walkers, open_page):
    page = open_page(walkers.path)
    for moment in (9, 20, 9):
        page.keys("d")
        assert page.run("return shapefit.data.timeOf(shapefit.view.frame)") == moment
        assert page.text("#badge") == "doubtful: person 2: wide error bars"
    page.click(
        "#layers label:nth-of-type(2) input"
    )  # who is switched off is not looked at
    page.run("shapefit.go(0)")
    page.keys("d")
    assert page.state("view.frame") == 0
    assert page.text("#badge") == "trusted"


def test_the_chart_has_a_line_and_a_band_for_each_individual(walkers, open_page):
    page = open_page(walkers.path)
    assert page.run("return document.getElementById('measure').value") == "knee angle r"
    rows = page.run(
        "return shapefit.chart().map(({ values, sd, states }) => [values, sd, states])"
    )
    assert [len(values) for values, _, _ in rows] == [36, 36]
    assert all(0 < deviation < 60 for _, sd, _ in rows for deviation in sd)
    doubtful = [i for i, state in enumerate(rows[1][2]) if state == "doubtful"]
    assert doubtful == [9, 20]
    assert set(rows[0][2]) == {"trusted"}
    x, y = page.run("return shapefit.view.projected.walk[5]")
    box = page.find("#space").rect
    from selenium.webdriver import ActionChains

    middle = x - box["width"] / 2, y - box["height"] / 2
    chain = ActionChains(page.driver).move_to_element_with_offset(
        page.find("#space"), *middle
    )
    chain.click().perform()
    page.settle()
    name = page.run("return shapefit.data.landmarks[5]")
    assert page.text("#measure option:checked") == f"error bar of {name}"
    (values, _) = page.run("return shapefit.chart().map(({ values }) => values)")
    sd = page.run("return Array.from(shapefit.layer('walk').sd(0))").copy()
    assert values[0] == pytest.approx(100 * np.linalg.norm(sd[15:18]), rel=1e-6)


@pytest.mark.parametrize(("width", "height"), [(1280, 757), (1280, 640), (390, 800)])
def test_nothing_is_cut_off_in_a_small_window(walkers, open_page, width, height):
    page = open_page(walkers.path)
    size = {
        "width": width,
        "height": height,
        "deviceScaleFactor": 1,
        "mobile": width < 500,
    }
    page.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    try:
        page.settle()
        seen = page.run(
            """
          const boxes = [...document.querySelectorAll("button, select, canvas")];
          return boxes.filter((e) => e.offsetParent)
            .map((e) => e.getBoundingClientRect())
            .map(({ left, right, bottom, height }) => [left, right, bottom, height]);"""
        )
        left, right, bottom, tall = np.array(seen).T
        assert left.min() >= 0
        assert right.max() <= width
        assert tall.min() > 15
        if width > 500:
            assert bottom.max() <= height
            assert (
                page.run("return document.getElementById('space').clientHeight") >= 220
            )
        assert page.run("return document.documentElement.scrollWidth") == width
    finally:
        page.driver.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


BORDER = """
  const {strokeRect} = CanvasRenderingContext2D.prototype;
  CanvasRenderingContext2D.prototype.strokeRect = function(...box) {
      window.border = box;
      strokeRect.call(this, ...box);
  };
"""
"""Makes the page note where it draws the border of the image."""


def test_the_image_is_zoomed_to_the_landmarks_or_whole(walkers, open_page):
    page = open_page(walkers.path)
    page.run(BORDER + "shapefit.go(5)")
    page.settle()
    width, height = page.run(
        "const {clientWidth, clientHeight} = document.getElementById('plane');"
        "return [clientWidth, clientHeight]"
    )
    zoomed = page.run("return window.border")
    page.click("#whole")
    left, top, wide, tall = page.run("return window.border")
    assert 0 <= left <= left + wide <= width
    assert 0 <= top <= top + tall <= height
    assert max(wide / width, tall / height) > 0.9
    assert zoomed[2] > 1.3 * wide
    page.run("shapefit.go(20)")
    page.settle()
    assert page.run("return window.border") == [left, top, wide, tall]


def test_the_name_of_the_camera_is_whole(walkers, open_page):
    page = open_page(walkers.path)
    page.run("""
      const {fillText} = CanvasRenderingContext2D.prototype;
      CanvasRenderingContext2D.prototype.fillText = function(text, x, y) {
          if (text.startsWith('camera'))
              window.written = [text, x - this.measureText(text).width, x, y];
          fillText.call(this, text, x, y);
      };""")
    for pan in ([0, 0], [-900, 0], [900, 0], [0, 900], [0, -900]):
        page.run("shapefit.view.pan = arguments[0]; shapefit.go(3)", pan)
        page.settle()
        text, left, right, y = page.run("return window.written")
        width, height = page.run(
            "const {clientWidth, clientHeight} = document.getElementById('space');"
            "return [clientWidth, clientHeight]"
        )
        assert re.fullmatch(r"camera, about [\d.]+ m away", text)
        assert 0 < left < right < width
        assert 8 < y < height - 8


def test_named_views_zoom_and_reset(page):
    page.keys("3")
    assert page.state("view.pitch") == 90
    page.keys("2", "+", "+")
    assert (page.state("view.yaw"), page.state("view.pitch")) == (-90, 0)
    assert page.state("view.zoom") == pytest.approx(1.44)
    page.keys("ARROW_RIGHT", "ARROW_UP", alt=True)
    assert (page.state("view.yaw"), page.state("view.pitch")) == (-85, -5)
    page.click("[data-key='0']")
    first = (
        "const { yaw, pitch, zoom, pan } = shapefit.view; return [yaw, pitch, zoom,"
        " ...pan]"
    )
    assert page.run(first) == [30, 15, 1, 0, 0]


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
    page.run("document.getElementById('chart').focus()")
    page.keys("ARROW_RIGHT")
    assert page.state("view.frame") == 2  # the chart is a slider
    page.keys("END")
    assert page.state("view.frame") == 399
    page.keys("ARROW_DOWN")
    assert page.state("item") == "jump/0400"
    page.keys("HOME", "ARROW_UP")
    assert page.state("view.frame") == 0


def test_pages_play_at_once_unless_motion_is_to_be_reduced(made, walkers, open_page):
    page = open_page(made.path)
    assert not page.state("view.playing")
    reduced = [{"name": "prefers-reduced-motion", "value": "no-preference"}]
    page.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": reduced})
    try:
        page = open_page(walkers.path)
        assert page.state("view.playing")
        page.until("return shapefit.view.frame > 3")
    finally:
        page.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": []})


def test_a_click_on_the_chart_goes_to_that_frame(page):
    page.click("#chart")
    marker, drawn = (page.find(name).rect for name in ("#marker", "#chart"))
    left, right = page.run("return [chart.LEFT, chart.RIGHT]")
    wide = drawn["width"] - left - right
    clicked = (drawn["width"] / 2 - left) / wide
    assert abs(page.state("view.frame") - 400 * clicked) <= 1
    there = drawn["x"] + left + wide * (page.state("view.frame") + 0.5) / 400
    assert marker["x"] + 1 == pytest.approx(there, abs=1.5)


def test_an_address_leads_to_an_item(made, open_page):
    assert open_page(made.path, "#item=jump%2F0450").state("item") == "jump/0450"


def test_both_panels_are_drawn_in_light_and_dark(page):
    seen = {page.run("return getComputedStyle(document.body).backgroundColor")}
    for colours in ("light", "dark"):
        media = [{"name": "prefers-color-scheme", "value": colours}]
        page.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": media})
        page.settle()
        for canvas in ("plane", "space", "chart"):
            image = _pixels(page, canvas)
            assert len(np.unique(image.reshape(-1, 3), axis=0)) > 5, canvas
        seen.add(page.run("return getComputedStyle(document.body).backgroundColor"))
    page.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": []})
    assert len(seen) == 2
    assert page.complaints() == []
    assert page.requests() == []


def _pixels(page, canvas):
    import io

    from PIL import Image

    png = page.find(f"#{canvas}").screenshot_as_png
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB"))


def test_the_colours_can_be_told_from_the_background():
    """Contrast as in WCAG 2.1: 4.5 for text, 3 for what is drawn."""
    palette = resource("palette.css")
    light, dark = re.findall(r":root {(.*?)}", palette, re.DOTALL)
    for style in (light, dark):
        colours = dict(re.findall(r"--([\w-]+): #(\w{6})", style))
        assert len(colours) == 20
        parts = np.array(
            [[int(c[i : i + 2], 16) / 255 for i in (0, 2, 4)] for c in colours.values()]
        )
        linear = np.where(
            parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4
        )
        light_of = dict(
            zip(colours, linear @ [0.2126, 0.7152, 0.0722] + 0.05, strict=True)
        )
        for name in colours.keys() - {
            "background",
            "surface",
            "line",
            "mesh",
            "ground",
            "shadow",
        }:
            for behind in ("background", "ground"):
                low, high = sorted([light_of[name], light_of[behind]])
                assert high / low >= (4.5 if name in ("ink", "faint") else 3), (
                    name,
                    behind,
                )
        assert light_of["shadow"] < light_of["ground"]


def test_the_scripts_pass_their_own_tests(project):
    """The mathematics of the page runs without a browser."""
    tests = project / "tests/viewer/geometry.test.mjs"
    line = [require("node"), "--test", str(tests)]
    done = subprocess.run(line, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


ATTACK = "window.hacked = true"
HOSTILE = (
    f"</script><img src=x onerror='{ATTACK}'>",
    f"<script>{ATTACK}</script>",
    f"\"><svg onload='{ATTACK}'>",
    f"]]><!--<script>{ATTACK}//",
    f"</script ><img src=x onerror='{ATTACK}' ",
    "javascript:window.hacked=true",
    "&lt;b&gt;&amp;\u2028\u202e\x1b[0m{{page}}",
    "../../etc/passwd\nSet-Cookie: a=b",
    "a|b *c* [d](javascript:window.hacked=true)",
)


@pytest.fixture(scope="module")
def hostile(tmp_path_factory):
    """A result and its truth in which every name is an attack, and so is the rest of
    the text.
    """
    folder = tmp_path_factory.mktemp("hostile")
    n, p = len(HOSTILE), 5
    rng = np.random.default_rng(0)
    shapes = rng.normal(size=(n, 3, p))
    shapes[-1] = np.nan
    names = tuple(f"{HOSTILE[j]} {j}" for j in range(p))
    items = tuple(f"{text}/{i}" for i, text in enumerate(HOSTILE))
    sequences = tuple(HOSTILE[i // 2] for i in range(n))
    columns = {"landmarks": shapes[:, :2].swapaxes(1, 2)}
    config = {"config": json.dumps({"dictionary": f"/x/{HOSTILE[2]}.h5"})}
    called = {"landmark_names": names, "items": items, "sequences": sequences}
    status = np.array(HOSTILE, dtype=object)
    path = folder / f"{HOSTILE[1].replace('/', '_')}.h5"
    result = write_result(
        path, shapes, columns, config, status=status, unit=HOSTILE[0], **called
    )
    true = np.nan_to_num(shapes) + rng.normal(size=shapes.shape)
    edges = np.array([[0, 1], [1, 2]])
    truth = write_truth(
        folder / "truth.h5", true, edges=edges, unit=HOSTILE[2], **called
    )
    return result, truth, items, names


def check(page):
    """No script but ours ran, nothing was asked for, and nothing in the page could do
    either.
    """
    assert page.run("return window.hacked === undefined")
    assert page.complaints() == []
    assert page.requests() == []
    strange = page.run(
        """
      const own = new Set(["SCRIPT", "STYLE", "META", "TITLE"]);
      const inside = (href) => /^\\.\\/[\\w.]+(#item=[^"]*)?$/.test(href);
      return [...document.querySelectorAll("*")].filter((e) =>
        e.tagName === "SCRIPT" ? e.src :
        ["IFRAME", "OBJECT", "EMBED", "LINK", "BASE", "FORM"].includes(e.tagName) ||
        (e.tagName === "IMG" && !e.src.startsWith("data:image/svg+xml;base64,")) ||
        [...e.attributes].some((a) => a.name.startsWith("on")) ||
        (e.tagName === "A" && !inside(e.getAttribute("href")))
      ).map((e) => e.outerHTML)"""
    )
    assert strange == []
    assert page.run("return document.scripts.length") <= 2


def test_hostile_names_stay_text_on_the_page_of_results(hostile, view, open_page):
    result, truth, items, _ = hostile
    made = view({HOSTILE[0]: (result,)}, truth=(truth,))
    page = open_page(made.path)
    for frame, item in enumerate(items):
        page.run("shapefit.go(arguments[0])", frame)
        page.settle()
        assert page.state("item") == item
    page.run("shapefit.go(0)")
    page.settle()
    text = page.run("return document.body.textContent")
    assert HOSTILE[0] in text
    check(page)


def test_a_script_that_were_put_into_the_page_would_not_run(hostile, view, open_page):
    """The policy is the second wall: it holds even if a name became markup."""
    made = view({"x": (hostile[0],)})
    broken = made.path.with_name("broken.html")
    attack = (
        f"<script>{ATTACK}</script><img src=x onerror='{ATTACK}'><img"
        " src='http://127.0.0.1:9/x'>"
    )
    broken.write_text(
        made.text.replace("<main>", f"<main>{attack}", 1), encoding="utf-8"
    )
    page = open_page(broken)
    assert page.run("return window.hacked === undefined")
    assert any("Content Security Policy" in line for line in page.complaints())
