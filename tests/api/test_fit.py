"""`fit` does as the command does, bit for bit, and refuses the same."""

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import shapefit
from shapefit.config import load_config
from shapefit.lifting.methods import METHODS
from shapefit.pipelines.fit.fit import fit as run
from tests.api.conftest import run_command, same_file


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_fit_finds_what_the_command_finds(tmp_path, people, views, method):
    by_command = tmp_path / "command.h5"
    by_function = tmp_path / "function.h5"
    dictionary = str(people["pca-bases" if method == "pmp" else "sparse-coding"])
    files = {"landmarks": str(views), "output": str(by_command)}
    run_command("fit", **files, dictionary=dictionary, method=method)
    fit = shapefit.fit(shapefit.read_landmarks(views), dictionary, method=method)
    shapefit.write_results(by_function, fit)
    same_file(by_command, by_function)
    assert len(fit) == 48
    assert fit.attributes["method"] == method


@pytest.fixture
def atoms(people):
    return shapefit.read_dictionary(people["sparse-coding"])


@pytest.fixture
def images(views):
    return shapefit.read_landmarks(views)


def test_arrays_are_enough(atoms, images):
    named = shapefit.fit(images, atoms, method="convex")
    plain = shapefit.fit(
        images.landmarks, atoms, weights=images.confidence, method="convex"
    )
    assert_array_equal(plain.shapes, named.shapes)
    assert plain.items[:2] == ("0", "1")


def test_a_fit_of_the_convex_program_has_what_it_knows(atoms, images):
    """Its landmarks would be the x and y of the shapes."""
    fit = shapefit.fit(images.landmarks, atoms, method="convex")
    assert fit.landmarks_fitted is None
    assert fit.shapes.shape == (48, 15, 3)
    assert fit.rotation.shape == (48, 3, 3)
    assert fit.coefficients.shape == (48, 24)
    assert set(fit.status) == {"optimal"}
    assert fit.shape_sd is None
    assert fit.p_value is None
    assert not fit.failures


def test_a_matrix_is_a_camera(atoms, images):
    matrix = np.array([[900.0, 0, 320], [0, 900, 240], [0, 0, 1]])
    of_each_image = {"focal": np.tile(matrix, (3, 1, 1))}
    some = images[:3]
    weak = shapefit.fit(some, atoms, method="convex")
    one = shapefit.fit(some, atoms, method="convex+refine", camera=matrix)
    other = shapefit.fit(some, atoms, method="convex+refine", camera=of_each_image)
    difference = np.abs(one.shapes - weak.shapes)
    assert_array_equal(one.shapes, other.shapes)
    assert difference.max() > 1


@pytest.mark.parametrize("signed", [False, True])
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_coefficients_have_either_sign_where_signed_says_so(atoms, images, signed):
    some = images[:8]
    fit = shapefit.fit(some, atoms, lam=1e-3, method="alternate", signed=signed)
    assert (fit.coefficients < 0).any() == signed


def test_what_the_command_warns_of_is_a_warning(atoms, images):
    with pytest.warns(UserWarning, match="empty shape") as caught:
        shapefit.fit(images, atoms, 1e3, method="convex")
    assert caught[0].filename == __file__


OPTIONS = [
    (
        {"method": "convexx"},
        r"^fit\.method: expected auto, convex.*did you mean 'convex'\?$",
    ),
    ({"prior": {"scal": 2}}, r"fit\.prior: unknown key 'prior\.scal'.*'prior\.scale'"),
    ({"lamda": 1}, r"fit\.lamda: there is no argument `lamda`; did you mean `lam`"),
    (
        {"output": "x.h5"},
        r"^fit\.output: there is no argument `output`; it is for files",
    ),
    ({"camera": np.eye(2)}, r"camera_matrix: has the shape \(2, 2\)"),
    ({"camera": {"name": "left"}}, r"fit\.camera: `name` names a camera"),
    (
        {"weights": np.ones((2, 15))},
        r"confidence: has the shape \(2, 15\); it must be \(48, 15\)",
    ),
    (
        {"weights": np.full((48, 15), -1)},
        r"^landmarks\.confidence\[0\]: landmark 'pelvis' is",
    ),
]


@pytest.mark.parametrize(("changes", "message"), OPTIONS)
def test_fit_names_the_place_of_an_error(atoms, images, changes, message):
    plain = images.replaced(confidence=None, sequences=None)
    with pytest.raises(shapefit.InputError, match=message):
        shapefit.fit(plain, atoms, **changes)


def test_a_dictionary_of_atoms_alone_is_enough(atoms, images):
    bare = shapefit.Dictionary(atoms=atoms.atoms)
    made = shapefit.fit(images.landmarks, bare, 0.1)
    named = shapefit.fit(images.landmarks, atoms, 0.1, method="convex")
    assert_array_equal(made.objective, named.objective)


def test_an_array_is_no_dictionary(atoms, images):
    fault = r"ndarray \(24, 15, 3\); for arrays there"
    with pytest.raises(shapefit.InputError, match=fault):
        shapefit.fit(images, atoms.atoms, 0.1)


def test_a_mean_shape_of_one_point_is_refused(atoms, images):
    one_point = atoms.replaced(mean_shape=np.ones((15, 3)))
    fault = r"dictionary\.mean_shape: all its landmarks"
    with pytest.raises(shapefit.InputError, match=fault):
        shapefit.fit(images, one_point)


