"""Make every picture of README, docs and the gallery: python -m tools.page_pictures.

Names of pictures after it make these alone. Reads what `make demo`, `make mocap-table`
and `make recovery` leave, and runs docs/gallery; `make pictures` does all of it. Needs
chromium and chromedriver, and selenium and Pillow of the extra `test-all`. Beside the
pictures stands which code drew them, so that a test can name those that are older.
"""

from __future__ import annotations

import hashlib
import inspect
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from base64 import b64decode
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from io import BytesIO
from math import pi, sin
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from shapefit.arrays import Floats, Integers

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from selenium.webdriver.chrome.webdriver import WebDriver

PROJECT = Path(__file__).resolve().parents[1]
DEMO = PROJECT / "results/demo"
"""What `make demo` leaves."""

REPORT = PROJECT / "results/mocap/report"
"""What `make mocap-table` leaves."""

RECOVERY = PROJECT / "results/recovery"
"""What `make recovery` leaves."""

IMAGES = PROJECT / "docs/images"

DRAWN_BY = IMAGES / "drawn_by.json"
"""Picture -> digest of the code that drew it."""

FLAGS = ("--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars")
SIZE = {"width": 1280, "height": 720, "deviceScaleFactor": 2, "mobile": False}
MOTIONLESS = {"features": [{"name": "prefers-reduced-motion", "value": "reduce"}]}

PAUSE = "setTimeout(arguments[0], 300)"
"""The words under the chart follow the picture after a moment."""

ITEM = "openpose/person 1/20"
"""The walker whose page is photographed."""

STEPS = 72
"""Pictures of the animation."""

SECONDS = 3.6
"""Length of the animation."""

TURN = 40.0
"""Degrees by which its view turns to either side."""

BUDGET = 1_500_000
"""Bytes of the animation, at most."""

GALLERY_WIDTH = 1000
"""Pixels of a picture of the gallery."""

STAGE = """
  for (const part of document.querySelectorAll("header, main, footer")) {
    part.hidden = true;
  }
  document.body.style.display = "block";
  // Small panels show the people, not the border of the image.
  shapefit.data.image = null;
  const widths = [["plane", 230], ["space", 430], ["chart", 300]];
  window.panels = widths.map(([name, width]) => {
    const canvas = document.createElement("canvas");
    const style = { width: `${width}px`, height: "330px", display: "inline-block" };
    Object.assign(canvas.style, style);
    document.body.append(canvas);
    return { name, width, canvas };
  });
"""
PAINT = """
  const [time, yaw, titles] = arguments;
  const { data, view } = shapefit;
  const frame = data.recordings[0].tracks[0].frames[time];
  Object.assign(view, { frame, yaw, pitch: 12 });
  const whole = document.createElement("canvas");
  Object.assign(whole, { width: 1440, height: 540 });
  const context = whole.getContext("2d");
  context.scale(1.5, 1.5);
  Object.assign(context, { fillStyle: "white", font: "14px system-ui, sans-serif" });
  context.fillRect(0, 0, 960, 360);
  let left = 0;
  panels.forEach(({ name, width, canvas }, number) => {
    if (name === "plane") {
      // What goes in are landmarks alone, without the skeleton that comes out.
      const [body, stroke] = [look.drawBody, look.stroke];
      [look.drawBody, look.stroke] = [() => {}, () => {}];
      plane.draw(canvas, data, view);
      [look.drawBody, look.stroke] = [body, stroke];
    }
    if (name === "space") space.draw(canvas, data, view);
    if (name === "chart") {
      const rows = shapefit.chart().map((row) => ({ ...row, states: [] }));
      chart.draw(look.pen(canvas), rows, { unit: "°", rate: data.frame_rate });
      const pen = canvas.getContext("2d");
      const [from, to] = [chart.LEFT, width - chart.RIGHT];
      pen.fillStyle = look.text("ink");
      const middle = (time + 0.5) / rows[0].values.length;
      pen.fillRect(from + (to - from) * middle, 6, 2, 302);
    }
    context.drawImage(canvas, left, 28, width, 330);
    context.fillStyle = look.text("faint");
    context.fillText(titles[number], left + 12, 18);
    left += width;
  });
  return whole.toDataURL("image/png").split(",")[1];
"""
TITLES = (
    "2D landmarks of one camera",
    "3D, with error ellipsoids",
    "knee angle, with its band",
)
"""Of the three panels of the animation."""


class Picture(NamedTuple):
    """A picture: the function that draws it into a file, and globs of the further code
    on which it depends.
    """

    draw: Callable[[Path], None]
    sources: tuple[str, ...]


class MissingInput(Exception):
    """A file that a picture is drawn from is missing; the text says what makes it."""


