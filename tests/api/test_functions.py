"""`learn`, `fit`, `evaluate`, `solve` do as the commands do, bit for bit, and refuse
the same.
"""

import csv
from pathlib import Path

import numpy as np
import pytest

import shapefit
from shapefit.config import load_config
from shapefit.lifting.methods import METHODS
from shapefit.pipelines.fit.fit import fit as run
from tests.api.conftest import run_command, same_file


@pytest.mark.parametrize("method", ["sparse-coding", "pca-bases", "exemplars"])
def test_learn_makes_what_the_command_makes(tmp_path, people, sample, method):
    prior = {"components": 2, "floor": 0.01}
    keys = (
        {"k": 24, "iterations": 2, "prior": prior} if method == "sparse-coding" else {}
    )
    shapes = shapefit.read_shapes(sample / "people_train.h5")
    made = shapefit.learn(shapes, method=method, every=20, **keys)
    shapefit.write_dictionary(tmp_path / "made.h5", made)
    same_file(people[method], tmp_path / "made.h5")


def test_learn_takes_arrays_and_warns_of_those_that_cannot_be_used(sample):
    shapes = shapefit.read_shapes(sample / "people_train.h5").shapes[::60].copy()
    shapes[4] = 1.0
    with pytest.warns(
        UserWarning, match="1 shape cannot be used; 4, for one: all its landmarks"
    ):
        made = shapefit.learn(shapes, method="exemplars")
    assert made.atoms.shape == (31, 15, 3)
    assert made.landmark_names == tuple(map(str, range(15)))


