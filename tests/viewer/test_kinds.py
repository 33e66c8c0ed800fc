"""What people bring, opened as they would; meshes that the browser blends are those of
`fit`.
"""

from dataclasses import dataclass, field

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose
from shapefit.cli.main import run

from shapefit.geometry.procrustes import similarity_transform
from shapefit.io import read_results
from shapefit.pipelines.meshes import write_meshes
from tests.columns import put
from tests.pipelines.fitted import fit_file

SMOOTH = 30
"""Frames a second that a page of 10,000 frames draws."""


@dataclass(frozen=True)
class Kind:
    """Files of `fit` or of the samples, and what their page has."""

    landmarks: str
    fit: tuple[str, ...]
    view: dict[str, str] = field(default_factory=dict)
    output: str = "result.h5"
    learn: tuple[str, ...] = ()
    bodies: int = 1
    facts: tuple[str, ...] = ()
    chart: str = "knee angle r"
    plays: bool = True
    image: bool = True


WALK = ("--frame-rate", "25", "--image-size", "1280x720", "--keypoints", "body_25")
BEAM, TABLES = "{data}/pose2sim_balancing/cam01.h5", "m.metres.csv"
TWO = ("2 individuals", "36 frames", "25 Hz")
CARS = ("--method", "convex+refine", "--set", "lambda=1", "--set", "camera.focal=files")
MODELS = ("{samples}/cars.h5", "--method", "exemplars", "--set", "align=none")
RATS = ("{data}/rat7m/prior_shapes.h5", "--set", "prior.components=1")
KINDS = {
    "walkers": Kind("{samples}/openpose", WALK, bodies=2, facts=TWO),
    "TRC": Kind(
        "{samples}/openpose", WALK, output="m.trc", bodies=2, facts=TWO, image=False
    ),
    "tables": Kind(
        "{samples}/openpose", WALK, output=TABLES, bodies=2, facts=TWO, image=False
    ),
    "dog": Kind(
        "{samples}/animal_walk.csv",
        ("--frame-rate", "25"),
        learn=("{samples}/animal_train.h5",),
        view={"truth": "{samples}/animal_truth.h5"},
        bodies=2,
        chart="hip flexion r",
        facts=("100 frames", "25 Hz"),
    ),
    "cars": Kind(
        "{samples}/cars_views.h5",
        CARS,
        learn=MODELS,
        view={"dictionary": "dictionary.h5"},
        plays=False,
        chart="reprojection",
        facts=("108 images",),
    ),
    "beam": Kind(BEAM, ("--frame-rate", "60"), facts=("100 frames",)),
    "desk": Kind(
        "{data}/pyxy3d_desk/port_1.h5", ("--frame-rate", "25"), facts=("267 frames",)
    ),
    "rat": Kind(
        "{data}/rat7m/camera1.h5",
        ("--method", "posterior"),
        learn=RATS,
        bodies=2,
        view={"truth": "{data}/rat7m/camera1_truth.h5"},
        chart="error against the truth",
        facts=("100 frames",),
    ),
}


@pytest.fixture
def made(request, view, project, tmp_path_factory):
    """The page of a kind, made by the commands that make it."""
    kind = KINDS[request.param]
    folder = tmp_path_factory.mktemp("kind")
    places = {"samples": str(project / "sample_data"), "data": ""}
    if "{data}" in kind.landmarks:
        places["data"] = str(request.getfixturevalue("real_data") / "detected")
    dictionary = "people"
    if kind.learn:
        dictionary = str(folder / "dictionary.h5")
        learn = ("learn-dict", *kind.learn, "-o", dictionary)
        assert run([part.format(**places) for part in learn]) == 0
    result = folder / kind.output
    line = [
        "fit",
        kind.landmarks.format(**places),
        "-d",
        dictionary,
        *kind.fit,
        "-o",
        str(result),
    ]
    assert run(line) in (0, 1)
    each = f"*person_[12]*{result.suffix}"
    files = [result] if result.exists() else sorted(folder.glob(each))
    keys = {name: text.format(**places) for name, text in kind.view.items()}
    if "dictionary" in keys:
        keys["dictionary"] = folder / keys["dictionary"]
    if "truth" in keys:
        keys["truth"] = (keys["truth"],)
    return kind, view({file.stem: (file,) for file in files}, **keys)


@pytest.mark.slow
@pytest.mark.parametrize("made", KINDS, indirect=True)
def test_a_page_of_each_kind(made, open_page):
    kind, viewed = made
    page = open_page(viewed.path)
    assert page.run("return [shapefit.view.yaw, shapefit.view.pitch]") == [30, 15]
    facts = page.text("#facts").split("\n")
    assert facts[: len(kind.facts)] == list(kind.facts)
    assert (
        page.run("return look.bodiesOf(shapefit.data, shapefit.view).length")
        == kind.bodies
    )
    assert page.find("#play").is_displayed() == kind.plays
    assert page.find("#flat").is_displayed() == kind.image
    assert page.run("return document.getElementById('measure').value") == kind.chart
    (first, *_) = page.run("return shapefit.chart().map(({ values }) => values)")
    assert len(first) == page.run("return shapefit.data.recordingOf(0).length")
    before = page.find("#marker").rect["x"]
    page.keys("ARROW_RIGHT", "ARROW_RIGHT")
    assert page.state("view.frame") == 2
    assert page.find("#marker").rect["x"] > before  # the chart follows
    if kind.plays:
        page.keys(" ")
        page.until("return shapefit.view.frame > 4")
        page.keys(" ")
    assert page.run("return shapefit.paint().width") > 100
    assert page.complaints() == []
    assert page.requests() == []


