"""Pages of real data: motion capture with its truth, detected people, annotated cars."""

import numpy as np
import pytest

from shapefit.config import FitConfig, LearnDictConfig, ProjectConfig
from shapefit.io import read_results, read_shapes, write_shapes
from shapefit.pipelines import projection as project
from shapefit.pipelines.fit import run as fit
from shapefit.pipelines.learn_dict import run as learn_dict

pytestmark = pytest.mark.real_data


@pytest.fixture(scope="module")
def lift(tmp_path_factory):
    """Return the function that fits landmarks, and gives the path of the result."""
    folder = tmp_path_factory.mktemp("real")

    def lifted(landmarks, dictionary, name, **settings):
        files = {"landmarks": landmarks, "dictionary": dictionary, "output": folder / f"{name}.h5"}
        list(fit.run(FitConfig(**files, **settings)))
        return folder / f"{name}.h5"

    lifted.folder = folder
    return lifted


@pytest.fixture(scope="module")
def people(real_data, lift):
    """A small dictionary of people: enough to have something to look at."""
    path = lift.folder / "people.h5"
    shapes = real_data / "mocap/subject86_24fps.h5"
    settings = {"every": 40, "k": 12, "iterations": 2}
    list(learn_dict.run(LearnDictConfig(shapes=(shapes,), output=path, **settings)))
    return path


def turns_and_plays(page):
    """Drag and play as a person would; the page follows and complains about nothing."""
    name = page.state("shown[0]")
    before = np.array(page.state(f"projected['{name}']"), dtype=float)
    page.drag("#space", 100, 30)
    after = np.array(page.state(f"projected['{name}']"), dtype=float)
    assert np.abs(after - before).max() > 20
    frame = page.state("frame")
    page.keys(" ")
    page.until(f"return shapefit.frame > {frame}")
    page.keys(" ")
    assert page.complaints() == []
    assert page.requests() == []


def test_motion_capture_with_truth_and_two_methods(real_data, people, lift, view, open_page):
    every = read_shapes([real_data / "mocap/other_subjects_24fps.h5"])
    rows = np.flatnonzero(np.array(every.sequences) == "01_06")
    truth, seen = lift.folder / "truth.h5", lift.folder / "seen.h5"
    write_shapes(truth, every.take(rows))
    camera = {"view": "turntable"}
    list(project.run(ProjectConfig(shapes=(truth,), output=seen, camera=camera)))
    files = {m: (lift((seen,), people, m, method=m),) for m in ("convex", "mean-shape")}
    made = view(files, truth=(truth,))
    page = open_page(made.path, "#item=01_06/01000")
    assert page.state("data.count") == len(rows) > 1000
    found = read_results(files["convex"][0])
    shown = page.run("return Array.from(shapefit.layer('convex').points(shapefit.frame))")
    expected = found.shapes[found.items.index("01_06/01000")]
    np.testing.assert_allclose(np.reshape(shown, (-1, 3)).T, expected, atol=1e-3)
    assert "error" in page.text("#state")
    turns_and_plays(page)


def test_detected_people_in_the_image_plane(real_data, people, lift, view, open_page):
    landmarks = real_data / "detected/pose2sim_balancing/cam01_joints13.h5"
    made = view({"detected": (lift((landmarks,), people, "detected", method="convex+refine"),)})
    page = open_page(made.path)
    assert (page.state("data.unit"), page.state("data.yDown")) == ("px", True)
    seen = np.array(page.state("landmarks"), dtype=float)
    assert 100 < np.nanmedian(seen) < 2000
    turns_and_plays(page)


def test_a_hundred_cars_with_meshes(real_data, lift, view, open_page):
    dictionary = lift.folder / "cars.h5"
    models = real_data / "cars/models.h5"
    settings = {"method": "exemplars", "align": "none", "output": dictionary}
    list(learn_dict.run(LearnDictConfig(shapes=(models,), **settings)))
    landmarks = real_data / "cars/annotated_cars.h5"
    result = lift((landmarks,), dictionary, "annotated", leave_out="true_model", **{"lambda": 1.0})
    items = read_results(result).items[:100]
    made = view({"cars": (result,)}, truth=(models,), match="true_model", items=items)
    page = open_page(made.path)
    assert page.state("data.count") == 100
    assert page.run("return shapefit.layer('cars').mesh(0).length") == 1352 * 3
    turns_and_plays(page)
