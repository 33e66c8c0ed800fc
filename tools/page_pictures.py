"""Photograph pages of `make demo` for README and docs: python tools/page_pictures.py.

Needs chromium and chromedriver, and selenium of the extra `test-all`.
"""

from __future__ import annotations

import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path

from selenium import webdriver
from selenium.webdriver.chrome.service import Service

from shapefit.config import ViewConfig
from shapefit.pipelines.view.run import run

PROJECT = Path(__file__).resolve().parents[1]
DEMO, IMAGES = PROJECT / "results/demo", PROJECT / "docs/images"
FLAGS = ("--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars")
SIZE = {"width": 1280, "height": 720, "deviceScaleFactor": 2, "mobile": False}
MOTIONLESS = {"features": [{"name": "prefers-reduced-motion", "value": "reduce"}]}
DRAWN = "setTimeout(arguments[0], 300)"
"""The words under the strip follow the picture after a moment."""


@dataclass(frozen=True)
class Photograph:
    """Of the page of one result of the demo: an item."""

    name: str
    result: str
    item: str


PHOTOGRAPHS = (Photograph("walk", "walk.h5", "openpose/person 1/20"),)


def photograph(demo: Path, images: Path) -> None:
    """Make the pages of the results in `demo` anew and take each picture into `images`."""
    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium") or "chromium"
    for flag in FLAGS:
        options.add_argument(flag)
    driver = webdriver.Chrome(options=options, service=Service(shutil.which("chromedriver")))
    try:
        driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", SIZE)
        driver.execute_cdp_cmd("Emulation.setEmulatedMedia", MOTIONLESS)
        with tempfile.TemporaryDirectory() as folder:
            for each in PHOTOGRAPHS:
                page = Path(folder) / f"{each.name}.html"
                list(run(ViewConfig(files={each.name: (demo / each.result,)}, output=page)))
                driver.get(page.as_uri())
                go = "shapefit.go(shapefit.data.items.indexOf(arguments[0]))"
                driver.execute_script(go, each.item)
                driver.execute_async_script(DRAWN)
                driver.save_screenshot(str(images / f"{each.name}.png"))
    finally:
        driver.quit()


if __name__ == "__main__":
    photograph(DEMO, IMAGES)
