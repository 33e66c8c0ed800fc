"""The inference over a sequence: optimality, planted bodies, copies of a frame, error bars."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from shapefit.lifting.sequences.banded import Factor, accelerations, spread_back
from shapefit.lifting.sequences.noise import find_haste, find_noise, find_turn
from shapefit.lifting.sequences.observations import UNSEEN_VARIANCE, fill, observe
from shapefit.lifting.sequences.smoothing import _Problem, smooth
from shapefit.lifting.sequences.steady import steady
from shapefit.lifting.sequences.uncertainty import deviations


def dense(blocks, stiffness):
    """The matrix that `Factor` factors, by definition."""
    t, d, _ = blocks.shape
    D = np.zeros((t - 2, t))
    for row in range(t - 2):
        D[row, row : row + 3] = (1, -2, 1)
    whole = np.kron(D.T @ D, np.diag(stiffness))
    for f in range(t):
        whole[f * d : (f + 1) * d, f * d : (f + 1) * d] += blocks[f]
    return whole


def error(points, truth):
    return np.sqrt(((points - truth) ** 2).mean())


@pytest.mark.parametrize("frames", [1, 2, 3, 8])
def test_the_banded_system_is_the_dense_one(rng, frames):
    d = 4
    A = rng.standard_normal((frames, d, d))
    blocks, stiffness = A @ A.swapaxes(1, 2) + np.eye(d), rng.uniform(0.1, 5, d)
    whole = dense(blocks, stiffness) if frames > 2 else None
    if whole is None:
        whole = np.zeros((frames * d, frames * d))
        for f in range(frames):
            whole[f * d : (f + 1) * d, f * d : (f + 1) * d] = blocks[f]
    factor = Factor(blocks, stiffness)
    right = rng.standard_normal((frames, d, 3))
    expected = np.linalg.solve(whole, right.reshape(-1, 3)).reshape(right.shape)
    np.testing.assert_allclose(factor.solve(right), expected, atol=1e-9)
    assert factor.log_det == pytest.approx(np.linalg.slogdet(whole)[1])


def test_the_transposed_difference_is_the_adjoint(rng):
    y, a = rng.standard_normal((9, 3)), rng.standard_normal((7, 3))
    assert (accelerations(y) * a).sum() == pytest.approx((y * spread_back(a, 9)).sum())


def test_the_gradient_is_that_of_the_energy_and_vanishes_at_the_end(images, body, model):
    seen = images(body, noise=0.02)
    found = smooth(seen, model, 0.02, rounds=200)
    problem = _Problem(seen, model, 0.02, found.lengths)

    def gradients(y, lengths):
        at = problem.look(y, lengths)
        return problem.equations(y, at)[1], at

    y = found.points.reshape(len(seen), -1)
    away = y + 0.01 * np.random.default_rng(1).standard_normal(y.shape)
    gradient, at = gradients(away, found.lengths)
    for place in ((0, 0), (5, 7), (23, 14)):
        step = np.zeros_like(y)
        step[place] = 1e-6
        ahead = problem.look(away + step, found.lengths).energy
        behind = problem.look(away - step, found.lengths).energy
        assert gradient[place] == pytest.approx((ahead - behind) / 2e-6, rel=1e-4, abs=1e-3)
    at_end = np.abs(gradients(y, found.lengths)[0]).max()
    assert at_end < 2e-2 * np.abs(gradient).max()
    assert problem.look(y, found.lengths).energy <= at.energy


def test_a_rigid_body_is_found_where_single_images_are_far_off(images, body, model):
    seen = images(body, noise=0.002)
    found = smooth(seen, model, 0.003, rounds=50)
    assert error(seen.start, body) > 0.15
    assert error(found.points, body) < 0.35 * error(seen.start, body)
    true = np.linalg.norm(body[0, :, model.bones[:, 0]] - body[0, :, model.bones[:, 1]], axis=1)
    np.testing.assert_allclose(found.lengths, true, rtol=0.06)


def test_known_lengths_up_to_scale_are_kept(images, body, model):
    true = np.linalg.norm(body[0, :, model.bones[:, 0]] - body[0, :, model.bones[:, 1]], axis=1)
    seen = images(body, noise=0.002)
    found = smooth(seen, replace(model, known=40 * true), 0.003, rounds=50)
    ratio = found.lengths / true
    np.testing.assert_allclose(ratio / ratio.mean(), 1, atol=0.03)


def test_copies_of_a_frame_stay_within_a_standard_deviation(images, body, model):
    one = images(body[:1], noise=0.02)
    copies = replace(
        one,
        **{
            name: np.repeat(getattr(one, name), 30, axis=0)
            for name in ("landmarks", "trust", "start", "log_share", "mean", "precision", "log_det")
        },
    )
    assert find_noise(copies, model) is None
    found = smooth(copies, model, 0.1)
    sd = np.sqrt(np.diag(np.linalg.inv(one.precision[0, 0]))).reshape(3, -1)
    assert (np.abs(found.points - copies.start) < sd).all()
    np.testing.assert_allclose(
        found.points, np.broadcast_to(found.points[0], (30, 3, 5)), atol=1e-4
    )


def test_deviations_are_those_of_the_dense_inverse(images, body, model):
    for frames in (7, 8):
        seen = images(body[:frames], noise=0.02)
        found = smooth(seen, model, 0.03)
        problem = _Problem(seen, model, 0.03, found.lengths)
        y = found.points.reshape(frames, -1)
        blocks = problem.equations(y, problem.look(y, found.lengths))[0]
        covariance = np.linalg.inv(dense(blocks, problem.stiffness))
        expected = np.sqrt(np.diag(covariance))
        got, mixed = deviations(seen, model, 0.03, found)
        np.testing.assert_allclose(got.reshape(-1), expected, rtol=1e-6)
        correlation = (covariance / np.outer(expected, expected)).reshape(2 * (frames, 3, 5))
        for row, (a, b) in enumerate(((0, 1), (0, 2), (1, 2))):
            own = np.einsum("tjtj->tj", correlation[:, a][:, :, :, b])
            np.testing.assert_allclose(mixed[:, row], own, atol=1e-9)


def test_the_noise_is_found_in_the_sequence(images, body, model):
    exact = find_noise(images(body, noise=0.0, depth=0.1), model)
    noisy = find_noise(images(body, noise=0.06, depth=0.1), model)
    assert exact <= 0.01 < noisy


def test_bones_that_do_not_turn_tell_no_noise(images, body, model):
    still = np.repeat(body[:1], 20, axis=0)
    assert find_turn(images(still), model) < 0.05
    assert find_noise(images(still), model) is None
    assert find_turn(images(body), model) > 0.3


def test_haste_is_that_of_the_images(images, rng, body):
    still = np.repeat(body[:1], 400, axis=0)
    noise_alone = images(still, noise=0.05)
    assert find_haste(noise_alone, np.full(5, 0.05)) == 1
    path = np.cumsum(np.cumsum(rng.standard_normal((400, 3, 5)), axis=0), axis=0)
    kernel = np.ones(4) / 4
    smoothed = np.apply_along_axis(np.convolve, 0, path, kernel, "valid")
    second = np.sqrt((accelerations(smoothed.reshape(len(smoothed), -1)) ** 2).mean())
    moving = images(smoothed)
    assert find_haste(moving, np.full(5, second / 5)) == pytest.approx(5, rel=0.2)


def test_frames_without_modes_lie_between_their_neighbours(images, body):
    seen = images(body)
    known = np.ones(len(seen), dtype=bool)
    known[[0, 4, 5]] = False
    filled = fill(seen.start, known)
    np.testing.assert_allclose(filled[0], seen.start[1])
    np.testing.assert_allclose(filled[4], (2 * seen.start[3] + seen.start[6]) / 3)
    evidence = np.where(known[:, None], 0.0, -np.inf) * np.ones((1, 2))
    modes = np.repeat(seen.start[:, None], 2, axis=1)
    covariance = np.tile(np.eye(15), (len(seen), 2, 1, 1))
    blind = observe(
        seen.landmarks, np.ones((len(seen), 5)), seen.start, evidence, modes, covariance, 0.01
    )
    assert blind.trust[0].sum() == 0
    assert blind.precision[0, 0, 0, 0] == pytest.approx(1 / UNSEEN_VARIANCE)
    with pytest.raises(ValueError, match="no frame"):
        fill(seen.start, np.zeros(len(seen), dtype=bool))


def test_steadying_is_the_dense_least_squares(rng):
    means, sd = rng.standard_normal((12, 3, 2)), rng.uniform(0.5, 2, (12, 3, 2))
    sd[4] = np.inf
    got = steady(means, sd, np.array([0.3, 0.7]))
    D = np.zeros((10, 12))
    for row in range(10):
        D[row, row : row + 3] = (1, -2, 1)
    for axis in range(3):
        for j, a in enumerate((0.3, 0.7)):
            weight = np.diag(sd[:, axis, j] ** -2.0)
            expected = np.linalg.solve(weight + D.T @ D / a**2, weight @ means[:, axis, j])
            np.testing.assert_allclose(got[:, axis, j], expected, atol=1e-9)
    copies = np.repeat(means[:1], 12, axis=0)
    np.testing.assert_allclose(steady(copies, sd, np.array([0.3, 0.7])), copies, atol=1e-9)
