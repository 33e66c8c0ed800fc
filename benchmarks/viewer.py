"""Pages of `shapefit view`: their size, the time to write and to open them, frames per second.

`python -m benchmarks.viewer [--data FOLDER]` needs chromium and chromium-driver, whose renderer is
software here: any graphics card is faster. FOLDER is that of the real data (mocap, cars, detected).
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from selenium import webdriver
from selenium.webdriver.chrome.service import Service

from shapefit.config import FitConfig, LearnDictConfig, ProjectConfig, ViewConfig
from shapefit.config.commands.project import CameraConfig
from shapefit.io import ResultSet, read_shapes, result_writer, write_shapes
from shapefit.pipelines import projection as project
from shapefit.pipelines.fit import run as fit
from shapefit.pipelines.learn_dict import run as learn_dict
from shapefit.pipelines.view.run import run

FLAGS = (
    "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--window-size=1400,900",
)  # fmt: skip

SECONDS = 5
TURNING = """
  const [seconds, done] = arguments;
  const began = performance.now(), drawn = shapefit.drawn, count = shapefit.data.count;
  const step = () => {
    const passed = performance.now() - began;
    if (passed > 1000 * seconds) { done((shapefit.drawn - drawn) / passed * 1000); return; }
    shapefit.turn(2, 0);
    shapefit.go((shapefit.frame + 1) % count);
    requestAnimationFrame(step);
  };
  requestAnimationFrame(step);
"""


@dataclass(frozen=True)
class Case:
    """What a page shows."""

    name: str
    config: ViewConfig


def made_result(path: Path, frames: int) -> Path:
    """Write a result of 15 landmarks and as many frames as asked for."""
    rng = np.random.default_rng(0)
    base = rng.normal(size=(3, 15))
    with result_writer(path) as writer:
        for start in range(0, frames, 50_000):
            n = min(50_000, frames - start)
            phase = np.arange(start, start + n) / 50
            shapes = base + 0.2 * np.sin(phase[:, None, None] + base)
            writer.append(
                ResultSet(
                    shapes=shapes,
                    landmarks_fitted=shapes[:, :2],
                    relative_gap=10 ** rng.uniform(-9, -4, n),
                    status=np.array(["optimal"] * n, dtype=object),
                    landmark_names=tuple(f"landmark{j}" for j in range(15)),
                    items=tuple(f"walking/{i:07d}" for i in range(start, start + n)),
                    sequences=("walking",) * n,
                    unit="m",
                    columns={"landmarks": shapes[:, :2].swapaxes(1, 2)},
                )
            )
    return path


def made_cases(folder: Path) -> Iterator[Case]:
    """Yield pages of made results, the last of more frames than a page holds."""
    for frames in (10_000, 1_000_000):
        path = made_result(folder / f"made{frames}.h5", frames)
        yield Case(f"made, {frames:,} frames", ViewConfig(files={"made": (path,)}))


def real_cases(data: Path, folder: Path) -> Iterator[Case]:
    """Yield a sequence with its truth and two methods, detected landmarks, and 100 cars."""
    people = folder / "people.h5"
    learn(data / "mocap/subject86_24fps.h5", people, every=6, k=48, iterations=5)
    truth, seen = folder / "truth.h5", folder / "seen.h5"
    every = read_shapes([data / "mocap/other_subjects_24fps.h5"])
    assert every.sequences is not None
    rows = [row for row, sequence in enumerate(every.sequences) if sequence == "01_06"]
    write_shapes(truth, every.take(rows))
    view = CameraConfig(view="turntable")
    list(project.run(ProjectConfig(shapes=(truth,), output=seen, camera=view)))
    methods = {m: (lift(seen, people, folder / f"{m}.h5", m),) for m in ("convex", "convex+refine")}
    yield Case("motion capture, truth, two methods", ViewConfig(files=methods, truth=(truth,)))

    detected = data / "detected/pose2sim_balancing/cam01_joints13.h5"
    found = lift(detected, people, folder / "detected.h5", "convex+refine")
    yield Case("detected people", ViewConfig(files={"detected": (found,)}))

    models, cars = folder / "models.h5", folder / "cars100.h5"
    learn(data / "cars/models.h5", models, method="exemplars", align="none")
    first_rows(data / "cars/annotated_cars.h5", cars, 100)
    fitted = lift(cars, models, folder / "cars.h5", "convex+refine", leave_out="true_model")
    yield Case("cars, one mesh", ViewConfig(files={"cars": (fitted,)}))


def learn(shapes: Path, output: Path, **settings: Any) -> None:
    list(learn_dict.run(LearnDictConfig(shapes=(shapes,), output=output, **settings)))


def lift(landmarks: Path, dictionary: Path, output: Path, method: str, **settings: Any) -> Path:
    files: dict[str, Any] = {
        "landmarks": landmarks, "dictionary": dictionary, "output": output, "method": method,
    }  # fmt: skip
    list(fit.run(FitConfig(**files, **settings)))
    return output


def first_rows(source: Path, target: Path, count: int) -> None:
    """Copy the first items of a landmark file."""
    with h5py.File(source) as old, h5py.File(target, "w") as new:
        n = len(old["item"])
        new.attrs.update(old.attrs)
        for name, dataset in old.items():
            per_item = dataset.shape[:1] == (n,)
            values = dataset[:count] if per_item else dataset[()]
            new.create_dataset(name, data=values, dtype=dataset.dtype)


@contextmanager
def browser(folder: Path) -> Iterator[webdriver.Chrome]:
    options = webdriver.ChromeOptions()
    options.binary_location = "/usr/bin/chromium"
    for flag in (*FLAGS, f"--user-data-dir={folder}"):
        options.add_argument(flag)
    driver = webdriver.Chrome(options=options, service=Service("/usr/bin/chromedriver"))
    driver.set_script_timeout(60)
    try:
        yield driver
    finally:
        driver.quit()


def measure(case: Case, page: Path, driver: webdriver.Chrome, repeats: int) -> str:
    """Write and open the page; return its row, times as medians."""
    began = time.perf_counter()
    (outcome,) = run(case.config.model_copy(update={"output": page}))
    written = time.perf_counter() - began
    opened = []
    for _ in range(repeats):
        driver.get("about:blank")
        driver.get(page.as_uri())
        while not (first := driver.execute_script("return window.shapefit?.opened")):
            time.sleep(0.02)
        opened.append(first / 1000)
    rate = driver.execute_async_script(TURNING, SECONDS)
    size = page.stat().st_size / 1e6
    return (
        f"| {case.name} | {outcome.done:,} | {size:.1f} | {written:.1f} | "
        f"{np.median(opened):.2f} | {rate:.0f} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, help="folder of the real data")
    parser.add_argument("--repeats", type=int, default=5)
    arguments = parser.parse_args()
    print("| page | frames shown | MB | s to write | s to open | frames/s |")
    print("|---|--:|--:|--:|--:|--:|")
    with tempfile.TemporaryDirectory() as name, browser(Path(name) / "profile") as driver:
        folder = Path(name)
        cases = list(real_cases(arguments.data, folder)) if arguments.data else []
        for case in (*cases, *made_cases(folder)):
            print(measure(case, folder / "page.html", driver, arguments.repeats), flush=True)


if __name__ == "__main__":
    main()
