"""`shapefit.fit` finds what the command finds, bit for bit, and refuses what it refuses."""

from pathlib import Path

import numpy as np
import pytest

import shapefit
from shapefit.config import load_config
from shapefit.lifting.methods import METHODS
from shapefit.pipelines.fit.run import run

from .conftest import run_command, same_file


def both(tmp_path, landmarks, dictionary, **options):
    """Fit by the command and by the function; the files of both."""
    options = {"method": "convex"} | options
    keys = {("lambda" if key == "lam" else key): value for key, value in options.items()}
    run_command(
        "fit", landmarks=str(landmarks), dictionary=str(dictionary),
        output=str(tmp_path / "command.h5"), **keys,
    )  # fmt: skip
    found = shapefit.fit(
        shapefit.read_landmarks(landmarks), shapefit.read_dictionary(dictionary), **options
    )
    shapefit.write_results(tmp_path / "function.h5", found)
    return tmp_path / "command.h5", tmp_path / "function.h5", found


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_every_method_finds_what_the_command_finds(tmp_path, people, views, method):
    dictionary = people["pca-bases" if method == "pmp" else "sparse-coding"]
    command, function, found = both(tmp_path, views, dictionary, method=method)
    same_file(command, function)
    assert len(found) == 150
    assert found.attributes["method"] == method


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_cars_without_their_own_model_under_their_own_camera(tmp_path, sample):
    dictionary = tmp_path / "cars.h5"
    run_command(
        "learn-dict", shapes=str(sample / "cars.h5"), output=str(dictionary),
        method="exemplars", align="none",
    )  # fmt: skip
    options = {"method": "convex+refine", "lam": 1.0, "leave_one_out": "true_model"}
    camera = {"focal": "files"}
    landmarks = sample / "cars_views.h5"
    command, function, _ = both(tmp_path, landmarks, dictionary, camera=camera, **options)
    same_file(command, function)
    images = shapefit.read_landmarks(landmarks)
    matrix = images.extras["camera_matrix"]
    retained = {name: value for name, value in images.extras.items() if name != "camera_matrix"}
    atoms = shapefit.read_dictionary(dictionary)
    for given in (matrix, {"focal": np.tile(matrix, (108, 1, 1))}):
        found = shapefit.fit(images.replaced(extras=retained), atoms, camera=given, **options)
        np.testing.assert_array_equal(found.shapes, shapefit.read_results(command).shapes)


def test_arrays_alone_are_enough(people, views):
    atoms, images = (
        shapefit.read_dictionary(people["sparse-coding"]),
        shapefit.read_landmarks(views),
    )
    named = shapefit.fit(images, atoms, method="convex")
    plain = shapefit.fit(images.landmarks, atoms, weights=images.confidence, method="convex")
    np.testing.assert_array_equal(plain.shapes, named.shapes)
    assert plain.items[:2] == ("0", "1")
    assert plain.shapes.shape == (150, 15, 3)
    assert plain.landmarks_fitted is None  # which are the x and y of the shapes
    assert plain.rotation.shape == (150, 3, 3)
    assert plain.coefficients.shape == (150, 24)
    assert set(plain.status) == {"optimal"}
    assert (plain.relative_gap <= 1e-6).all()
    assert (plain.shape_sd, plain.p_value) == (None, None)
    assert not plain.failures


def test_an_image_without_landmarks_fails_and_the_others_do_not(people, views):
    atoms, images = (
        shapefit.read_dictionary(people["sparse-coding"]),
        shapefit.read_landmarks(views),
    )
    points = images.landmarks.copy()
    points[3] = np.nan
    found = shapefit.fit(images.replaced(landmarks=points), atoms)
    assert found.attributes["method"] == "sequences"  # the dictionary has a prior
    assert found.failures == {images.items[3]: "all landmarks are hidden"}
    failed = np.isnan(found.shapes).all(axis=(1, 2))
    assert failed.tolist() == [image == 3 for image in range(150)]