@pytest.mark.slow
def test_ten_thousand_frames_play_smoothly(view, project, tmp_path, open_page):
    from shapefit.io import read_results, result_writer

    walk = tmp_path / "walk.h5"
    assert (
        run(["fit", str(project / "sample_data/openpose"), *WALK, "-o", str(walk)]) == 0
    )
    few, n = read_results(walk), 10_000
    rows = [frame % 36 for frame in range(n)]
    long = few.take(rows).replaced(
        items=tuple(map(str, range(n))), sequences=("walk",) * n, frame_rate=60.0
    )
    long = put(long, {"frame": np.arange(n)})
    with result_writer(tmp_path / "long.h5") as writer:
        writer.append(long)
    page = open_page(view({"long": (tmp_path / "long.h5",)}).path)
    assert page.run("return shapefit.data.count") == n
    page.keys(" ")
    drawn, began = page.run("return [shapefit.view.drawn, performance.now()]")
    page.until(f"return performance.now() - {began} > 3000")
    later, ended = page.run("return [shapefit.view.drawn, performance.now()]")
    assert (later - drawn) / (ended - began) * 1000 >= SMOOTH


ITEMS = ("sedan_2/view_1", "pickup_1/view_4")
MESH = "return Array.from(shapefit.layer(arguments[0]).mesh(shapefit.view.frame))"
POINTS = "return Array.from(shapefit.layer(arguments[0]).points(shapefit.view.frame))"
IN_IMAGE = """
  const layer = shapefit.layer(arguments[0]);
  const points = layer.points(shapefit.view.frame);
  return Array.from(layer.inImage(shapefit.view.frame, points));
"""


@pytest.fixture(scope="module")
def cars(world, tmp_path_factory):
    """Made cars, fitted in weak perspective and under a camera, with the meshes of two
    of them.
    """
    folder = tmp_path_factory.mktemp("cars")
    cameras = {"weak": {}, "perspective": {"focal": "files"}}
    for name, camera in cameras.items():
        keys = {"method": "convex+refine", "camera": camera, "lambda": 1.0}
        result, dictionary = folder / f"{name}.h5", world.dictionary("cars")
        fit_file(world.images("cars"), dictionary, result, **keys)
        list(write_meshes((result,), dictionary, folder / name, "ply"))
    return folder


@pytest.fixture(scope="module")
def cars_page(cars, view, project, world):
    files = {name: (cars / f"{name}.h5",) for name in ("weak", "perspective")}
    truth = (project / "sample_data/cars.h5",)
    return view(
        files, truth=truth, match="true_model", dictionary=world.dictionary("cars")
    )


@pytest.mark.parametrize("method", ["weak", "perspective"])
@pytest.mark.parametrize("item", ITEMS)
def test_a_blended_mesh_is_the_exported_one(cars_page, cars, open_page, method, item):
    """In the space of the page, which differs by a similarity."""
    results = read_results(cars / f"{method}.h5")
    row = results.items.index(item)
    page = open_page(cars_page.path, f"#item={item}")
    mesh, points = (
        np.array(page.run(each, method)).reshape(-1, 3).T for each in (MESH, POINTS)
    )
    shape = results.as_columns()[row]
    exported = trimesh.load(cars / method / f"{item}.ply", process=False).vertices.T
    turned = results.rotation[row] @ exported
    for shown, expected in ((points, shape), (mesh, turned)):
        away = similarity_transform(expected, shown).apply(expected) - shown
        assert np.abs(away).max() < 1e-4 * np.ptp(shown)
    spans = np.ptp(mesh, axis=1), np.ptp(turned, axis=1)
    assert 1 < spans[0][1] < 3  # metres
    if method == "perspective":  # this one is where the camera has it: not turned
        assert_allclose(spans[0] / spans[0][0], spans[1] / spans[1][0], rtol=1e-3)


def test_landmarks_are_seen_where_the_camera_sees_them(cars_page, cars, open_page):
    results = read_results(cars / "perspective.h5")
    row = results.items.index(ITEMS[0])
    page = open_page(cars_page.path, f"#item={ITEMS[0]}")
    seen = np.array(page.run(IN_IMAGE, "perspective")).reshape(-1, 2)
    size = np.ptp(results.landmarks_fitted[row])
    assert_allclose(seen, results.landmarks_fitted[row], atol=1e-3 * size)
    flat = results.shapes[row, :, :2]
    assert np.abs(flat - results.landmarks_fitted[row]).max() > 1e-2 * size


def test_the_mesh_of_the_truth_lies_on_the_result(cars_page, open_page):
    page = open_page(cars_page.path, f"#item={ITEMS[0]}")
    fitted = np.array(page.run(MESH, "weak")).reshape(-1, 3)
    true = np.array(page.run(MESH, "truth")).reshape(-1, 3)
    assert np.abs(fitted.mean(axis=0) - true.mean(axis=0)).max() < 0.05 * np.ptp(fitted)
    assert page.complaints() == []