def test_atoms_in_columns_are_refused(atoms):
    in_columns = np.moveaxis(atoms.atoms, 1, 2)
    fault = r"dictionary\.atoms: .*\(k, p, 3\), one landm"
    with pytest.raises(shapefit.InputError, match=fault):
        atoms.replaced(atoms=in_columns)


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_y_axis_acts_on_whatever_holds_the_landmarks(atoms, images):
    y_up = images[:4].landmarks
    y_down = y_up * [1, -1]
    up = shapefit.fit(y_up, atoms, method="convex", y_axis="up")
    down = shapefit.fit(y_down, atoms, method="convex")
    assert up.y_axis == "up"
    assert down.y_axis == "down"
    assert_allclose(up.shapes, down.shapes * [1, -1, -1], atol=1e-6)


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_y_axis_acts_on_landmarks_of_a_skeleton():
    diagonal = np.full((2, 17, 2), 50.0) + np.arange(17)[:, None]
    fit = shapefit.fit(diagonal, y_axis="up", keypoints="coco_17")
    assert fit.y_axis == "up"


def test_an_image_of_a_detector_without_a_landmark_is_told():
    images = np.random.default_rng(0).uniform(0, 500, (3, 17, 2))
    images[1] = np.nan
    with pytest.warns(UserWarning, match="landmarks: 1 item without a landmark left"):
        fit = shapefit.fit(images, keypoints="coco_17", method="convex")
    assert fit.frames.tolist() == [0, 2]


def test_a_y_axis_that_contradicts_the_landmarks_is_refused(atoms, images):
    fault = r"y points down, and up in the land"
    with pytest.raises(shapefit.InputError, match=fault):
        shapefit.fit(images, atoms, method="convex", y_axis="down")


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("as_array", [True, False])
def test_a_landmark_without_x_or_y_is_unseen(atoms, images, as_array):
    some = images[:3]
    without_x = some.landmarks.copy()
    without_x[:, 2, 0] = np.nan
    unseen = without_x.copy()
    unseen[:, 2] = np.nan

    def fit(points):
        given = points if as_array else some.replaced(landmarks=points)
        return shapefit.fit(given, atoms, method="convex")

    found = fit(without_x)
    expected = fit(unseen)
    assert_array_equal(found.shapes, expected.shapes)
    assert_array_equal(found.landmarks, expected.landmarks)


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_min_confidence_hides_landmarks(atoms, images):
    some = images[:4]
    least = float(np.median(some.confidence))
    confidence = np.where(some.confidence < least, 0, some.confidence)
    hidden = some.replaced(confidence=confidence)
    fit = shapefit.fit(some, atoms, method="convex", min_confidence=least)
    expected = shapefit.fit(hidden, atoms, method="convex")
    assert_array_equal(fit.shapes, expected.shapes)


LANDMARKS = [
    (
        np.ones((4, 2, 15)),
        r"^landmarks: has the shape \(4, 2, 15\); it must be \(n, p, 2\), one",
    ),
    (np.ones((3, 15, 4)), r"^landmarks: has the shape \(3, 15, 4\)"),
    (
        np.ones((4, 14, 2)),
        "has 14 landmarks without names, not 15; name them: Landmarks",
    ),
    ([["a"]], "^landmarks: is no array of numbers"),
    ("cam01_json", r"name of a file; read it: shapefit\.read_landmarks\('cam01_json'"),
    (
        np.full((1, 15, 2), np.inf),
        r"^landmarks\[0\]: landmark 'pelvis' is \(inf, inf\); write",
    ),
    (
        shapefit.Landmarks(np.ones((2, 3, 2)), landmark_names="abc"),
        "none of the 3 landmarks is in",
    ),
    (shapefit.Landmarks(np.ones((2, 15, 2)), items=["a", "a"]), "item 'a' is also at"),
]


@pytest.mark.parametrize(("landmarks", "message"), LANDMARKS)
def test_landmarks_that_cannot_be_are_refused(people, landmarks, message):
    with pytest.raises(shapefit.InputError, match=message):
        shapefit.fit(landmarks, people["sparse-coding"])


def test_an_unknown_dictionary_names_the_nearest():
    with pytest.raises(shapefit.InputError, match=r"did you mean `people`\? Insta"):
        shapefit.fit(np.ones((1, 15, 2)), "peple")
    with pytest.raises(shapefit.InputError, match=r"none\.h5: there is no such dictio"):
        shapefit.read_dictionary("none.h5")


CONFIGS = {
    "camera": "camera: {focal: 900, principal_point: [10, 20]}\nmethod: convex+refine",
    "names": "rename: {rwrist: unused}",
}
"""Configs of a file."""


@pytest.fixture
def fit_by_config(tmp_path, people, views):
    """Fit with a config, by the command and by the function, and compare."""

    def check(config):
        by_command = tmp_path / "command.h5"
        by_function = tmp_path / "function.h5"
        dictionary = people["sparse-coding"]
        files = {
            "landmarks": str(views),
            "dictionary": str(dictionary),
            "output": str(by_command),
        }
        list(run(load_config("fit", config, (), files)))
        images = shapefit.read_landmarks(views)
        fit = shapefit.fit(images, dictionary, config=config)
        shapefit.write_results(by_function, fit)
        same_file(by_command, by_function)

    return check


@pytest.mark.parametrize("text", CONFIGS.values(), ids=CONFIGS)
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_a_config_file_is_read_as_the_command_reads_it(tmp_path, fit_by_config, text):
    path = tmp_path / "mine.yaml"
    path.write_text(f"{text}\n")
    fit_by_config(path)


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_an_installed_config_is_read_as_the_command_reads_it(fit_by_config):
    fit_by_config(Path("people"))