def test_what_the_command_warns_of_is_a_warning(people, views):
    atoms = shapefit.read_dictionary(people["sparse-coding"])
    images = shapefit.read_landmarks(views)
    with pytest.warns(UserWarning, match="empty shape") as told:
        shapefit.fit(images, atoms, 1e3, method="convex")
    assert told[0].filename == __file__
    with pytest.warns(UserWarning, match="pmp is made for"):
        shapefit.fit(shapefit.read_landmarks(views), atoms, method="pmp")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"method": "convexx"},
            r"^fit\.method: expected auto, convex.*did you mean 'convex'\?$",
        ),
        ({"lam": -1}, r"^fit\.lambda: expected a number > 0 or auto, found -1$"),
        ({"prior": {"scal": 2}}, r"fit\.prior\.scal: unknown key 'prior\.scal'.*'prior\.scale'"),
        ({"lamda": 1}, r"fit\.lamda: unknown key 'lamda'; did you mean 'lambda'"),
        ({"output": "x.h5"}, r"^fit\.output: there is no argument `output`; it is for files"),
        ({"export": {"folder": "x"}}, r"^fit\.export: there is no argument"),
        ({"camera": np.eye(2)}, r"camera\.focal: camera_matrix: has the shape \(2, 2\)"),
        ({"camera": {"name": "left"}}, r"fit\.camera\.name: `name` names a camera"),
        (
            {"weights": np.ones((2, 15))},
            r"confidence: has the shape \(2, 15\); it must be \(150, 15\)",
        ),
        ({"weights": np.full((150, 15), -1)}, r"^landmarks\.confidence\[0\]: landmark 'pelvis' is"),
        ({"leave_one_out": "model"}, "the atoms of the dictionary are of no items"),
    ],
)
def test_what_is_wrong_is_an_error_with_its_place(people, views, changes, message):
    images = shapefit.read_landmarks(views)
    bare = images.replaced(confidence=None, sequences=None)
    with pytest.raises(shapefit.InputError, match=message):
        shapefit.fit(bare, shapefit.read_dictionary(people["sparse-coding"]), **changes)


@pytest.mark.parametrize(
    ("landmarks", "message"),
    [
        (
            np.ones((4, 2, 15)),
            r"^landmarks: has the shape \(4, 2, 15\); it must be \(n, p, 2\), one",
        ),
        (np.ones((3, 15, 4)), r"^landmarks: has the shape \(3, 15, 4\)"),
        (np.ones((4, 14, 2)), "has 14 landmarks without names, not 15; name them: Landmarks"),
        ([["a"]], "^landmarks: is no array of numbers"),
        (np.full((1, 15, 2), np.inf), r"^landmarks\[0\]: landmark 'pelvis' is \(inf, inf\); write"),
        (shapefit.Landmarks(np.ones((2, 3, 2)), "abc"), "none of the 3 landmarks is in"),
        (shapefit.Landmarks(np.ones((2, 15, 2)), items=["a", "a"]), "item 'a' is also at"),
        (shapefit.Landmarks(np.ones((2, 15, 2)), items=["a", ""]), r"item\[1\]: is empty; name"),
    ],
)
def test_landmarks_that_cannot_be_are_refused(people, landmarks, message):
    with pytest.raises(shapefit.InputError, match=message):
        shapefit.fit(landmarks, shapefit.read_dictionary(people["sparse-coding"]))


def test_arrays_of_atoms_are_no_dictionary_and_make_one(people, views):
    atoms = shapefit.read_dictionary(people["sparse-coding"])
    points, B = shapefit.read_landmarks(views).landmarks, atoms.atoms
    with pytest.raises(shapefit.InputError, match=r"ndarray \(24, 15, 3\); for arrays there"):
        shapefit.fit(points, B, 0.1)
    own = shapefit.fit(points, shapefit.Dictionary(atoms=B), 0.1)
    named = shapefit.fit(points, atoms, 0.1, method="convex")
    np.testing.assert_array_equal(own.objective, named.objective)


def test_a_dictionary_that_cannot_be_is_refused(people, views):
    with pytest.raises(shapefit.InputError, match=r"landmarks\.items: has the shape"):
        shapefit.Landmarks(np.ones((2, 15, 2)), items=["a"])
    atoms = shapefit.read_dictionary(people["sparse-coding"])
    images = shapefit.read_landmarks(views)
    with pytest.raises(shapefit.InputError, match=r"dictionary\.mean_shape: all its landmarks"):
        shapefit.fit(images, atoms.replaced(mean_shape=np.ones((15, 3))))
    with pytest.raises(shapefit.InputError, match=r"dictionary\.atoms: .*\(k, p, 3\), one landm"):
        shapefit.fit(images, atoms.replaced(atoms=atoms.atoms.swapaxes(1, 2)))


CONFIGS = {
    "camera": "camera: {focal: 900, principal_point: [10, 20]}\nmethod: convex+refine",
    "calibration": "{camera: {calibration: rig/cameras.toml, name: left}, method: convex+refine}",
    "names": "rename: {rwrist: unused}",
    "prior": "{method: posterior, prior: {scale: 2, residual_variance: 0.02}}",
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
    text = f"# {name}\n{CONFIGS[name]}\n"
    others = "landmarks: nowhere.h5\ndictionary: nowhere.h5\noutput: r.h5\n"
    (tmp_path / "mine.yaml").write_text(text + (others if "{" not in text[:20] else ""))
    file = Path("people") if name == "installed" else tmp_path / "mine.yaml"
    paths = {"landmarks": str(views), "dictionary": str(people["sparse-coding"])}
    paths["output"] = str(tmp_path / "command.h5")
    list(run(load_config("fit", file, (), paths)))
    images = shapefit.read_landmarks(views)
    found = shapefit.fit(images, people["sparse-coding"], config=file)
    shapefit.write_results(tmp_path / "function.h5", found)
    same_file(tmp_path / "command.h5", tmp_path / "function.h5")
