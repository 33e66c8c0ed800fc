"""Pages of real data: motion capture with its truth, detected people, annotated cars."""

import numpy as np
import pytest

from shapefit.config import FitConfig, LearnDictConfig
from shapefit.io import read_results
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
