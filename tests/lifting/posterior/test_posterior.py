"""The posterior beside a dense one: modes that are maxima, mixtures, regions,
outliers.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.dictionary.mixture import Mixture
from shapefit.geometry.rotations import (
    random_rotations,
    rotation_about_axis,
)
from shapefit.lifting.posterior.posterior import Outliers, find_posterior
from tests.gaussians import covariance_of_root, single_gaussian
from tests.lifting.posterior import dense
from tests.lifting.posterior.scenes import (
    assert_regions_hold,
    draw_images,
    shares_of,
    solve,
)
from tests.points import centred, draw_rotations, without_mean_depth


def solve_one(scene, R, outliers=(0.0, 0.05)):
    """Find the posterior of one image from one start."""
    prior = single_gaussian(scene.mean, scene.covariance)
    slopes = None if scene.slopes is None else scene.slopes[None]
    return find_posterior(
        scene.landmarks[None],
        scene.residual_variance[None],
        scene.noise[None],
        prior,
        R[None, None],
        Outliers(*outliers),
        slopes=slopes,
        modes=1,
        covariance=True,
    )


@pytest.mark.parametrize("noisy", [False, True])
@pytest.mark.parametrize("hidden", [(), (2,), (0, 5)])
@pytest.mark.parametrize("chance", [0.0, 0.05])
@pytest.mark.parametrize("steep", [0.0, 0.4])
@pytest.mark.usefixtures("to_the_end")
class TestMode:
    """A mode is that of the dense computation: with noise of its own, hidden landmarks,
    outliers, and rays that are not parallel.
    """

    @pytest.fixture
    def drawn(self, draw_scene, noisy, hidden, steep):
        return draw_scene(3, noisy=noisy, hidden=hidden, steep=steep)

    @pytest.fixture
    def scene(self, drawn):
        scene, _ = drawn
        return scene

    @pytest.fixture
    def outliers(self, chance):
        """Their chance, and their density over the image."""
        return chance, 0.05 / 37**2

    @pytest.fixture
    def modes(self, drawn, outliers):
        return solve_one(*drawn, outliers).modes

    @pytest.fixture
    def view(self, modes):
        return modes.rotation[0, 0], modes.scale[0, 0]

    @pytest.fixture
    def inlier_probability(self, modes):
        return np.nan_to_num(modes.inlier_probability[0, 0], nan=1.0)

    @pytest.fixture
    def log_likelihood(self, scene, outliers, inlier_probability):
        """Of a view."""

        def log_likelihood(R, s):
            return dense.log_likelihood(scene, R, s, outliers, inlier_probability)

        return log_likelihood

    @pytest.fixture
    def information(self, log_likelihood, view):
        """Of the view (4, 4); no view is less certain than a radian."""
        return np.eye(4) - dense.hessian(log_likelihood, *view)

    def test_it_is_a_maximum(self, log_likelihood, view):
        slope = dense.derivative(log_likelihood, *view)
        assert np.abs(slope).max() < 1e-3

    def test_its_evidence_is_that_of_laplace(
        self, modes, log_likelihood, view, information
    ):
        volume = 2 * np.log(2 * np.pi) - 0.5 * dense.log_det(information)
        expected = log_likelihood(*view) + volume
        assert modes.log_evidence[0, 0] == pytest.approx(expected, abs=1e-3)

    def test_its_mean_is_that_given_the_view(
        self, modes, scene, view, inlier_probability
    ):
        mean, _ = dense.condition(scene, *view, inlier_probability)
        _, s = view
        assert modes.mean[0, 0].ravel() == pytest.approx(mean, abs=1e-9 * s)

    def test_its_covariance_is_that_given_the_view_and_that_of_views(
        self, modes, scene, view, inlier_probability, information
    ):
        def mean_at(R, s):
            mean, _ = dense.condition(scene, R, s, inlier_probability)
            return mean

        _, given_view = dense.condition(scene, *view, inlier_probability)
        J = dense.derivative(mean_at, *view)
        view_covariance = J.T @ np.linalg.inv(information) @ J

        _, s = view
        expected = given_view + view_covariance
        assert modes.covariance[0, 0] == pytest.approx(expected, abs=1e-4 * s**2)


def test_the_combination_of_one_mode_is_that_mode(draw_scene):
    scene, R = draw_scene(7)

    found = solve_one(scene, R)

    variance = np.diagonal(found.covariance[0]).reshape(3, 7)
    assert found.mean == pytest.approx(found.modes.mean[:, 0])
    assert found.covariance == pytest.approx(found.modes.covariance[:, 0])
    assert found.deviation[0] ** 2 == pytest.approx(variance)


def test_the_combination_of_modes_has_the_moments_of_their_mixture(draw_mixture):
    """Modes that lie apart add to the covariances between landmarks, too."""
    n = 40
    prior = draw_mixture(4, k=3)
    _, w, R = draw_images(prior, n, seed=2, residual_variance=0.003)
    others = draw_rotations(n, 4, np.random.default_rng(3))
    starts = np.concatenate([R[:, None], others], axis=1)

    found = solve(prior, w, starts, 0.003, modes=12, covariance=True)

    share = shares_of(found.modes)
    means = np.nan_to_num(found.modes.mean)
    mean = np.einsum("nm,nmap->nap", share, means)
    apart = np.nan_to_num(found.modes.mean - mean[:, None])
    apart = apart.reshape(n, 12, -1)
    within = np.einsum("nm,nmij->nij", share, found.modes.covariance)
    between = np.einsum("nm,nmi,nmj->nij", share, apart, apart)
    covariance = within + between
    has_all = share[:, -1] < 1e-6
    has_several = (share[:, 1] > 0.05) & has_all
    assert has_several.sum() >= 5
    assert_allclose(found.mean[has_several], mean[has_several], atol=1e-6)
    assert_allclose(found.covariance[has_several], covariance[has_several], atol=1e-6)


def test_without_shapes_all_else_is_the_same(draw_mixture):
    """Of an image without a posterior, too."""
    prior = draw_mixture(4, k=3)
    _, w, R = draw_images(prior, 20, seed=2, residual_variance=0.003)
    w[3, :, 2:] = np.nan

    whole = solve(prior, w, R[:, None], 0.003)
    found = solve(prior, w, R[:, None], 0.003, shapes=False)

    assert len(found.mean) == len(found.deviation) == len(found.correlation) == 0
    for name in (
        "inlier_probability",
        "rotation",
        "scale",
        "log_evidence",
        "squared_mahalanobis",
        "stationary",
        "rounds",
    ):
        assert_array_equal(getattr(found, name), getattr(whole, name))


def test_an_image_without_three_landmarks_has_no_posterior(draw_scene):
    scene, R = draw_scene(7, hidden=(0, 1, 2, 3, 4))
    found = solve_one(scene, R)
    assert np.isnan(found.mean).all()
    assert np.isnan(found.log_evidence).all()


def draw_views(prior: Mixture, n: int, residual_variance: float, views: int):
    """Landmarks (n, 2, p) of shapes of the mixture, and rotations (n, views, 3, 3) at
    random.
    """
    _, w, _ = draw_images(prior, n, 1, residual_variance)
    return w, draw_rotations(n, views, np.random.default_rng(2))


def log_likelihood_of_component(prior, component, landmarks, residual_variance):
    """Return the dense log likelihood of views of an image under one component."""
    p = landmarks.shape[1]
    scene = dense.Observation(
        landmarks,
        np.full(p, residual_variance),
        np.zeros((p, 2, 2)),
        prior.means[component],
        prior.covariances[component],
    )

    def log_likelihood(R, s):
        return dense.log_likelihood(scene, R, s, (0, 0.05), np.ones(p))

    return log_likelihood


@pytest.mark.parametrize(
    ("p", "size", "residual_variance"), [(5, 0.3, 0.02), (7, 0.5, 0.02), (6, 0.8, 0.01)]
)
def test_every_mode_that_counts_is_stationary(draw_mixture, p, size, residual_variance):
    """Newton's decrement from the dense log likelihood by differences; saddles do not
    count.
    """
    prior = draw_mixture(3, k=2, p=p, size=size)
    w, starts = draw_views(prior, 20, residual_variance, 8)

    found = solve(prior, w, starts, residual_variance, modes=8)

    modes = found.modes
    counted = np.argwhere(shares_of(modes) > 0.01)
    assert len(counted) > 25
    assert found.stationary.all()
    for i, m in counted:
        log_likelihood = log_likelihood_of_component(
            prior, modes.component[i, m], w[i], residual_variance
        )
        view = modes.rotation[i, m], modes.scale[i, m]
        slope = dense.derivative(log_likelihood, *view)
        information = -dense.hessian(log_likelihood, *view)
        decrement = slope @ np.linalg.solve(information, slope)
        assert abs(decrement) < 0.02


def test_modes_are_alike_from_all_sides_of_the_image(draw_mixture):
    """Few landmarks and a large misfit leave the view open; the axes of the image do
    not matter. Some images climb to another mode.
    """
    residual_variance = 0.3
    prior = draw_mixture(2, k=1, p=4, size=0.3)
    w, starts = draw_views(prior, 20, residual_variance, 1)
    turn = rotation_about_axis(2, np.array(0.7))

    plain = solve(prior, w, starts, residual_variance)
    other = solve(prior, turn[:2, :2] @ w, turn @ starts, residual_variance)

    difference = np.abs(other.mean - turn @ plain.mean)
    same = difference.max(axis=(1, 2)) < 1e-3
    evidence = plain.log_evidence[same]
    depth_sd = plain.deviation[same, 2]
    assert same.sum() > 12
    assert other.log_evidence[same] == pytest.approx(evidence, abs=2e-3)
    assert other.deviation[same, 2] == pytest.approx(depth_sd, rel=5e-3)


@pytest.mark.parametrize("exponent", [7, 8])
class TestSinglePrecision:
    """Images that single precision loses are found in double: of a prior that is nearly
    flat in some directions, with hardly any misfit.
    """

    N = 64
    P = 9

    @pytest.fixture
    def tiny(self, exponent):
        return 10.0**-exponent

    @pytest.fixture
    def roots(self):
        return 0.1 * np.random.default_rng(0).normal(size=(2, 27, 6))

    @pytest.fixture
    def prior(self, draw_mixture, roots, tiny):
        mixture = draw_mixture(3, k=2, p=self.P)
        covariances = covariance_of_root(roots, floor=tiny)
        return Mixture(mixture.weights, mixture.means, covariances)

    @pytest.fixture
    def drawn(self, prior, roots):
        """Shapes before the camera, without the part that is tiny, and rotations."""
        rng = np.random.default_rng(4)
        component = rng.choice(2, size=self.N, p=prior.weights)
        deviations = roots[component] @ rng.normal(size=(self.N, 6, 1))
        shapes = prior.means[component] + deviations.reshape(self.N, 3, self.P)
        R = random_rotations(self.N, rng)
        return R @ shapes, R

    @pytest.fixture
    def found(self, prior, drawn, tiny):
        y, R = drawn
        return solve(prior, y[:, :2], R[:, None], tiny)

    def test_their_shapes_are_found(self, found, drawn):
        y, _ = drawn
        error = np.abs(found.mean - without_mean_depth(y))
        assert error.max() < 0.05

    def test_their_evidence_is_that_at_the_truth(self, found, prior, drawn, tiny):
        """Within the volume of the views that are as good."""
        y, R = drawn

        def at_truth(image, component):
            log_likelihood = log_likelihood_of_component(
                prior, component, y[image, :2], tiny
            )
            log_weight = np.log(prior.weights[component])
            return log_weight + log_likelihood(R[image], 1.0)

        best = [max(at_truth(i, 0), at_truth(i, 1)) for i in range(self.N)]
        assert np.isfinite(found.log_evidence).all()
        assert np.abs(found.log_evidence - best).max() < 60


FRONT_VIEW = np.eye(3)[None, None]


def centred_mean():
    return centred(np.random.default_rng(0).normal(size=(3, 6)))


class TestWeights:
    """Climbs are compared with the weights of their components."""

    def test_a_component_of_next_to_no_weight_drives_none_of_the_others_out(self):
        """It fits better by far."""
        mean = centred_mean()
        other = mean * np.array([1.3, 0.8, 1.0])[:, None]
        C = 1e-3 * np.eye(18)
        weights = np.array([1.0, 1e-200])
        prior = Mixture(weights, np.stack([other, mean]), np.stack([C, C]))
        other_alone = single_gaussian(other, C)
        w = mean[None, :2]

        found = solve(prior, w, FRONT_VIEW, 1e-3, modes=2)
        expected = solve(other_alone, w, FRONT_VIEW, 1e-3)

        assert found.modes.component[0].tolist() == [0, -1]
        assert found.log_evidence == pytest.approx(expected.log_evidence, abs=1e-6)

    def test_components_that_are_alike_share_by_their_weights(self):
        mean = centred_mean()
        C = 0.01 * np.eye(18)
        weights = np.array([0.9, 0.1])
        prior = Mixture(weights, np.stack([mean, mean]), np.stack([C, C]))

        found = solve(prior, mean[None, :2], FRONT_VIEW, 0.01, modes=2)

        assert shares_of(found.modes)[0] == pytest.approx(weights, rel=1e-6)
        assert found.modes.component[0].tolist() == [0, 1]


def test_regions_hold_what_they_say_for_shapes_of_the_model(draw_mixture):
    residual_variance = 0.005
    prior = draw_mixture(4, size=0.1)
    y, w, R = draw_images(prior, 600, 6, residual_variance)

    found = solve(prior, w, R[:, None], residual_variance, covariance=True)

    assert_regions_hold(found, without_mean_depth(y))


class TestGrossLandmark:
    """A gross landmark is disbelieved, and the others stay."""

    RESIDUAL_VARIANCE = 0.005
    GROSS = 4
    OTHERS = np.delete(np.arange(13), GROSS)

    @pytest.fixture
    def prior(self, draw_mixture):
        return draw_mixture(5, p=13, size=0.08)

    @pytest.fixture
    def images(self, prior):
        return draw_images(prior, 40, 7, self.RESIDUAL_VARIANCE)

    def find(self, prior, w, R):
        return solve(
            prior, w, R[:, None], self.RESIDUAL_VARIANCE, outliers=Outliers(0.05)
        )

    @pytest.fixture
    def clean(self, prior, images):
        _, w, R = images
        return self.find(prior, w, R)

    @pytest.fixture
    def found(self, prior, images):
        _, w, R = images
        spoilt = w.copy()
        spoilt[:, :, self.GROSS] += np.array([2.0, -1.5])
        return self.find(prior, spoilt, R)

    def test_it_alone_is_disbelieved(self, found):
        probability = found.inlier_probability
        assert np.median(probability[:, self.GROSS]) < 0.01
        assert np.median(probability[:, self.OTHERS]) > 0.99

    def test_the_others_stay(self, found, clean, images):
        y, _, _ = images

        def error_of_others(posterior):
            away = np.abs(posterior.mean - y)[:, :2, self.OTHERS]
            return np.median(away.mean(axis=(1, 2)))

        assert error_of_others(found) < 1.1 * error_of_others(clean)


def test_a_climb_that_ends_on_a_saddle_does_not_count_beside_a_maximum():
    """A flat shape, foreshortened: seen face on it is a saddle between two tilts of
    equal worth.
    """
    rng = np.random.default_rng(0)
    flat = centred(np.vstack([rng.normal(size=(2, 9)), np.zeros(9)]))
    prior = single_gaussian(flat, 1e-3 * np.eye(27))
    tilt = rotation_about_axis(1, np.array(0.3))
    starts = np.stack([np.eye(3), tilt, tilt.T])
    foreshortened = (tilt @ flat)[:2]

    found = solve(prior, foreshortened[None], starts[None], 1e-3, modes=3)

    assert shares_of(found.modes)[0] == pytest.approx([0.5, 0.5, 0], abs=1e-5)


class TestSideBySide:
    """Climbs side by side, of other images too, that leave as they arrive change
    nothing.
    """

    N = 12

    @pytest.fixture
    def prior(self, draw_mixture):
        return draw_mixture(8, k=13, p=9, size=0.1)

    @pytest.fixture
    def find(self, prior):
        """Return the function that finds the posterior of some images of a prior."""
        _, w, R = draw_images(prior, self.N, 9, 0.01)
        w[2:, :, 3] = np.nan
        w[5, :, [0, 7]] = np.nan

        def find(prior, images=slice(None)):
            starts = R[images, None]
            return solve(prior, w[images], starts, 0.01, outliers=Outliers(0.02))

        return find

    def test_images_together_are_those_alone(self, prior, find):
        together = find(prior).mean
        alone = [find(prior, [image]).mean[0] for image in range(self.N)]
        assert_array_equal(together, alone)

    def test_components_together_are_those_alone(self, prior, find):
        together = find(prior)

        components = zip(prior.means, prior.covariances, strict=True)
        alone = [find(single_gaussian(mean, C)) for mean, C in components]
        evidence_alone = np.stack([one.log_evidence for one in alone])
        weighted = np.log(prior.weights)[:, None] + evidence_alone
        evidence = np.logaddexp.reduce(weighted)
        share = np.exp(weighted - evidence)
        mean = np.einsum("kn,knap->nap", share, [one.mean for one in alone])
        assert together.log_evidence == pytest.approx(evidence, abs=0.02)
        assert np.abs(together.mean - mean).max() < 0.02