def make_pictures(names: list[str]) -> None:
    """Draw the pictures of these names, or all, and store digests of the code that drew
    them.
    """
    for name in names or PICTURES:
        try:
            PICTURES[name].draw(IMAGES / name)
        except MissingInput as error:
            print(f"{name} is left as it is: {error}")
            continue
        _store_digest(name)
        print(f"{name} made", flush=True)


def _store_digest(name: str) -> None:
    """Store the digest of the code that has just drawn a picture."""
    digests = json.loads(DRAWN_BY.read_text(encoding="utf-8"))
    digests[name] = digest_of_code(name)
    ordered = {name: digests[name] for name in PICTURES if name in digests}
    DRAWN_BY.write_text(json.dumps(ordered, indent=2) + "\n", encoding="utf-8")


def stale_pictures() -> list[str]:
    """Return the names of pictures that are older than the code that draws them."""
    digests = json.loads(DRAWN_BY.read_text(encoding="utf-8"))
    return [name for name in PICTURES if digests.get(name) != digest_of_code(name)]


def digest_of_code(name: str, project: Path = PROJECT) -> str:
    """Return a digest of the code that draws a picture: its function here, and its
    sources.

    Comments of JavaScript do not count, nor spaces, line ends and commas, which
    formatters move.
    """
    picture = PICTURES[name]
    function = picture.draw
    if isinstance(function, partial):
        function = function.func
    texts = [inspect.getsource(function)]
    for glob in picture.sources:
        for path in sorted(project.glob(glob)):
            text = path.read_text("utf-8")
            if path.suffix == ".js":
                text = COMMENT_OF_JAVASCRIPT.sub("", text)
            texts.append(text)
    letters = re.sub(r"[\s,]", "", "".join(texts))
    return hashlib.sha256(letters.encode()).hexdigest()[:16]


def draw_hero(target: Path) -> None:
    """Write landmarks, the turning skeletons and an angle, drawn by the page itself.

    An animation in WebP. It shows what README's first command makes.
    """
    from PIL import Image

    pictures = []
    with page_of(_made(DEMO / "walk.h5", "demo")) as driver:
        driver.execute_script(STAGE)
        length = driver.execute_script("return shapefit.data.recordings[0].length")
        for step in range(STEPS):
            yaw = 30 + TURN * sin(2 * pi * step / STEPS)
            png = driver.execute_script(PAINT, step % length, yaw, TITLES)
            pictures.append(Image.open(BytesIO(b64decode(png))).convert("RGB"))
    pictures[0].save(
        target,
        append_images=pictures[1:],
        save_all=True,
        duration=round(1000 * SECONDS / STEPS),
        loop=0,
        quality=72,
        method=4,
    )
    if target.stat().st_size > BUDGET:
        size = target.stat().st_size
        raise RuntimeError(f"{target} has {size} bytes: lower its quality")


def draw_page(target: Path) -> None:
    """Photograph the page of the walk."""
    with page_of(_made(DEMO / "walk.h5", "demo")) as driver:
        go = "shapefit.go(shapefit.data.items.indexOf(arguments[0]))"
        driver.execute_script(go, ITEM)
        target.write_bytes(settled(driver))


def draw_classes(target: Path) -> None:
    """Draw a person, a dog and a car: landmarks in, shapes out."""
    from matplotlib.figure import Figure

    from shapefit.evaluation.figures import style

    with tempfile.TemporaryDirectory() as folder, style():
        run_script("animal_from_deeplabcut.sh", Path(folder))
        cars = _made(DEMO / "cars/result.h5", "demo")
        mesh = cars.parent / "meshes/pickup_1/view_4.glb"
        parts = (
            ("people: nothing to train", _made(DEMO / "walk.h5", "demo"), ITEM, 40),
            ("animals: from your own tracks", Path(folder, "walk.h5"), DOG, 20),
            ("cars: a mesh of each", cars, "pickup_1/view_4", None),
        )
        figure = Figure(figsize=(9.6, 2.1))
        for place, (title, result, item, turn) in enumerate(parts):
            left, right = (
                figure.add_axes(((2 * place + x) / 6 + 0.01, 0.02, 0.146, 0.82))
                for x in (0, 1)
            )
            _draw_lifted(left, right, result, item, turn, mesh)
            figure.text(place / 3 + 0.01, 0.91, title, fontsize=10)
            figure.text(place / 3 + 1 / 6 - 0.012, 0.42, "→", fontsize=15)
        figure.savefig(target, dpi=150, facecolor="white")


DOG = "animal_walk/20"
"""Image of the dog that is drawn."""


