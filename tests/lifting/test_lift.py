"""Lifting by any method: normalising, degenerate images, failures, scaling back, joined
groups.
"""

from dataclasses import fields, replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.convex.solver import Status
from shapefit.geometry.normalisation import normalise
from shapefit.lifting.degeneracy import MIN_SINGULAR_VALUE, find_degenerate
from shapefit.lifting.estimate import Estimate
from shapefit.lifting.lift import (
    MIN_LAMBDA,
    NOT_FINITE,
    Group,
    Program,
    choose_lambda,
    fail_nonfinite,
    lift,
    merge,
    noise_dual_norm,
)
from tests.lifting.estimators import make_estimator
from tests.points import centred, resized, transpose

PROGRAM = Program(lam=0.1)


class Flat:
    """A method whose shape is the landmarks themselves, at depth 0; remembers the
    problem.
    """

    def __init__(self, status=Status.OPTIMAL):
        self.status = status

    def __call__(self, problem):
        self.problem = problem
        n, _, p = problem.landmarks.shape
        shapes = np.concatenate([problem.landmarks, np.zeros((n, 1, p))], axis=1)
        shapes[:, :2] -= 0.25
        return Estimate(
            shapes=shapes,
            translation=np.full((n, 2), 0.25),
            rotation=np.broadcast_to(np.eye(3), (n, 3, 3)),
            objective=np.zeros(n),
            residual=np.zeros(n),
            iterations=np.zeros(n, np.int64),
            status=(self.status,) * n,
        )


class TestNormalisation:
    """Methods see normalised landmarks, and what they answer is scaled back."""

    @pytest.fixture
    def landmarks(self, make_scene):
        return 37.0 * make_scene(n=5).landmarks + 400.0

    @pytest.fixture
    def flat(self):
        return Flat()

    @pytest.fixture
    def lifting(self, landmarks, flat, rng):
        atoms = rng.standard_normal((8, 3, 12))
        return lift(landmarks, np.ones((5, 12)), atoms, PROGRAM, flat)

    def test_the_problem_is_of_normalised_landmarks(self, lifting, flat, landmarks):
        normalised = normalise(landmarks)
        assert_allclose(flat.problem.landmarks, normalised.points, atol=1e-12)
        assert_array_equal(flat.problem.lam, 0.1)

    def test_the_answer_is_in_the_unit_of_the_landmarks(self, lifting, landmarks):
        assert lifting.failures == {}
        assert_allclose(lifting.landmarks_fitted, landmarks, rtol=1e-12)
        assert_array_equal(lifting.landmarks_fitted, lifting.shapes[:, :2])

    def test_scale_and_translation_are_those_of_the_normalisation(
        self, lifting, landmarks
    ):
        normalised = normalise(landmarks)
        translation = normalised.centroid + 0.25 * normalised.scale[:, None]
        assert_array_equal(lifting.scale, normalised.scale)
        assert_allclose(lifting.translation, translation)


class TestFailingImages:
    """Failing images are named, and leave the others alone."""

    FAILING = (1, 2, 3)
    OTHERS = (0, 4, 5)

    @pytest.fixture
    def scene(self, make_scene):
        """Image 4 has enough landmarks, though most are nan."""
        scene = make_scene(n=6)
        scene.weights[1] = 0.0
        scene.landmarks[2] = 3.0
        scene.landmarks[3, 1] = 2 * scene.landmarks[3, 0]
        scene.landmarks[4, :, 5:] = np.nan
        scene.weights[4, 5:] = 0.0
        return scene

    @pytest.fixture
    def flat(self):
        return Flat()

    @pytest.fixture
    def lifting(self, scene, flat):
        return lift(scene.landmarks, scene.weights, scene.atoms, PROGRAM, flat)

    def test_they_are_named_with_their_reasons(self, lifting):
        assert lifting.failures == {
            1: "all landmarks are hidden",
            2: "all visible landmarks are at one point",
            3: "all visible landmarks lie on one line",
        }

    @pytest.mark.parametrize("image", FAILING)
    def test_they_have_no_shape(self, lifting, image):
        assert np.isnan(lifting.shapes[image]).all()
        assert np.isnan(lifting.scale[image])

    @pytest.mark.parametrize("image", FAILING)
    def test_methods_see_nothing_of_them(self, lifting, flat, image):
        assert_array_equal(flat.problem.weights[image], 0.0)

    @pytest.mark.parametrize("image", OTHERS)
    def test_the_others_are_lifted(self, lifting, scene, image):
        landmarks = scene.landmarks[image]
        is_known = np.isfinite(landmarks)
        fitted = lifting.landmarks_fitted[image]
        assert_allclose(fitted[is_known], landmarks[is_known], rtol=1e-12)


@pytest.mark.parametrize(
    ("status", "reason"),
    [
        (Status.NUMERICAL_FAILURE, "numerical failure in the solver"),
        (Status.DEGENERATE, "no pose of the mean shape fits the visible landmarks"),
    ],
)
def test_a_method_without_a_shape_is_a_failure(make_scene, status, reason):
    scene = make_scene(n=3)
    scene.weights[2] = 0.0
    found = lift(scene.landmarks, scene.weights, scene.atoms, PROGRAM, Flat(status))
    assert found.failures == {0: reason, 1: reason, 2: "all landmarks are hidden"}
    assert np.isnan(found.shapes).all()


