"""Photograph pages for README and the gallery, and animate one: python
tools/page_pictures.py.

Reads the walk of `make demo` and runs docs/gallery. Needs chromium and chromedriver,
and selenium and Pillow of the extra `test-all`.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from base64 import b64decode
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from math import pi, sin
from pathlib import Path
from typing import Any

from PIL import Image
from selenium import webdriver
from selenium.webdriver.chrome.service import Service

from shapefit.config import ViewConfig
from shapefit.pipelines.view.run import view_files

PROJECT = Path(__file__).resolve().parents[1]
DEMO, IMAGES = PROJECT / "results/demo", PROJECT / "docs/images"
FLAGS = ("--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars")
SIZE = {"width": 1280, "height": 720, "deviceScaleFactor": 2, "mobile": False}
MOTIONLESS = {"features": [{"name": "prefers-reduced-motion", "value": "reduce"}]}
PAUSE = "setTimeout(arguments[0], 300)"
"""The words under the chart follow the picture after a moment."""
RESULT, ITEM = "walk", "openpose/person 1/20"
STEPS, SECONDS, TURN = 72, 3.6, 40.0
"""Pictures of the animation, its length, and degrees by which the view turns to either
side.
"""
BUDGET = 1_500_000
"""Bytes of the animation, at most."""
GALLERY = {
    "openpose_to_opensim.sh": "walk.h5",
    "animal_from_deeplabcut.sh": "walk.h5",
    "mediapipe.py": "walk.h5",
    "cars_to_blender.sh": "sheet.png",
    "python_arrays.py": "ankles.png",
}
"""Script of docs/gallery -> what it writes that is shown: a result, by its page, or a
picture.
"""
WIDTH = 1000
"""Pixels of a picture of the gallery."""

STAGE = """
  for (const part of document.querySelectorAll("header, main, footer")) {
    part.hidden = true;
  }
  document.body.style.display = "block";
  // Small panels show the people, not the border of the image.
  shapefit.data.image = null;
  const widths = [["plane", 230], ["space", 320], ["chart", 250]];
  window.panels = widths.map(([name, width]) => {
    const canvas = document.createElement("canvas");
    const style = { width: `${width}px`, height: "276px", display: "inline-block" };
    Object.assign(canvas.style, style);
    document.body.append(canvas);
    return { name, width, canvas };
  });
"""
PAINT = """
  const [time, yaw, titles] = arguments;
  const { data, view } = shapefit;
  Object.assign(view, { frame: data.recordings[0].tracks[0].frames[time], yaw });
  const size = { width: 800, height: 300 };
  const whole = Object.assign(document.createElement("canvas"), size);
  const context = whole.getContext("2d");
  Object.assign(context, { fillStyle: "white", font: "13px system-ui, sans-serif" });
  context.fillRect(0, 0, 800, 300);
  let left = 0;
  panels.forEach(({ name, width, canvas }, number) => {
    if (name === "plane") plane.draw(canvas, data, view);
    if (name === "space") space.draw(canvas, data, view);
    if (name === "chart") {
      const rows = shapefit.chart().map((row) => ({ ...row, states: [] }));
      chart.draw(look.pen(canvas), rows, { unit: "°", rate: data.frame_rate });
      const pen = canvas.getContext("2d");
      const [from, to] = [chart.LEFT, width - chart.RIGHT];
      pen.fillStyle = look.text("ink");
      const middle = (time + 0.5) / rows[0].values.length;
      pen.fillRect(from + (to - from) * middle, 6, 2, 248);
    }
    context.drawImage(canvas, left, 24, width, 276);
    context.fillStyle = look.text("faint");
    context.fillText(titles[number], left + 12, 16);
    left += width;
  });
  return whole.toDataURL("image/png").split(",")[1];
"""
TITLES = ("landmarks of one camera", "3D with error bars", "knee angle")


def photograph(demo: Path, images: Path) -> None:
    """Take the picture of the page of the walk in `demo`, and the animation, into
    `images`.
    """
    with page_of(demo / f"{RESULT}.h5") as driver:
        go = "shapefit.go(shapefit.data.items.indexOf(arguments[0]))"
        driver.execute_script(go, ITEM)
        (images / f"{RESULT}.png").write_bytes(settled(driver))
        animate(driver, images / "hero.webp")


def illustrate_gallery(images: Path) -> None:
    """Run the scripts of the gallery; write a picture of each into `images`."""
    for script, shown in GALLERY.items():
        with tempfile.TemporaryDirectory() as folder:
            run_script(script, Path(folder))
            picture = Path(folder) / shown
            if picture.suffix == ".h5":
                with page_of(picture) as driver:
                    driver.execute_script("shapefit.go(20)")
                    picture = picture.with_suffix(".png")
                    picture.write_bytes(settled(driver))
            image = Image.open(picture).convert("RGB")
            image = image.resize((WIDTH, round(WIDTH * image.height / image.width)))
            image.save(images / f"{Path(script).stem}.webp", quality=90, method=6)


def run_script(script: str, folder: Path) -> None:
    """Run a script of the gallery in the clone, with the commands of this
    environment.
    """
    shell = "sh" if script.endswith(".sh") else sys.executable
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    line = [shell, f"docs/gallery/{script}", str(folder)]
    subprocess.run(line, cwd=PROJECT, env={**os.environ, "PATH": path}, check=True)


@contextmanager
def page_of(result: Path, **keys: Any) -> Iterator[Any]:
    """Open the page of a result, with keys of `view`, in a browser in which nothing
    plays.
    """
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
            list(
                view_files(
                    ViewConfig(files={result.stem: (result,)}, output=page, **keys)
                )
            )
            driver.get(page.as_uri())
            yield driver
    finally:
        driver.quit()


def settled(driver: Any) -> bytes:
    """Return a picture (PNG) of the page once it no longer changes."""
    before, picture = b"", driver.get_screenshot_as_png()
    while picture != before:
        driver.execute_async_script(PAUSE)
        before, picture = picture, driver.get_screenshot_as_png()
    return picture


def animate(driver: Any, target: Path) -> None:
    """Write landmarks, the turning skeleton and an angle, drawn by the page itself, as
    WebP.
    """
    driver.execute_script(STAGE)
    length = driver.execute_script("return shapefit.data.recordings[0].length")
    pictures = []
    for step in range(STEPS):
        yaw = 30 + TURN * sin(2 * pi * step / STEPS)
        png = driver.execute_script(PAINT, step % length, yaw, TITLES)
        pictures.append(Image.open(BytesIO(b64decode(png))).convert("RGB"))
    pause = round(1000 * SECONDS / STEPS)
    how: dict[str, Any] = {
        "save_all": True,
        "duration": pause,
        "loop": 0,
        "quality": 80,
        "method": 4,
    }
    pictures[0].save(target, append_images=pictures[1:], **how)
    if target.stat().st_size > BUDGET:
        raise RuntimeError(
            f"{target} has {target.stat().st_size} bytes: lower its quality"
        )


if __name__ == "__main__":
    photograph(DEMO, IMAGES)
    illustrate_gallery(IMAGES / "gallery")