LEARN = [
    (
        np.ones((4, 15, 2)),
        {},
        r"^shapes: has the shape \(4, 15, 2\); it must be \(n, p, 3\)",
    ),
    (
        np.full((4, 15, 3), np.nan),
        {},
        r"^shapes: no landmark is known in 90% of its 4 shapes",
    ),
    (np.ones((4, 5, 3)), {"k": 0}, r"^learn\.k: expected a whole number >= 1, found 0"),
    (
        np.ones((4, 5, 3)),
        {"kk": 0},
        r"^learn\.kk: there is no argument `kk`; did you mean `k`",
    ),
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
    assert len(fit) == 48
    assert fit.attributes["method"] == method


def test_arrays_and_matrices_of_cameras_are_enough(people, views):
    atoms = shapefit.read_dictionary(people["sparse-coding"])
    images = shapefit.read_landmarks(views)
    named = shapefit.fit(images, atoms, method="convex")
    plain = shapefit.fit(
        images.landmarks, atoms, weights=images.confidence, method="convex"
    )
    np.testing.assert_array_equal(plain.shapes, named.shapes)
    assert plain.items[:2] == ("0", "1")
    assert plain.landmarks_fitted is None  # which are the x and y of the shapes
    shapes = (plain.shapes.shape, plain.rotation.shape, plain.coefficients.shape)
    assert shapes == ((48, 15, 3), (48, 3, 3), (48, 24))
    assert set(plain.status) == {"optimal"}
    assert plain.shape_sd is None
    assert plain.p_value is None
    assert not plain.failures
    matrix = np.array([[900.0, 0, 320], [0, 900, 240], [0, 0, 1]])
    one, other = (
        shapefit.fit(images[:3], atoms, method="convex+refine", camera=camera).shapes
        for camera in (matrix, {"focal": np.tile(matrix, (3, 1, 1))})
    )
    np.testing.assert_array_equal(one, other)
    assert np.abs(one - named.shapes[:3]).max() > 1


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_coefficients_have_either_sign_where_signed_says_so(people, views):
    images, atoms = shapefit.read_landmarks(views)[:8], people["sparse-coding"]
    for signed in (False, True):
        found = shapefit.fit(images, atoms, lam=1e-3, method="alternate", signed=signed)
        assert (found.coefficients < 0).any() == signed


def test_what_the_command_warns_of_is_a_warning(people, views):
    atoms, images = people["sparse-coding"], shapefit.read_landmarks(views)
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
def test_fit_names_the_place_of_an_error(people, views, changes, message):
    images = shapefit.read_landmarks(views).replaced(confidence=None, sequences=None)
    with pytest.raises(shapefit.InputError, match=message):
        shapefit.fit(images, people["sparse-coding"], **changes)


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


def test_dictionaries_that_cannot_be_are_refused(people, views):
    atoms = shapefit.read_dictionary(people["sparse-coding"])
    images = shapefit.read_landmarks(views)
    made = shapefit.fit(images.landmarks, shapefit.Dictionary(atoms=atoms.atoms), 0.1)
    named = shapefit.fit(images.landmarks, atoms, 0.1, method="convex")
    np.testing.assert_array_equal(made.objective, named.objective)
    with pytest.raises(
        shapefit.InputError, match=r"ndarray \(24, 15, 3\); for arrays there"
    ):
        shapefit.fit(images, atoms.atoms, 0.1)
    with pytest.raises(
        shapefit.InputError, match=r"dictionary\.mean_shape: all its landmarks"
    ):
        shapefit.fit(images, atoms.replaced(mean_shape=np.ones((15, 3))))
    with pytest.raises(
        shapefit.InputError, match=r"dictionary\.atoms: .*\(k, p, 3\), one landm"
    ):
        atoms.replaced(atoms=atoms.atoms.swapaxes(1, 2))


def test_an_unknown_dictionary_names_the_nearest():
    with pytest.raises(shapefit.InputError, match=r"did you mean `people`\? Insta"):
        shapefit.fit(np.ones((1, 15, 2)), "peple")
    with pytest.raises(shapefit.InputError, match=r"none\.h5: there is no such dictio"):
        shapefit.read_dictionary("none.h5")


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_y_axis_and_min_confidence_act_on_whatever_holds_the_landmarks(people, views):
    images = shapefit.read_landmarks(views)[:4]
    atoms = people["sparse-coding"]
    turned = images.landmarks * [1, -1]
    up, down = (
        shapefit.fit(points, atoms, method="convex", y_axis=y_axis)
        for points, y_axis in ((images.landmarks, "up"), (turned, None))
    )
    assert up.y_axis == "up"
    assert down.y_axis == "down"
    np.testing.assert_allclose(up.shapes, down.shapes * [1, -1, -1], atol=1e-6)
    of_skeleton = shapefit.fit(
        np.full((2, 17, 2), 50.0) + np.arange(17)[:, None],
        y_axis="up",
        keypoints="coco_17",
    )
    assert of_skeleton.y_axis == "up"
    with pytest.raises(shapefit.InputError, match=r"y points down, and up in the land"):
        shapefit.fit(images, atoms, method="convex", y_axis="down")
    least = float(np.median(images.confidence))
    hidden = images.replaced(
        confidence=np.where(images.confidence < least, 0, images.confidence)
    )
    some, same = (
        shapefit.fit(one, atoms, method="convex", **given)
        for one, given in ((images, {"min_confidence": least}), (hidden, {}))
    )
    np.testing.assert_array_equal(some.shapes, same.shapes)


CONFIGS = {
    "camera": "camera: {focal: 900, principal_point: [10, 20]}\nmethod: convex+refine",
    "names": "rename: {rwrist: unused}",
    "installed": "",
}
"""Configs of a file, and an installed one."""


@pytest.mark.parametrize("name", CONFIGS)
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_a_config_file_is_read_as_the_command_reads_it(tmp_path, people, views, name):
    (tmp_path / "mine.yaml").write_text(f"{CONFIGS[name]}\n")
    file = Path("people") if name == "installed" else tmp_path / "mine.yaml"
    paths = {"landmarks": str(views), "dictionary": str(people["sparse-coding"])}
    list(
        run(
            load_config(
                "fit", file, (), paths | {"output": str(tmp_path / "command.h5")}
            )
        )
    )
    fit = shapefit.fit(
        shapefit.read_landmarks(views), people["sparse-coding"], config=file
    )
    shapefit.write_results(tmp_path / "function.h5", fit)
    same_file(tmp_path / "command.h5", tmp_path / "function.h5")


@pytest.fixture(scope="module")
def chain(people, views):
    return shapefit.fit(
        shapefit.read_landmarks(views),
        shapefit.read_dictionary(people["sparse-coding"]),
    )


def test_errors_and_sums_are_those_of_the_command(tmp_path, chain, sample):
    shapefit.write_results(tmp_path / "result.h5", chain)
    metrics = ["similarity", "reprojection"]
    run_command(
        "eval",
        results={"result": str(tmp_path / "result.h5")},
        truth=str(sample / "people_test.h5"),
        output=str(tmp_path / "report"),
        metrics=metrics,
        groups={"all": "*"},
        plots="none",
    )
    truth = shapefit.read_shapes(sample / "people_test.h5")
    found = shapefit.evaluate(chain, truth, metrics=metrics, groups={"all": "*"})
    with (tmp_path / "report/per_image.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    written = {(r["metric"], r["unit"], r["item"]): float(r["error"]) for r in rows}
    for (metric, unit), values in found.errors.items():
        for item, value in zip(found.items, values, strict=True):
            assert written.pop((metric, unit, item)) == value
    assert not written
    with (tmp_path / "report/report.csv").open(newline="", encoding="utf-8") as file:
        means = [float(row["mean"]) for row in csv.DictReader(file)]
    assert means == [summary.mean for summary in found.summaries]
    assert 0.05 < found.mean("similarity") < 0.5
    assert found.mean("similarity", "m") < found.mean("similarity")
    with pytest.raises(ValueError, match="no camera was measured"):
        found.mean("camera")


def test_arrays_are_matched_by_their_order(chain, sample):
    truth = shapefit.read_shapes(sample / "people_test.h5")
    rows = [truth.items.index(item) for item in chain.items]
    with pytest.warns(
        UserWarning, match="no camera and rotation without `true_rotation`"
    ):
        named = shapefit.evaluate(chain, truth)
    assert {metric for metric, _ in named.errors} >= {"similarity", "reprojection"}
    with pytest.raises(shapefit.InputError, match="truth: has 3 shapes for 48 images"):
        shapefit.evaluate(chain, truth.shapes[:3])
    for result in (chain, chain.shapes):
        plain = shapefit.evaluate(result, truth.shapes[rows], metrics=["similarity"])
        np.testing.assert_array_equal(
            plain.errors["similarity", "normalised"],
            named.errors["similarity", "normalised"],
        )


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"metrics": ["simlarity"]}, "did you mean 'similarity'"),
        ({"metrics": []}, "expected a list, each similarity, camera"),
        ({"match": "model"}, "there is no dataset 'model' with one name"),
        ({"plots": "svg"}, r"^evaluate\.plots: .* `plots`; it is for files"),
        ({"groups": {"a": "nobody*"}}, "no sequence matches any group"),
    ],
)
def test_what_is_wrong_is_an_error_with_its_place(chain, sample, changes, message):
    truth = shapefit.read_shapes(sample / "people_test.h5")
    with pytest.raises(shapefit.InputError, match=message):
        shapefit.evaluate(chain, truth, **({"metrics": ["similarity"]} | changes))