def test_each_image_has_the_lambda_of_its_own_size_and_landmarks(make_scene):
    """The second image is larger; of the third a quarter of the landmarks are seen."""
    scene = make_scene(n=3, p=16)
    landmarks = resized(scene.landmarks, np.array([1.0, 9.0, 1.0]))
    weights = np.ones((3, 16))
    weights[2, 4:] = 0.0
    flat = Flat()

    found = lift(landmarks, weights, scene.atoms, Program(lam=None, noise=0.2), flat)

    noise = 0.2 / found.scale
    root_of_share = np.array([1, 1, 0.5])
    expected = noise * noise_dual_norm(scene.atoms) * root_of_share
    assert_allclose(flat.problem.lam, expected)


def test_no_lambda_is_0(rng):
    program = Program(lam=None, noise=2.0)
    atoms = rng.standard_normal((5, 3, 40))
    found = choose_lambda(program, atoms, np.array([1e9]), np.ones(1))
    assert_array_equal(found, [MIN_LAMBDA])


@pytest.mark.parametrize("visible", [np.ones(40, bool), np.arange(40) % 4 == 0])
def test_lambda_is_the_mean_dual_norm_of_the_noise_that_is_seen(rng, visible):
    """Against noise drawn anew, on the visible landmarks, about their mean."""
    program = Program(lam=None, noise=2.0)
    atoms = centred(rng.standard_normal((5, 3, 40)))
    noise = centred(rng.standard_normal((4000, 1, 2, visible.sum())))
    products = noise @ transpose(atoms[..., visible])
    nuclear_norms = np.linalg.norm(products, "nuc", axis=(2, 3))
    dual_norm = nuclear_norms.max(axis=1).mean()
    scale = np.array([1.0, 4.0])
    share = np.full(2, visible.mean())

    found = choose_lambda(program, atoms, scale, share)

    assert_allclose(found, 2.0 * dual_norm / scale, rtol=0.05)


@pytest.fixture
def lifting(make_scene):
    """Five images, of which one is degenerate, lifted by the convex method."""
    scene = make_scene(n=5)
    scene.weights[3] = 0.0
    method = make_estimator("convex")
    return lift(scene.landmarks, scene.weights, scene.atoms, PROGRAM, method)


def test_what_is_finite_stays(lifting):
    assert fail_nonfinite(lifting) is lifting


@pytest.mark.parametrize("value", [np.nan, np.inf])
class TestOneCoordinateThatIsNotFinite:
    """It fails its image, and leaves the others alone."""

    OTHERS = np.array([0, 2, 3, 4])

    @pytest.fixture
    def found(self, lifting, value):
        shapes = lifting.shapes.copy()
        shapes[1, 2, 4] = value
        return fail_nonfinite(replace(lifting, shapes=shapes))

    def test_the_image_is_a_failure(self, found):
        assert found.failures == {1: NOT_FINITE, 3: "all landmarks are hidden"}

    def test_its_status_says_so(self, found):
        status = found.estimate.status
        assert status[1] is Status.NUMERICAL_FAILURE
        assert status[3] is Status.DEGENERATE
        assert {status[0], status[2], status[4]} == {Status.OPTIMAL}

    @pytest.mark.parametrize(
        "name", ["shapes", "landmarks_fitted", "translation", "scale"]
    )
    def test_nothing_of_it_is_left(self, found, lifting, name):
        after = getattr(found, name)
        before = getattr(lifting, name)
        assert np.isnan(after[1]).all()
        assert_array_equal(after[self.OTHERS], before[self.OTHERS])


ORDER = np.array([3, 0, 6, 1, 5, 2, 4])
"""In which seven images are lifted one by one."""


@pytest.fixture
def atoms(rng):
    return normalise(rng.standard_normal((5, 3, 8))).points


@pytest.fixture
def run(rng, atoms):
    """Return the function that lifts some of seven images, one of them degenerate."""
    landmarks = 10 * rng.standard_normal((7, 2, 8)) + 50
    weights = np.ones((7, 8))
    weights[5, 2:] = 0

    def run(images=slice(None), retained=slice(None), method="convex"):
        B = atoms[retained]
        mean_shape = normalise(B.mean(axis=0)).points
        estimator = make_estimator(method, mean_shape=mean_shape)
        return lift(landmarks[images], weights[images], B, PROGRAM, estimator)

    return run


def arrays_of(record):
    """Return the arrays of a lifting or an estimate, by the names of their fields."""
    values = {field.name: getattr(record, field.name) for field in fields(record)}
    return {
        name: value for name, value in values.items() if isinstance(value, np.ndarray)
    }


def assert_same_image(merged, image, alone):
    """An image of a record has the values of a record of this image alone."""
    arrays_alone = arrays_of(alone)
    for name, values in arrays_of(merged).items():
        assert_array_equal(values[image], arrays_alone[name][0])


