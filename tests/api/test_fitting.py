"""`shapefit.learn` and `fit` make what the commands make, bit for bit, and refuse the same."""

from pathlib import Path

import numpy as np
import pytest

import shapefit
from shapefit.config import load_config
from shapefit.lifting.methods import METHODS
from shapefit.pipelines.fit.run import run

from .conftest import run_command, same_file


@pytest.mark.parametrize("method", ["sparse-coding", "pca-bases", "exemplars"])
def test_learn_makes_what_the_command_makes(tmp_path, people, sample, method):
    prior = {"components": 2, "floor": 0.01}
    keys = {"k": 24, "iterations": 2, "prior": prior} if method == "sparse-coding" else {}
    shapes = shapefit.read_shapes(sample / "people_train.h5")
    made = shapefit.learn(shapes, method=method, every=20, **keys)
    shapefit.write_dictionary(tmp_path / "made.h5", made)
    same_file(people[method], tmp_path / "made.h5")


def test_learn_takes_arrays_and_warns_of_those_that_cannot_be_used(sample):
    shapes = shapefit.read_shapes(sample / "people_train.h5").shapes[::60].copy()
    shapes[4] = 1.0
    with pytest.warns(UserWarning, match="1 shape cannot be used; 4, for one: all its landmarks"):
        made = shapefit.learn(shapes, method="exemplars")
    assert made.atoms.shape == (31, 15, 3)
    assert made.landmark_names == tuple(map(str, range(15)))


LEARN = [
    (np.ones((4, 15, 2)), {}, r"^shapes: has the shape \(4, 15, 2\); it must be \(n, p, 3\)"),
    (np.full((4, 15, 3), np.nan), {}, r"^shapes\[0\]: landmark '0' is \(nan, nan, nan\)"),
    (np.ones((4, 5, 3)), {"k": 0}, r"^learn\.k: expected a whole number >= 1, found 0"),
    (np.ones((4, 5, 3)), {"kk": 0}, r"^learn\.kk: unknown key"),
]


@pytest.mark.parametrize(("shapes", "options", "message"), LEARN)
def test_learn_names_the_place_of_an_error(shapes, options, message):
    with pytest.raises(shapefit.InputError, match=message):
        shapefit.learn(shapes, **options)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_fit_finds_what_the_command_finds(tmp_path, people, views, method):
    dictionary = str(people["pca-bases" if method == "pmp" else "sparse-coding"])
    paths = {"landmarks": str(views), "output": str(tmp_path / "command.h5")}
    run_command("fit", **paths, dictionary=dictionary, method=method)
    fit = shapefit.fit(shapefit.read_landmarks(views), dictionary, method=method)
    shapefit.write_results(tmp_path / "function.h5", fit)
    same_file(tmp_path / "command.h5", tmp_path / "function.h5")
    assert (len(fit), fit.attributes["method"]) == (150, method)


def test_arrays_and_matrices_of_cameras_are_enough(people, views):
    atoms = shapefit.read_dictionary(people["sparse-coding"])
    images = shapefit.read_landmarks(views)
    named = shapefit.fit(images, atoms, method="convex")
    plain = shapefit.fit(images.landmarks, atoms, weights=images.confidence, method="convex")
    np.testing.assert_array_equal(plain.shapes, named.shapes)
    assert plain.items[:2] == ("0", "1")
    assert plain.landmarks_fitted is None  # which are the x and y of the shapes
    shapes = (plain.shapes.shape, plain.rotation.shape, plain.coefficients.shape)
    assert shapes == ((150, 15, 3), (150, 3, 3), (150, 24))
    assert (set(plain.status), plain.shape_sd, plain.p_value) == ({"optimal"}, None, None)
    assert not plain.failures
    matrix = np.array([[900.0, 0, 320], [0, 900, 240], [0, 0, 1]])
    one, other = (
        shapefit.fit(images[:3], atoms, method="convex+refine", camera=camera).shapes
        for camera in (matrix, {"focal": np.tile(matrix, (3, 1, 1))})
    )
    np.testing.assert_array_equal(one, other)
    assert np.abs(one - named.shapes[:3]).max() > 1


def test_what_the_command_warns_of_is_a_warning(people, views):
    atoms, images = people["sparse-coding"], shapefit.read_landmarks(views)
    with pytest.warns(UserWarning, match="empty shape") as caught:
        shapefit.fit(images, atoms, 1e3, method="convex")
    assert caught[0].filename == __file__