@pytest.fixture
def program(rng):
    atoms = rng.normal(size=(6, 3, 9))
    M = np.zeros((6, 2, 3))
    M[1], M[4] = 0.8 * np.eye(3)[:2], -0.3 * np.eye(3)[1:]
    W = (
        np.einsum("kab,kbp->ap", M, atoms)
        + 0.05 * rng.normal(size=(2, 9))
        + [[3.0], [-2.0]]
    )
    return W, atoms


def test_the_dual_proves_the_optimum(program):
    """A feasible dual bounds every objective from below, and this one from 1e-6
    below.
    """
    W, B = program
    weights = np.array([1, 1, 0.5, 1, 0, 1, 2, 1, 1])
    found = shapefit.solve(W, B, 0.2, weights=weights)
    assert found.status == "optimal"
    residual = weights * (W - np.einsum("kab,kbp->ap", found.transforms, B))
    residual -= weights * found.translation[:, None]
    norms = np.linalg.norm(found.transforms, 2, axis=(1, 2))
    objective = (residual**2).sum() / 2 + 0.2 * norms.sum()
    assert found.objective == pytest.approx(objective, rel=1e-12)
    weighted = weights * found.dual
    dual_norms = np.linalg.norm(weighted @ B.swapaxes(1, 2), "nuc", axis=(1, 2))
    Y = found.dual * min(1.0, 0.2 / dual_norms.max())
    np.testing.assert_allclose((weights * Y).sum(axis=1), 0, atol=1e-9)
    bound = (W * weights * Y).sum() - (Y**2).sum() / 2
    assert 0 <= objective - bound <= 2e-6 * objective


def test_what_does_not_fit_is_refused(program):
    W, B = program
    with pytest.raises(ValueError, match=r"must be \(n, 2, p\), \(k, 3, p\)"):
        shapefit.solve(W[:, :5], B, 0.1)
    with pytest.raises(ValueError, match="'huge' is not a valid Loss"):
        shapefit.solve(W, B, 0.1, loss="huge")
