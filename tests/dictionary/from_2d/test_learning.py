"""Learning from 2D: planted shapes, landmarks that are gross, views that become
orthonormal.
"""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.dictionary.from_2d.learning import learn_class, upgrade
from shapefit.geometry.rotations import random_rotations
from tests.dictionary.from_2d.conftest import relative_error
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


def test_no_bit_depends_on_the_number_of_threads(plant, monkeypatch):
    images = plant(60, noise=0.02, hidden=0.1).images

    def learn_on(cores):
        monkeypatch.setattr("os.cpu_count", lambda: cores)
        return learn(images)

    one = learn_on(1)
    three = learn_on(3)

    assert one.objective == three.objective
    assert_array_equal(one.shapes, three.shapes)
    assert_array_equal(one.model.modes, three.model.modes)