OPTIONS = [
    ({"method": "convexx"}, r"^fit\.method: expected auto, convex.*did you mean 'convex'\?$"),
    ({"prior": {"scal": 2}}, r"fit\.prior: unknown key 'prior\.scal'.*'prior\.scale'"),
    ({"lamda": 1}, r"fit\.lamda: unknown key 'lamda'; did you mean 'lambda'"),
    ({"output": "x.h5"}, r"^fit\.output: there is no argument `output`; it is for files"),
    ({"camera": np.eye(2)}, r"camera_matrix: has the shape \(2, 2\)"),
    ({"camera": {"name": "left"}}, r"fit\.camera: `name` names a camera"),
    ({"weights": np.ones((2, 15))}, r"confidence: has the shape \(2, 15\); it must be \(150, 15\)"),
    ({"weights": np.full((150, 15), -1)}, r"^landmarks\.confidence\[0\]: landmark 'pelvis' is"),
]


@pytest.mark.parametrize(("changes", "message"), OPTIONS)
def test_fit_names_the_place_of_an_error(people, views, changes, message):
    images = shapefit.read_landmarks(views).replaced(confidence=None, sequences=None)
    with pytest.raises(shapefit.InputError, match=message):
        shapefit.fit(images, people["sparse-coding"], **changes)


LANDMARKS = [
    (np.ones((4, 2, 15)), r"^landmarks: has the shape \(4, 2, 15\); it must be \(n, p, 2\), one"),
    (np.ones((3, 15, 4)), r"^landmarks: has the shape \(3, 15, 4\)"),
    (np.ones((4, 14, 2)), "has 14 landmarks without names, not 15; name them: Landmarks"),
    ([["a"]], "^landmarks: is no array of numbers"),
    (np.full((1, 15, 2), np.inf), r"^landmarks\[0\]: landmark 'pelvis' is \(inf, inf\); write"),
    (shapefit.Landmarks(np.ones((2, 3, 2)), "abc"), "none of the 3 landmarks is in"),
    (shapefit.Landmarks(np.ones((2, 15, 2)), items=["a", "a"]), "item 'a' is also at"),
]


@pytest.mark.parametrize(("landmarks", "message"), LANDMARKS)
def test_landmarks_that_cannot_be_are_refused(people, landmarks, message):
    with pytest.raises(shapefit.InputError, match=message):
        shapefit.fit(landmarks, people["sparse-coding"])


def test_dictionaries_that_cannot_be_are_refused(people, views):
    atoms, images = (
        shapefit.read_dictionary(people["sparse-coding"]),
        shapefit.read_landmarks(views),
    )
    made = shapefit.fit(images.landmarks, shapefit.Dictionary(atoms=atoms.atoms), 0.1)
    named = shapefit.fit(images.landmarks, atoms, 0.1, method="convex")
    np.testing.assert_array_equal(made.objective, named.objective)
    with pytest.raises(shapefit.InputError, match=r"ndarray \(24, 15, 3\); for arrays there"):
        shapefit.fit(images, atoms.atoms, 0.1)
    with pytest.raises(shapefit.InputError, match=r"dictionary\.mean_shape: all its landmarks"):
        shapefit.fit(images, atoms.replaced(mean_shape=np.ones((15, 3))))
    with pytest.raises(shapefit.InputError, match=r"dictionary\.atoms: .*\(k, p, 3\), one landm"):
        atoms.replaced(atoms=atoms.atoms.swapaxes(1, 2))


CONFIGS = {
    "camera": "camera: {focal: 900, principal_point: [10, 20]}\nmethod: convex+refine",
    "calibration": "{camera: {calibration: rig/cameras.toml, name: left}, method: convex+refine}",
    "names": "rename: {rwrist: unused}",
    "installed": "",
}
"""A config of every kind: what a file beside it gives counts in Python, too."""

TOML = """[left]
name = "left"
size = [640.0, 480.0]
matrix = [[900.0, 0.0, 320.0], [0.0, 900.0, 240.0], [0.0, 0.0, 1.0]]
distortions = [0.0, 0.0, 0.0, 0.0]
rotation = [0.0, 0.0, 0.0]
translation = [0.0, 0.0, 0.0]
"""


@pytest.mark.parametrize("name", CONFIGS)
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_a_config_file_is_read_as_the_command_reads_it(tmp_path, people, views, name):
    (tmp_path / "rig").mkdir()
    (tmp_path / "rig/cameras.toml").write_text(TOML)
    (tmp_path / "mine.yaml").write_text(f"{CONFIGS[name]}\n")
    file = Path("people") if name == "installed" else tmp_path / "mine.yaml"
    paths = {"landmarks": str(views), "dictionary": str(people["sparse-coding"])}
    list(run(load_config("fit", file, (), paths | {"output": str(tmp_path / "command.h5")})))
    fit = shapefit.fit(shapefit.read_landmarks(views), people["sparse-coding"], config=file)
    shapefit.write_results(tmp_path / "function.h5", fit)
    same_file(tmp_path / "command.h5", tmp_path / "function.h5")