def _draw_lifted(
    left: Axes, right: Axes, result: Path, item: str, turn: float | None, mesh: Path
) -> None:
    """Draw the landmarks of one item of a result on the left, and its shape, turned by
    degrees, on the right; the mesh for no turn.
    """
    import shapefit
    from shapefit.io.skeletons import edges_of

    fit = shapefit.read_results(result)
    row = fit.items.index(item)
    assert fit.landmarks is not None, "every fit has them"
    x, y = fit.landmarks[row].T
    size = 4.0 if len(x) < 40 else 2.4
    left.plot(x, -y, "o", color=INK, markersize=size, markeredgewidth=0)
    for axes in (left, right):
        axes.set_aspect("equal")
        axes.axis("off")
    left.margins(0.08)
    if turn is None:
        _draw_mesh(right, mesh)
        return
    edges = fit.edges
    if edges is None:
        edges = np.array(edges_of(fit.landmark_names))
    # y down and z away become y up and z towards the viewer
    points = _turn_and_tilt(fit.shapes[row] * [1, -1, -1], turn, 12)
    _draw_bones(right, points, edges, fit.landmark_names)


def _draw_bones(
    axes: Axes, points: Floats, edges: Integers, names: Sequence[str]
) -> None:
    """Draw points (p, 3) and the bones between them, left and right in their
    colours.
    """
    order = np.argsort([points[list(edge), 2].mean() for edge in edges])
    for edge in edges[order]:
        sides = {_side(names[end]) for end in edge} - {""}
        colour = SIDE_COLOURS[sides.pop() if len(sides) == 1 else ""]
        axes.plot(
            *points[edge, :2].T, color=colour, linewidth=2.6, solid_capstyle="round"
        )
    axes.plot(*points[:, :2].T, "o", color=INK, markersize=2.6, markeredgewidth=0)
    axes.margins(0.08)


def _side(name: str) -> str:
    """Return the side of the body that a landmark's name states: "left", "right" or
    "".
    """
    for side in ("left", "right"):
        if name.startswith((side, side[0])) and name not in ("rump", "nose", "neck"):
            return side
    return ""


SIDE_COLOURS = {"left": "#0072B2", "right": "#B86E00", "": "#007A5E"}
INK = "#1d2430"


def _turn_and_tilt(points: Floats, turn: float, pitch: float) -> Floats:
    """Return points (p, 3) about their mean, turned about the vertical and then tilted,
    in degrees.
    """
    a, b = np.deg2rad([turn, pitch])
    yaw = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
    tilt = np.array([[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]])
    return np.asarray((points - np.nanmean(points, axis=0)) @ (tilt @ yaw).T)


def _draw_mesh(axes: Axes, path: Path) -> None:
    """Draw a mesh from its front, side and above, shaded by a lamp at the viewer."""
    import trimesh
    from matplotlib.collections import PolyCollection

    mesh = trimesh.load_mesh(path)
    vertices = _turn_and_tilt(np.asarray(mesh.vertices), -50, 15)
    triangles = vertices[np.asarray(mesh.faces)]
    triangles = triangles[np.argsort(triangles[:, :, 2].mean(axis=1))]
    first, second = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    normal = np.cross(first, second)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    is_in_front = normal[:, 2] > 0
    lamp = np.array([0.35, 0.65, 0.67])
    light = 0.45 + 0.55 * np.maximum(normal @ lamp, 0)
    colours = np.clip(light[:, None] * np.array([0.62, 0.76, 0.95]), 0, 1)
    shown = PolyCollection(
        list(triangles[is_in_front, :, :2]),
        facecolors=colours[is_in_front],
        edgecolors=colours[is_in_front],
        linewidths=0.2,
    )
    axes.add_collection(shown)
    axes.autoscale_view()


def copy_figure(target: Path, folder: Path, target_of_make: str) -> None:
    """Copy a figure as a command of the project drew it."""
    shutil.copyfile(_made(folder / target.name, target_of_make), target)


def draw_sheet(target: Path) -> None:
    """Draw a sample car: its landmarks over the fitted model, and its mesh."""
    from shapefit.config import ViewConfig
    from shapefit.pipelines.view.run import write_page

    result = _made(DEMO / "cars/result.h5", "demo")
    config = ViewConfig(
        files={"cars": (result,)},
        dictionary=DEMO / "cars/dictionary.h5",
        items=("pickup_1/view_4",),
        output=target,
    )
    list(write_page(config))


def draw_cells(target: Path) -> None:
    """Draw the cells of a proof of a global optimum."""
    from experiments.cells import draw_cells as draw

    draw().savefig(target, dpi=80)


