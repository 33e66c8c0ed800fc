"""A browser to open pages in, and a made scene to show."""

import json
import os
import shutil
import time
from types import SimpleNamespace

import numpy as np
import pytest

from shapefit.geometry.rotations import rotation_about

ONE_COMMAND = "apt-get install chromium chromium-driver nodejs"
FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--window-size=1400,900",
    "--force-device-scale-factor=1",
    "--force-prefers-reduced-motion",
)
"""As root and without a display; nothing of the browser's own goes to the network."""


def require(program: str) -> str:
    """Return the path of a program; skip, or fail in continuous integration, where it
    is absent.
    """
    path = shutil.which(program)
    if path is None:
        reason = f"{program} is not installed: {ONE_COMMAND}"
        if os.environ.get("SHAPEFIT_REQUIRE_BROWSER") == "1":
            pytest.fail(reason)
        pytest.skip(reason)
    return path


@pytest.fixture(scope="session")
def browser(tmp_path_factory):
    """One browser for all tests of a process."""
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = require("chromium")
    for flag in (*FLAGS, f"--user-data-dir={tmp_path_factory.mktemp('chromium')}"):
        options.add_argument(flag)
    options.set_capability(
        "goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"}
    )
    driver = webdriver.Chrome(options=options, service=Service(require("chromedriver")))
    driver.set_page_load_timeout(30)
    driver.set_script_timeout(30)
    yield driver
    driver.quit()


EXPECTED_OF_SOFTWARE_RENDERING = ("WebGL", "GPU stall")


class Opened:
    """A page in the browser, and what a person does with it."""

    def __init__(self, driver, path):
        self.driver = driver
        self.path = path

    def state(self, name):
        return self.driver.execute_script(f"return window.shapefit.{name}")

    def run(self, script, *arguments):
        return self.driver.execute_script(script, *arguments)

    def find(self, selector):
        return self.driver.find_element("css selector", selector)

    def text(self, selector):
        """Return a text on the page; some follow the pictures after a moment."""
        time.sleep(0.15)
        return self.find(selector).text

    def settle(self):
        """Wait until what was asked for is drawn."""
        self.driver.execute_async_script(
            "const done = arguments[0]; requestAnimationFrame(() =>"
            " requestAnimationFrame(done))"
        )

    def keys(self, *keys, alt=False):
        """Press keys, given as what they type or by their names in selenium."""
        from selenium.webdriver import ActionChains, Keys

        actions = ActionChains(self.driver)
        if alt:
            actions.key_down(Keys.ALT)
        actions.send_keys(*(getattr(Keys, key, key) for key in keys))
        if alt:
            actions.key_up(Keys.ALT)
        actions.perform()
        self.settle()

    def click(self, selector):
        self.find(selector).click()
        self.settle()

    def drag(self, selector, dx, dy):
        from selenium.webdriver import ActionChains

        box = self.find(selector)
        ActionChains(self.driver).move_to_element(box).click_and_hold().move_by_offset(
            dx, dy
        ).release().perform()
        self.settle()

    def until(self, script, seconds=10):
        """Wait until a script returns something true."""
        end = time.monotonic() + seconds
        while not (value := self.driver.execute_script(script)):
            assert time.monotonic() < end, f"not within {seconds} s: {script}"
            time.sleep(0.02)
        return value

    def complaints(self):
        """What the console says, but for what software rendering always says."""
        entries = self.driver.get_log("browser")
        return [
            entry["message"]
            for entry in entries
            if not any(
                word in entry["message"] for word in EXPECTED_OF_SOFTWARE_RENDERING
            )
        ]

    def requests(self):
        """The addresses that were asked for, but for the page itself and what is
        inlined.
        """
        asked = []
        for entry in self.driver.get_log("performance"):
            message = json.loads(entry["message"])["message"]
            if message["method"] != "Network.requestWillBeSent":
                continue
            if message["params"]["documentURL"].startswith(
                "file:"
            ):  # not the browser's start page
                asked.append(message["params"]["request"]["url"])
        own = self.path.as_uri()
        return [url for url in asked if not url.startswith((own, "data:"))]


@pytest.fixture
def open_page(browser):
    """Return the function that opens a page and waits until it is drawn."""

    def opened(path, fragment=""):
        browser.get("about:blank")
        browser.get_log("browser")
        browser.get_log("performance")
        browser.get(path.as_uri() + fragment)
        page = Opened(browser, path)
        page.settle()
        return page

    return opened


@pytest.fixture(scope="session")
def view(tmp_path_factory):
    """Return the function that runs `view` and gives the page and the outcome."""
    from shapefit.config import ViewConfig
    from shapefit.pipelines.view.run import view_files

    def viewed(files, **settings):
        output = tmp_path_factory.mktemp("view") / "page.html"
        (outcome,) = view_files(ViewConfig(files=files, output=output, **settings))
        return SimpleNamespace(
            path=output, outcome=outcome, text=output.read_text("utf-8")
        )

    return viewed


N, NAMES = 600, ("head", "hand", "foot", "knee")


@pytest.fixture(scope="session")
def sequence(tmp_path_factory):
    """600 frames of four landmarks in two sequences; no two frames are alike."""
    from tests.pipelines.view.conftest import write_result, write_truth

    folder = tmp_path_factory.mktemp("sequence")
    rng = np.random.default_rng(3)
    base = rng.normal(size=(3, 4)) * 40
    rotation = rotation_about(np.eye(3)[1], np.linspace(0, 6, N))
    shapes = rotation @ base + np.array([300.0, 200, 0])[:, None]
    landmarks = shapes[:, :2] + 0.3 * rng.normal(size=(N, 2, 4))
    landmarks[::7, :, 2] = np.nan
    items = tuple(f"{'walk' if i < 400 else 'jump'}/{i:04d}" for i in range(N))
    names = {
        "landmark_names": NAMES,
        "items": items,
        "sequences": [item[:4] for item in items],
    }
    status = np.array(["optimal"] * N, dtype=object)
    status[123] = "iteration limit"
    seen = {"landmarks": landmarks.swapaxes(1, 2)}
    how = {"landmarks_fitted": shapes[:, :2], "y_axis": "down", "frame_rate": 50.0}
    result = write_result(
        folder / "walker.h5", shapes, seen, status=status, **names, **how
    )
    true, edges = (
        base + 3 * rng.normal(size=(N, 3, 4)),
        np.array([[0, 1], [1, 2], [2, 3]]),
    )
    truth = write_truth(folder / "truth.h5", true, edges=edges, unit="mm", **names)
    return SimpleNamespace(
        shapes=shapes, landmarks=landmarks, result=result, truth=truth
    )