@pytest.mark.parametrize("method", ["convex", "convex+refine", "mean-shape"])
def test_images_lifted_one_by_one_are_those_lifted_alone(run, atoms, method):
    all_atoms = np.arange(len(atoms))
    groups = [Group(run([i], method=method), np.array([i]), all_atoms) for i in ORDER]

    merged = merge(groups, atoms)

    assert merged.failures.keys() == {5}
    for i in range(7):
        alone = run([i], method=method)
        assert_same_image(merged, i, alone)
        assert_same_image(merged.estimate, i, alone.estimate)
        assert merged.estimate.status[i] is alone.estimate.status[0]
        assert merged.failures.get(i) == alone.failures.get(0)


class TestAtomsThatAGroupLacked:
    """They have no part in its images once the groups are merged."""

    RETAINED = np.array([0, 2, 3])
    LACKING = np.array([1, 4])
    SOME = np.array([4, 1])
    REST = np.array([0, 2, 3, 5, 6])

    @pytest.fixture
    def part(self, run):
        """The images SOME, lifted by the atoms RETAINED."""
        return run(self.SOME, self.RETAINED)

    @pytest.fixture
    def merged(self, run, atoms, part):
        some = Group(part, self.SOME, self.RETAINED)
        rest = Group(run(self.REST), self.REST, np.arange(5))
        return merge([some, rest], atoms)

    def test_coefficients_are_0(self, merged, part):
        coefficients = merged.estimate.coefficients
        group_values = coefficients[self.SOME]
        assert coefficients.shape == (7, 5)
        assert_array_equal(group_values[:, self.LACKING], 0)
        assert_array_equal(group_values[:, self.RETAINED], part.estimate.coefficients)

    def test_transforms_are_0(self, merged, part):
        group_values = merged.estimate.transforms.dense()[self.SOME]
        before = part.estimate.transforms.dense()
        assert_array_equal(group_values[:, self.LACKING], 0)
        assert_array_equal(group_values[:, self.RETAINED], before)

    def test_the_problem_is_of_all_atoms_and_images(self, merged, atoms, part):
        group_values = merged.problem.landmarks[self.SOME]
        assert_array_equal(merged.problem.atoms, atoms)
        assert_array_equal(group_values, part.problem.landmarks)


TRIANGLE = np.array([[0.0, 1.0, 0.0, 0.3], [0.0, 0.0, 1.0, 0.2]])


LINE = [[0, 1, 2, 9], [1, 3, 5, 0]]
"""But for the last landmark."""

DEGENERATE = [
    (TRIANGLE, [0, 0, 0, 0], "all landmarks are hidden"),
    (TRIANGLE, [1, 1, 0, 0], "only 2 visible landmarks, 3 are needed"),
    (TRIANGLE, [0, 0, 0, 0.1], "only 1 visible landmark, 3 are needed"),
    (np.full((2, 4), 7.3), [1, 1, 1, 1], "all visible landmarks are at one point"),
    (np.zeros((2, 4)), [1, 1, 1, 1], "all visible landmarks are at one point"),
    (LINE, [1, 1, 1, 0], "all visible landmarks lie on one line"),
]
"""Landmarks, weights, and why they have no shape."""


@pytest.mark.parametrize(("landmarks", "weights", "reason"), DEGENERATE)
def test_a_degenerate_image_is_found_with_its_reason(landmarks, weights, reason):
    images = np.array([TRIANGLE, landmarks], dtype=float)
    both_weights = np.array([np.ones(4), weights], dtype=float)
    assert find_degenerate(images, both_weights) == {1: reason}


@pytest.mark.parametrize(
    ("share", "failures"),
    [(0.7, {0: "all visible landmarks lie on one line"}), (1.4, {})],
)
def test_how_thin_a_line_is_counts_beside_its_length(share, failures):
    """A zigzag along x whose singular value is a share of the least one allowed."""
    x = np.linspace(-1, 1, 20)
    zigzag = (-1.0) ** np.arange(20)
    zigzag -= x * (x @ zigzag) / (x @ x)
    unit = np.linalg.norm(x) / np.linalg.norm(zigzag)
    y = share * MIN_SINGULAR_VALUE * unit * zigzag

    found = find_degenerate(np.stack([x, y])[None], np.ones((1, 20)))

    assert found == failures


@pytest.mark.parametrize(
    ("landmarks", "reason"),
    [
        (1e200 * TRIANGLE, "coordinates too large, up to 1e+200: use a larger unit"),
        (
            1e-200 * TRIANGLE,
            "landmarks too close together, within 7e-201: use a smaller unit",
        ),
        (1e-318 * TRIANGLE, "too close together"),
        (1.7e308 * (2 * TRIANGLE - 1), "too large"),
    ],
)
def test_coordinates_that_cannot_be_squared_are_found(landmarks, reason):
    images = np.stack([TRIANGLE, landmarks])

    with np.errstate(all="raise", under="ignore"):
        found = find_degenerate(images, np.ones((2, 4)))

    assert [*found] == [1]
    assert reason in found[1]
