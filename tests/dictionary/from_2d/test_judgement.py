"""The verdict on what was learned from 2D: depth that is lost, noise, poses seen from
one side.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
import pytest
from numpy.testing import assert_allclose

from shapefit.arrays import Floats
from shapefit.dictionary.from_2d.judgement import (
    DOUBTFUL_DEPTH,
    LEARNED,
    NOTHING_IN_COMMON,
    VIEWS_ALIKE,
    evaluate_class,
    penalty_of_views,
    roll_angles,
)
from shapefit.dictionary.from_2d.learning import ClassState, learn_class
from shapefit.dictionary.from_2d.model import Views, posterior_mean
from shapefit.geometry.rotations import (
    exponential,
    random_rotations,
    rotation_about_axis,
)
from tests.dictionary.from_2d.conftest import images_of, relative_error
from tests.points import centred, with_noise


class TestPosesSeenFromOneSide:
    """A body bends while it turns: by less than half a turn, or by four turns."""

    N = 80
    P = 20

    @pytest.fixture
    def bending(self, rng):
        time = np.linspace(0, 1, self.N)[:, None]
        phase = time * [1.0, 1.37, 2.1] + rng.random(3)
        bends = np.sin(2 * np.pi * phase)
        mean = rng.standard_normal((3, self.P))
        modes = 0.3 * rng.standard_normal((3, 3, self.P))
        return centred(mean + np.tensordot(bends, modes, axes=1))

    @pytest.mark.parametrize(("degrees", "learned"), [(150, False), (1500, True)])
    def test_halves_disagree_where_each_pose_is_seen_from_one_side(
        self, bending, degrees, learned
    ):
        angles = np.radians(np.linspace(0, degrees, self.N))
        shapes = rotation_about_axis(1, angles) @ bending
        images = images_of(shapes[:, :2])
        *_, state = learn_class(images)

        judged = evaluate_class(images, state)

        assert (judged.verdict == LEARNED) == learned
        assert (judged.half_distance < 0.1) == learned
        assert relative_error(state.in_camera, shapes) < judged.half_distance


def test_the_angles_by_which_a_picture_was_rolled_are_found(rng):
    angles = rng.uniform(-1, 1, 6)
    rolls = rotation_about_axis(2, angles)[:, :2, :2]
    picture = rng.normal(size=(2, 8))

    found = roll_angles(rolls @ picture)

    assert_allclose(found - found[0], angles - angles[0], atol=1e-6)


P = 14
"""Landmarks."""

NOISE = 0.03
"""Of landmarks, as a share of their spread."""


def draw_shapes(rng, n=50, modes=3, deviation=0.15, depth=1.0):
    """Draw shapes (n, 3, p) in their own frame; depth is a factor of z."""
    mean = rng.standard_normal((3, P))
    V = deviation * rng.standard_normal((3, P, modes))
    deformation = np.einsum("ipq,nq->nip", V, rng.standard_normal((n, modes)))
    return (mean + deformation) * [[1.0], [1.0], [depth]]


def swayed(rng, axis, degrees, **keys):
    """Draw shapes that sway about an axis."""
    shapes = draw_shapes(rng, **keys)
    angles = degrees * np.sin(np.arange(len(shapes)))
    return rotation_about_axis(axis, np.radians(angles)) @ shapes


def seen_anywhere(rng, **keys):
    """Draw shapes that are seen from all sides."""
    shapes = draw_shapes(rng, **keys)
    return random_rotations(len(shapes), rng) @ shapes


def seen_from_before(rng, degrees, **keys):
    """Draw shapes that are turned by about so many degrees."""
    shapes = draw_shapes(rng, **keys)
    turns = np.radians(degrees) * rng.standard_normal((len(shapes), 3))
    return exponential(turns) @ shapes


def noise_alone(rng):
    return rng.standard_normal((80, 3, P))


class Case(NamedTuple):
    """What draws shapes, and the verdicts that are right."""

    draw: Callable[[np.random.Generator], Floats]
    right: set[str]


sway = partial(swayed, axis=1)
roll = partial(swayed, axis=2, degrees=90)
VERDICTS = {
    "camera at rest": Case(draw_shapes, {VIEWS_ALIKE}),
    "same shape, same view": Case(partial(draw_shapes, deviation=0.0), {VIEWS_ALIKE}),
    "sways by 15 degrees": Case(partial(sway, degrees=15), {VIEWS_ALIKE}),
    "camera rolls": Case(roll, {VIEWS_ALIKE}),
    "same shape, camera rolls": Case(partial(roll, deviation=0.0), {VIEWS_ALIKE}),
    "flat and stiff": Case(
        partial(seen_anywhere, deviation=0.0, depth=0.0), {VIEWS_ALIKE}
    ),
    "flat and bends": Case(
        partial(seen_anywhere, depth=0.0), {VIEWS_ALIKE, DOUBTFUL_DEPTH}
    ),
    "20 images of 6 modes": Case(
        partial(seen_anywhere, n=20, modes=6, deviation=0.25), {DOUBTFUL_DEPTH}
    ),
    "sways by 45 degrees": Case(
        partial(sway, degrees=45, n=100), {DOUBTFUL_DEPTH, LEARNED}
    ),
    "any view": Case(seen_anywhere, {LEARNED}),
    "stiff, 30 images": Case(partial(seen_anywhere, n=30, deviation=0.0), {LEARNED}),
    "shallow": Case(partial(seen_anywhere, depth=0.2), {LEARNED}),
    "from before": Case(partial(seen_from_before, degrees=30, n=100), {LEARNED}),
    "noise": Case(noise_alone, {NOTHING_IN_COMMON}),
}


@pytest.mark.parametrize("case", VERDICTS.values(), ids=VERDICTS.keys())
def test_verdicts(rng, case):
    shapes = case.draw(rng)
    shapes = shapes / centred(shapes)[:, :2].std()
    images = images_of(with_noise(shapes[:, :2], NOISE, rng))
    *_, state = learn_class(images)

    judged = evaluate_class(images, state)

    assert judged.verdict in case.right


class TestPenaltyOfViews:
    """It is what the evidence loses where the views are not fitted, but anything.

    log p(w | R fitted) - log (mean of p(w | R) over all R), of images of a stiff shape
    whose views are certain: only near those fitted p is not 0.
    """

    N = 2

    @pytest.fixture
    def planted(self, plant):
        return plant(self.N, deviation=0.0)

    @pytest.fixture
    def state(self, planted):
        nothing = np.zeros(self.N)
        no_outliers = np.zeros(planted.images.weights.shape, dtype=bool)
        return ClassState(
            planted.views, planted.model, nothing, planted.shapes, no_outliers
        )

    def log_shares(self, planted, image, turns):
        """Return log p(w | turned R) - log p(w | R) of one image, for turns (m, 3)."""
        m = len(turns)
        copies = planted.images[np.full(m, image)]
        rotation = exponential(turns) @ planted.views.rotation[image]
        views = Views(rotation, np.full(m, planted.views.log_scale[image]))
        found = posterior_mean(copies, views, planted.model).log_density
        fitted = posterior_mean(planted.images, planted.views, planted.model)
        return found - fitted.log_density[image]

    @pytest.mark.parametrize(
        ("axes", "size_of_all"),
        [(slice(2, 3), 2 * np.pi), (slice(0, 3), 8 * np.pi**2)],
        ids=["of the roll", "of all rotations"],
    )
    def test_it_is_that_of_the_evidence(self, planted, state, axes, size_of_all):
        step = 0.004
        angles = step * np.arange(-18, 19)
        d = axes.stop - axes.start
        grid = np.stack(np.meshgrid(*[angles] * d, indexing="ij"), axis=-1)
        turns = np.zeros((angles.size**d, 3))
        turns[:, axes] = grid.reshape(-1, d)
        log_means = []
        for image in range(self.N):
            total = np.exp(self.log_shares(planted, image, turns)).sum() * step**d
            log_means.append(np.log(total / size_of_all))

        found = penalty_of_views(planted.images, state, axes)

        assert found == pytest.approx(-sum(log_means), abs=0.02 * self.N)
