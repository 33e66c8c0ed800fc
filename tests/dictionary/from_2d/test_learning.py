"""Learning from 2D: planted shapes, landmarks that are gross, views that become
orthonormal.
"""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.dictionary.from_2d.learning import (
    find_views,
    first_state,
    learn_class,
    learn_round,
    upgrade,
)
from shapefit.geometry.rotations import random_rotations, rotation_angle
from tests.dictionary.from_2d.conftest import centred_landmarks, relative_error
from tests.points import transpose, with_noise


def assert_objective_rises(states):
    objective = [state.objective for state in states]
    assert (np.diff(objective) > 0).all()


def learn(images):
    """Return the last state of learning."""
    *_, state = learn_class(images)
    return state


@pytest.mark.parametrize(
    ("noise", "hidden", "most"), [(0.0, 0.0, 0.02), (0.02, 0.1, 0.06)]
)
def test_planted_shapes_are_recovered_and_the_objective_never_falls(
    plant, noise, hidden, most
):
    planted = plant(60, noise=noise, hidden=hidden)

    states = list(learn_class(planted.images))

    assert_objective_rises(states)
    assert relative_error(states[-1].in_camera, planted.shapes) < most


def spoil(images, share, rng):
    """Throw some landmarks anywhere within their image; return which, too."""
    is_spoilt = rng.random(images.weights.shape) < share
    low = images.landmarks.min(axis=2, keepdims=True)
    high = images.landmarks.max(axis=2, keepdims=True)
    anywhere = low + (high - low) * rng.random(images.landmarks.shape)
    landmarks = np.where(is_spoilt[:, None], anywhere, images.landmarks)
    return replace(images, landmarks=landmarks), is_spoilt


def test_gross_landmarks_are_found_and_the_objective_never_falls(plant, rng):
    planted = plant(100, p=24, noise=0.01)
    images, is_spoilt = spoil(planted.images, 0.05, rng)

    states = list(learn_class(images))

    assert_objective_rises(states)
    outliers = states[-1].outliers
    found = outliers & is_spoilt
    false_alarms = outliers & ~is_spoilt
    assert found.sum() > 0.9 * is_spoilt.sum()
    assert false_alarms.mean() < 0.002
    assert relative_error(states[-1].in_camera, planted.shapes) < 0.03


def test_no_landmark_of_clean_images_is_gross_even_where_a_pose_is_rare(plant, rng):
    """In five of a hundred images four landmarks are raised."""
    planted = plant(100, p=24, noise=0.01)
    raised = np.zeros((3, 24))
    raised[:, :4] = 1.2 * rng.standard_normal((3, 1))
    in_camera = planted.views.rotation[:5] @ raised
    planted.images.landmarks[:5] += in_camera[:, :2]

    state = learn(planted.images)

    assert not state.outliers.any()


@pytest.mark.parametrize("rank", [3, 5])
def test_an_upgrade_of_exact_factors_makes_every_view_orthonormal(rng, rank):
    A = rng.standard_normal((rank, rank))
    views = random_rotations(40, rng)[:, :2]
    mode_columns = rng.standard_normal((40, 2, rank - 3))
    rows = np.concatenate([views, mode_columns], axis=2)
    L = rows @ np.linalg.inv(A)
    start = with_noise(A[:, :3], 0.05, rng)

    Q = upgrade(L, start)

    found = L @ Q
    gram = found @ transpose(found)
    assert_allclose(gram, np.broadcast_to(np.eye(2), gram.shape), atol=1e-6)


class TestViewsOfRigidShapes:
    """Twenty views of one shape, each of them once small and once large."""

    SMALL = 0.9
    LARGE = 1.1

    @pytest.fixture
    def rotations(self, rng):
        return np.tile(random_rotations(20, rng), (2, 1, 1))

    @pytest.fixture
    def views(self, rng, rotations):
        shape = centred_landmarks(rng.standard_normal((3, 12)))
        size = np.repeat([self.SMALL, self.LARGE], 20)
        landmarks = size[:, None, None] * (rotations @ shape)[:, :2]
        (found,) = find_views(landmarks, (3,))
        return found

    def test_their_sizes_are_found(self, views):
        small, large = np.split(views.log_scale, 2)
        assert_allclose(large - small, np.log(self.LARGE / self.SMALL), atol=1e-6)
        assert_allclose(small, small[0], atol=1e-6)

    def test_so_are_their_turns_from_one_to_the_other(self, views, rotations):
        found = rotation_angle(views.rotation, views.rotation[7])
        expected = rotation_angle(rotations, rotations[7])
        assert_allclose(found, expected, atol=1e-5)


@pytest.mark.parametrize(("ranks", "count"), [((3,), 1), ((3, 5), 2), ((4, 5, 7), 3)])
def test_there_are_views_for_each_number_of_factors(plant, ranks, count):
    landmarks = centred_landmarks(plant(30).shapes)[:, :2]
    found = find_views(landmarks, ranks)
    assert len(found) == count
    for views in found:
        assert views.rotation.shape == (30, 3, 3)
        assert_allclose(np.linalg.det(views.rotation), 1)


@pytest.mark.parametrize(("n", "most"), [(3, 1), (12, 3), (19, 4)])
def test_few_images_have_few_modes(plant, n, most):
    """A mode that fewer than four images show is their noise."""
    planted = plant(n, modes=8)
    images = planted.images
    rigid = first_state(images, images.landmarks, planted.views)
    state = learn_round(images, rigid, hold=True)
    assert state.model.modes.shape[2] == most


def test_one_round_finds_the_noise_and_the_sizes_of_two_videos(plant):
    """Of many images, from the views and the model behind them."""
    planted = plant(400, modes=2, noise=0.02)
    video = np.arange(400) % 2
    log_size = np.array([0.3, -0.2])
    size = np.exp(log_size)
    planted.images.landmarks[:] *= size[video][:, None, None]
    images = replace(planted.images, sequence=video)
    model = replace(planted.model, rest=1e-6, log_size=np.zeros(2))
    views = replace(planted.views, log_scale=log_size[video])
    rigid = first_state(images, images.landmarks, views)

    state = learn_round(images, replace(rigid, model=model), hold=True)

    assert_allclose(state.model.log_size, log_size)
    noise = 0.02**2 * (size**2).mean()
    assert state.model.noise == pytest.approx(noise, rel=0.05)


def test_no_bit_depends_on_the_number_of_threads(plant, monkeypatch):
    """Of more images than a thread takes at a time."""
    images = plant(150, noise=0.02, hidden=0.1).images

    def learn_on(cores):
        monkeypatch.setattr("os.cpu_count", lambda: cores)
        return learn(images)

    one = learn_on(1)

    for cores in (2, 3):
        several = learn_on(cores)
        assert one.objective == several.objective
        assert_array_equal(one.shapes, several.shapes)
        assert_array_equal(one.model.modes, several.model.modes)