def draw_gallery(target: Path, script: str, shown: str) -> None:
    """Run a script of the gallery and picture what it writes.

    shown is a result, pictured by its page, or a picture.
    """
    from PIL import Image

    with tempfile.TemporaryDirectory() as folder:
        run_script(script, Path(folder))
        picture = Path(folder) / shown
        if picture.suffix == ".h5":
            with page_of(picture) as driver:
                driver.execute_script("shapefit.go(20)")
                picture = picture.with_suffix(".png")
                picture.write_bytes(settled(driver))
        image = Image.open(picture).convert("RGB")
        height = round(GALLERY_WIDTH * image.height / image.width)
        image = image.resize((GALLERY_WIDTH, height))
        image.save(target, quality=90, method=6)


def run_script(script: str, folder: Path) -> None:
    """Run a script of the gallery on a folder for what it writes, with this
    environment's commands.
    """
    shell = "sh" if script.endswith(".sh") else sys.executable
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    line = [shell, f"docs/gallery/{script}", str(folder)]
    subprocess.run(line, cwd=PROJECT, env={**os.environ, "PATH": path}, check=True)


@contextmanager
def page_of(result: Path) -> Iterator[WebDriver]:
    """Yield a browser that shows the page of a result and in which nothing plays."""
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    from shapefit.config import ViewConfig
    from shapefit.pipelines.view.run import write_page

    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium") or "chromium"
    for flag in FLAGS:
        options.add_argument(flag)
    driver = webdriver.Chrome(
        options=options, service=Service(shutil.which("chromedriver"))
    )
    try:
        driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", SIZE)
        driver.execute_cdp_cmd("Emulation.setEmulatedMedia", MOTIONLESS)
        with tempfile.TemporaryDirectory() as folder:
            page = Path(folder) / "page.html"
            files = {result.stem: (result,)}
            list(write_page(ViewConfig(files=files, output=page)))
            driver.get(page.as_uri())
            yield driver
    finally:
        driver.quit()


def settled(driver: WebDriver) -> bytes:
    """Return a photograph (PNG) of the page, taken once it no longer changes."""
    before = b""
    picture: bytes = driver.get_screenshot_as_png()
    while picture != before:
        driver.execute_async_script(PAUSE)
        before, picture = picture, driver.get_screenshot_as_png()
    return picture


def _made(path: Path, target: str) -> Path:
    """Return the path of a file that a target of make makes. Raises MissingInput where
    it is not there.
    """
    if not path.exists():
        raise MissingInput(f"make {target} makes {path.relative_to(PROJECT)}")
    return path


COMMENT_OF_JAVASCRIPT = re.compile(r"/\*.*?\*/|//[^\n]*", re.DOTALL)
"""No text of the page's scripts has // or /* in it."""

VIEWER = (
    "shapefit/viewer/*.css",
    "shapefit/viewer/*.html",
    "shapefit/viewer/scripts/*.js",
)
"""Code of the page."""

SHEETS = ("shapefit/meshes/pictures.py",)
FIGURES = ("shapefit/evaluation/figures.py",)
CELLS = ("experiments/cells.py",)


def _gallery(script: str, shown: str, sources: tuple[str, ...]) -> Picture:
    """Return the Picture that shows what a script of the gallery writes; the script is
    one of its sources.
    """
    draw = partial(draw_gallery, script=script, shown=shown)
    return Picture(draw, (f"docs/gallery/{script}", *sources))


PICTURES = {
    "hero.webp": Picture(draw_hero, VIEWER),
    "classes.png": Picture(draw_classes, ()),
    "sequences.svg": Picture(
        partial(copy_figure, folder=REPORT, target_of_make="mocap-table"), FIGURES
    ),
    "errors.svg": Picture(
        partial(copy_figure, folder=REPORT, target_of_make="mocap-table"), FIGURES
    ),
    "walk.png": Picture(draw_page, VIEWER),
    "pickup.png": Picture(draw_sheet, SHEETS),
    "cells.png": Picture(draw_cells, CELLS),
    "recovery.png": Picture(
        partial(copy_figure, folder=RECOVERY, target_of_make="recovery"),
        ("experiments/figures.py", "experiments/recovery.py"),
    ),
    "gallery/openpose_to_opensim.webp": _gallery(
        "openpose_to_opensim.sh", "walk.h5", VIEWER
    ),
    "gallery/animal_from_deeplabcut.webp": _gallery(
        "animal_from_deeplabcut.sh", "walk.h5", VIEWER
    ),
    "gallery/mediapipe.webp": _gallery("mediapipe.py", "walk.h5", VIEWER),
    "gallery/cars_to_blender.webp": _gallery("cars_to_blender.sh", "sheet.png", SHEETS),
    "gallery/python_arrays.webp": _gallery("python_arrays.py", "ankles.png", ()),
}
"""Every picture of README and docs by its name in docs/images."""


if __name__ == "__main__":
    make_pictures(sys.argv[1:])
