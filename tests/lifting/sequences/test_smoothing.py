"""The inference over a sequence against its objective written out densely, and planted
bodies.
"""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from shapefit.lifting.sequences import smoothing
from shapefit.lifting.sequences.clips import (
    find_acceleration_scale,
    find_growth,
    weigh_lengths,
)
from shapefit.lifting.sequences.smoothing import (
    CONSTANTS,
    Lengths,
    Observations,
    fill,
    find_precisions,
    fixed_lengths,
    mean_lengths,
    observe,
    smooth,
    uncounted_weight,
)
from shapefit.timeline import Timeline
from tests.lifting.sequences.conftest import BONES


@pytest.mark.parametrize("p", [1, 3, 5])
def test_precisions_are_inverses(rng, p):
    d = 3 * p
    A = rng.standard_normal((70, 2, d, d))
    covariances = A @ A.swapaxes(2, 3)
    more, there = rng.uniform(0.1, 1, (70, 2)), rng.random((70, 2)) < 0.8
    factor = rng.uniform(0.5, 2, (70, 2))
    factor[0], covariances[0] = 0, np.nan  # not known
    expected = factor[..., None, None] * np.nan_to_num(covariances)
    expected = expected + more[..., None, None] * np.eye(d)
    others = covariances[~there].copy()
    found, log_det = find_precisions(covariances, factor, more, there)
    np.testing.assert_allclose(
        (found @ expected)[there], np.eye(d)[None].repeat(there.sum(), 0), atol=1e-8
    )
    np.testing.assert_allclose(log_det[there], np.linalg.slogdet(expected)[1][there])
    np.testing.assert_array_equal(found[~there], others)


@pytest.mark.parametrize("case", ["free", "known lengths", "far", "gaps"])
@pytest.mark.parametrize("frames", [1, 2, 3, 4, 9])
def test_a_step_is_that_of_the_dense_system(images, body, model, frames, case):
    """The first step, damped, half a unit at most."""
    visible = images(body[:frames], noise=0.02, depth=0.1)
    if case == "known lengths":
        longer = smoothing.mean_lengths(body, model.bones) * [1.3, 1, 0.8, np.nan]
        known = np.diag([1.0, 1, 1, 0]) - 0.2 * np.outer([1, 1, 1, 0], [1, 1, 1, 0])
        model = replace(model, usual=Lengths(longer, known / 0.002**2))
    if case == "gaps":
        model = with_gaps(model, frames)
    if case == "far":
        visible = replace(visible, start=visible.start + 2)
    found = smooth(visible, model, 0.1, max_rounds=1)
    judge, e = Objective(visible, model, 0.1), len(model.bones)
    y = visible.start.reshape(frames, -1)
    lengths = smoothing.mean_lengths(visible.start, model.bones)
    assert smooth(visible, model, 0.1, max_rounds=0).energy == pytest.approx(
        judge.energy(y, lengths)
    )
    A = judge.matrix(y) + 0.1 * np.eye(y.size)
    along, size = judge.bones(y)
    M = np.zeros((frames, 3, y.shape[1] // 3, e))
    for b, (i, j) in enumerate(model.bones):
        M[:, :, i, b] = (
            -along[:, :, b] / size[:, None, b] / model.bone_tolerance[b] ** 2
        )
        M[:, :, j, b] = -M[:, :, i, b]
    M = M.reshape(-1, e)
    own = np.diag(frames / model.bone_tolerance**2 + 1e-9) + judge.hold
    whole = np.block([[A, M], [M.T, own]])
    step = np.linalg.solve(whole, judge.gradient(y, lengths))
    shrink = min(1.0, 0.5 / np.abs(step[: y.size]).max())
    assert case != "far" or shrink < 0.5
    np.testing.assert_allclose(
        found.points.reshape(-1), y.reshape(-1) - shrink * step[: y.size], atol=1e-6
    )
    np.testing.assert_allclose(
        found.lengths, lengths - shrink * step[y.size :], atol=1e-6
    )


def test_the_end_is_a_minimum_of_the_dense_objective(images, body, model, monkeypatch):
    monkeypatch.setattr(smoothing, "MIN_FRAME_GAIN", 1e-9)
    visible = images(body, noise=0.02)
    found = smooth(visible, model, 0.02, max_rounds=200)
    judge = Objective(visible, model, 0.02)
    y = found.points.reshape(len(visible), -1)
    assert found.converged
    assert not smooth(visible, model, 0.02, max_rounds=2).converged
    assert found.energy == pytest.approx(judge.energy(y, found.lengths))
    first = judge.gradient(
        visible.start.reshape(y.shape),
        smoothing.mean_lengths(visible.start, model.bones),
    )
    assert np.abs(judge.gradient(y, found.lengths)).max() < 1e-4 * np.abs(first).max()
    for seed in range(5):
        away = 0.01 * np.random.default_rng(seed).standard_normal(y.shape)
        assert judge.energy(y + away, found.lengths) > found.energy


def only_mode(visible):
    """The images with their first modes alone."""
    parts = ("log_share", "mean", "precision", "log_det")
    return replace(
        visible, **{name: getattr(visible, name)[:, :1].copy() for name in parts}
    )


@pytest.mark.parametrize("gaps", [False, True])
@pytest.mark.parametrize("frames", [1, 2, 5])
def test_deviations_are_those_of_the_dense_hessian(images, body, model, frames, gaps):
    """Of the whole energy, by differences of its gradient: bones that are too short
    count, too.
    """
    visible = only_mode(images(body[:frames], noise=0.02))
    model = replace(model, bone_tolerance=np.full(4, 0.1))
    model = with_gaps(model, frames) if gaps else model
    found = smooth(visible, model, 0.03, max_rounds=100)
    y = found.points.reshape(frames, -1)
    judge = Objective(visible, model, 0.03)
    covariance = np.linalg.inv(judge.hessian(y, found.lengths))
    own = np.einsum("tatb->tab", covariance.reshape(2 * (frames, 15)))
    np.testing.assert_allclose(found.covariance, own, atol=1e-5)
    expected = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(found.deviation.reshape(-1), expected, rtol=1e-3)
    held = np.sqrt(np.diag(np.linalg.inv(judge.matrix(y))))
    assert frames == 1 or np.abs(held / expected - 1).max() > 0.02
    correlation = (covariance / np.outer(expected, expected)).reshape(
        2 * (frames, 3, 5)
    )
    for row, (a, b) in enumerate(((0, 1), (0, 2), (1, 2))):
        own = np.einsum("tjtj->tj", correlation[:, a][:, :, :, b])
        np.testing.assert_allclose(found.correlation[:, row], own, atol=1e-3)


@pytest.mark.parametrize("apart", [1.0, 4.0])
@pytest.mark.parametrize("weighted", [False, True])
def test_a_frame_by_itself_has_the_covariance_of_its_mixture(
    model, rng, apart, weighted
):
    """Two modes `apart` standard deviations, and the landmarks: Gaussians multiplied in
    NumPy.
    """
    C = np.stack([np.cov(rng.standard_normal((15, 40))) * 0.04 for _ in range(2)])
    mean = rng.standard_normal(15) + np.outer([0, 1], np.ones(15)) * apart * 0.2
    landmarks = mean[0, :10] + 0.05
    precision, weight = np.linalg.inv(C), (30.0 if weighted else 0.0) * np.eye(15)
    weight[10:] = 0
    share = np.log([0.6, 0.4])
    log_det = np.linalg.slogdet(C)[1]
    residual_variance = 0.2**2
    visible = Observations(
        landmarks=landmarks.reshape(1, 2, 5),
        trust=np.ones((1, 5)),
        start=mean[:1].reshape(1, 3, 5),
        residual_variance=residual_variance,
        log_share=share[None],
        mean=mean[None],
        precision=precision[None],
        log_det=log_det[None],
        growth=np.ones(1),
    )
    free = replace(
        model, bones=model.bones[:0], bone_tolerance=model.bone_tolerance[:0]
    )
    noise = (1 / residual_variance + weight[0, 0]) ** -0.5
    found = smooth(visible, free, noise, max_rounds=50)
    w = np.append(landmarks, np.zeros(5))
    parts = np.linalg.inv(precision + weight)
    means = [
        part @ (P @ m + weight @ w)
        for part, P, m in zip(parts, precision, mean, strict=True)
    ]
    logs = []
    for k in range(2):
        away = (means[k] - mean[k], means[k] - w)
        logs.append(
            share[k]
            + 0.5 * (np.linalg.slogdet(parts[k])[1] - log_det[k])
            - 0.5 * (away[0] @ precision[k] @ away[0] + away[1] @ weight @ away[1])
        )
    shares = np.exp(logs - np.logaddexp.reduce(logs))
    middle = shares @ np.array(means)
    expected = sum(
        q * (part + np.outer(m - middle, m - middle))
        for q, part, m in zip(shares, parts, means, strict=True)
    )
    np.testing.assert_allclose(found.covariance[0], expected, atol=1e-8)
    sd = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(found.deviation.reshape(-1), sd, rtol=1e-6)
    assert found.correlation[0, 2, 3] == pytest.approx(
        expected[8, 13] / (sd[8] * sd[13]), abs=1e-6
    )


@pytest.mark.parametrize("lag", [1, 3])
def test_the_scale_of_accelerations_is_that_of_the_motion(images, rng, body, lag):
    """Neither noise that forgets itself within the lag nor jumps of landmarks are
    motion.
    """
    still = np.repeat(body[:1], 400, axis=0)
    noise_alone = images(still, noise=0.05)
    assert find_acceleration_scale(noise_alone, np.full(5, 0.03), lag) == 1
    path = np.cumsum(np.cumsum(rng.standard_normal((400, 3, 5)), axis=0), axis=0)
    kernel = np.ones(4) / 4
    smoothed = np.apply_along_axis(np.convolve, 0, path, kernel, "valid")
    second = np.sqrt((np.diff(smoothed, 2, axis=0) ** 2).mean())
    moving = images(smoothed)
    expected = np.full(5, second / 5)
    assert find_acceleration_scale(moving, expected, lag) == pytest.approx(
        5, rel=0.25 * lag
    )
    jumps = 100 * second * rng.standard_normal(moving.landmarks.shape)
    jumps[rng.random(len(jumps)) > 0.03] = 0
    jumping = replace(moving, landmarks=moving.landmarks + jumps)
    assert find_acceleration_scale(jumping, expected, lag) < 10
    assert find_acceleration_scale(images(body[:3]), expected, lag) == 1


def test_frames_without_modes_lie_between_their_neighbours(images, body):
    visible = images(body)
    known = np.ones(len(visible), dtype=bool)
    known[[0, 4, 5]] = False
    filled = fill(visible.start, known)
    np.testing.assert_allclose(filled[0], visible.start[1])
    np.testing.assert_allclose(filled[4], (2 * visible.start[3] + visible.start[6]) / 3)
    evidence = np.where(known[:, None], 0.0, -np.inf) * np.ones((1, 2))
    modes = np.repeat(visible.start[:, None], 2, axis=1)
    covariance = np.tile(np.eye(15), (len(visible), 2, 1, 1))
    blind = observe(
        visible.landmarks,
        np.ones((len(visible), 5)),
        visible.start,
        evidence,
        modes,
        covariance,
        0.01,
    )
    assert blind.trust[0].sum() == 0
    assert blind.precision[0, 0, 0, 0] == pytest.approx(CONSTANTS.widest**-2)
    with pytest.raises(ValueError, match="no frame"):
        fill(visible.start, np.zeros(len(visible), dtype=bool))


@pytest.mark.parametrize("width", [2.0, 30.0])
def test_growth_is_a_line_through_what_is_near(rng, width):
    """Weighted least squares about each frame; what is a line stays one, without its
    mean.
    """
    level, there = rng.standard_normal(20), np.ones(20, dtype=bool)
    t, timeline = np.arange(20), Timeline.of_frames(20)
    expected = [
        np.polyfit(t - k, level, 1, w=np.exp(-0.25 * ((t - k) / width) ** 2))[1]
        for k in t
    ]
    found = np.log(find_growth(np.exp(level), there, width, timeline))
    np.testing.assert_allclose(found, expected - np.mean(expected), atol=2e-3)
    there[[0, 7, 8]] = False
    nearer = np.where(there, np.exp(0.1 * t), np.nan)
    line = 0.1 * (t - t[there].mean())
    np.testing.assert_allclose(
        np.log(find_growth(nearer, there, width, timeline))[1:], line[1:], atol=1e-4
    )


def test_a_unit_of_each_frame_is_that_of_images_observed_in_it(images, body, rng):
    growth = np.exp(rng.uniform(-0.2, 0.2, len(body)))
    g = growth[:, None, None]
    visible = images(body, noise=0.02)
    covariance = np.linalg.inv(visible.precision)
    found = visible.grown(growth)
    np.testing.assert_allclose(found.start * g, visible.start)
    np.testing.assert_allclose(found.mean * g, visible.mean)
    precision = found.growth[:, None, None, None] ** 2 * found.precision
    np.testing.assert_allclose(np.linalg.inv(precision), covariance / g[..., None] ** 2)
    np.testing.assert_allclose(
        found.log_det, np.linalg.slogdet(covariance / g[..., None] ** 2)[1]
    )


def test_errors_that_images_share_do_not_outweigh_known_lengths(
    images, body, model, monkeypatch
):
    """A bone too short alike in all frames: many copies say no more of it than some
    do.
    """
    monkeypatch.setattr(smoothing, "MIN_FRAME_GAIN", 1e-9)
    i, j = model.bones.T
    true = np.linalg.norm(body[0, :, i] - body[0, :, j], axis=1)
    usual = Lengths(true, np.eye(4) / 0.03**2)
    short = body[:1].copy()
    short[..., 4] = 0.6 * short[..., 4] + 0.4 * short[..., 1]
    off = {}
    for frames, known in itertools.product((20, 200), (usual, None)):
        visible = images(np.repeat(short, frames, axis=0), depth=0.2, sure=0.2)
        weighed = replace(model, usual=known or weigh_lengths(usual, frames))
        found = smooth(visible, weighed, 0.1, max_rounds=50).lengths
        off[frames, known is None] = np.log(
            (found / true)[:3].mean() * true[3] / found[3]
        )
    assert off[200, True] < 0.7 * off[200, False]
    assert off[200, True] == pytest.approx(off[20, True], rel=0.1)


@pytest.mark.parametrize("frames", [1, 20, 400])
def test_images_and_known_lengths_are_weighed_by_their_variances(rng, frames):
    """Of lengths l that t images give with variance P (1 / t + r^2), and usual ones
    with Q^-1.
    """
    P, Q = (np.cov(rng.standard_normal((4, 20))) for _ in range(2))
    measured, usual = rng.standard_normal((2, 4))
    exact = np.linalg.inv(P * (1 / frames + CONSTANTS.shared**2))
    expected = np.linalg.solve(exact + Q, exact @ measured + Q @ usual)

    taken_for = frames * np.linalg.inv(P)
    weighed = weigh_lengths(Lengths(usual, Q), frames).precision
    found = np.linalg.solve(taken_for + weighed, taken_for @ measured + weighed @ usual)
    np.testing.assert_allclose(found, expected)


def with_gaps(model, frames):
    """The model of frames of which some are missing, after the fourth for a second."""
    position = np.cumsum([0.0, 1, 3, 1, 24, 2, 1, 1, 5])[:frames]
    return replace(model, timeline=Timeline(position, 24.0))


def second_difference(timeline, t):
    D = np.zeros((max(t - 2, 0), t))
    for row in range(t - 2):
        D[row, row : row + 3] = (1, -2, 1)
    if timeline is None:
        return D
    for row, place in enumerate(timeline.position[:-2]):
        h, k = np.diff(timeline.position[row : row + 3])
        together = timeline.position[row + 2] < 8 or place > 8
        slopes = np.array([1 / h, -1 / h - 1 / k, 1 / k])
        D[row, row : row + 3] = together * slopes / np.sqrt((h + k) / 2)
    return D


def test_stretches_on_both_sides_of_a_long_gap_move_by_themselves(images, body, model):
    """But have bones of one length: without bones they are those of two sequences."""
    free = replace(model, bones=BONES[:0], bone_tolerance=model.bone_tolerance[:0])
    seen = images(body, noise=0.05)
    apart = [smooth(seen.part(rows), free, 0.1) for rows in (slice(9), slice(9, None))]
    position = np.arange(len(body)) + np.where(np.arange(len(body)) < 9, 0.0, 30.0)
    gap = replace(free, timeline=Timeline(position, 24.0))
    found = smooth(seen, gap, 0.1).points
    np.testing.assert_allclose(
        found, np.concatenate([one.points for one in apart]), atol=2e-3
    )
    joined = smooth(seen, free, 0.1).points
    assert np.abs(joined[7:11] - found[7:11]).max() > 0.02


def test_motion_over_missing_frames_is_better_than_without(images, body, model):
    """And better than to take what is left for neighbours."""
    errors = {"gaps": [], "joined": [], "cut": []}
    for seed in range(8):
        rows = np.flatnonzero(np.random.default_rng(seed).random(len(body)) > 0.4)
        seen = images(body[rows], noise=0.05)
        whole = 100.0 * np.cumsum(np.diff(rows, prepend=rows[0]) > 1) + rows
        places = {"gaps": 1.0 * rows, "joined": np.arange(len(rows)), "cut": whole}
        for name, position in places.items():
            timed = replace(model, timeline=Timeline(1.0 * position, 24.0))
            found = smooth(seen, timed, 0.1).points
            errors[name].append(np.abs(found - body[rows]).mean())
    gaps, joined, cut = (np.mean(errors[name]) for name in ("gaps", "joined", "cut"))
    assert gaps < 0.98 * joined
    assert gaps < 0.95 * cut


class Objective:
    """Energy, gradient and Gauss-Newton matrix over frames y (t, 3p), and lengths l
    (e,).
    """

    def __init__(self, visible, model, noise):
        self.visible, self.model = visible, model
        self.weight = uncounted_weight(visible, noise)
        self.w = np.nan_to_num(visible.landmarks).reshape(len(visible), -1)
        D = second_difference(model.timeline, len(visible))
        self.hold, self.known = fixed_lengths(
            model, mean_lengths(visible.start, model.bones)
        )
        self.motion = np.kron(D.T @ D, np.diag(np.tile(model.stiffness, 3)))

    def energy(self, y, lengths):
        total = 0.5 * y.reshape(-1) @ self.motion @ y.reshape(-1)
        total += 0.5 * (self.weight * (y[:, : self.w.shape[1]] - self.w) ** 2).sum()
        for f, frame in enumerate(y):
            total -= np.logaddexp.reduce(self.log_terms(f, frame))
        total += 0.5 * (lengths - self.known) @ self.hold @ (lengths - self.known)
        return (
            total
            + 0.5
            * (((self.bones(y)[1] - lengths) / self.model.bone_tolerance) ** 2).sum()
        )

    def log_terms(self, f, frame):
        """Log of share times normal density of each mode, without the constant."""
        terms = []
        for share, mean, P, log_det in zip(
            self.visible.log_share[f],
            self.visible.mean[f],
            self.visible.precision[f],
            self.visible.log_det[f],
            strict=True,
        ):
            away = frame - mean
            terms.append(share - 0.5 * (away @ P @ away + log_det))
        return np.array(terms)

    def bones(self, y):
        points = y.reshape(len(y), 3, -1)
        i, j = self.model.bones.T
        along = points[:, :, i] - points[:, :, j]
        return along, np.linalg.norm(along, axis=1)

    def gradient(self, y, lengths, step=1e-6):
        """Central differences of the energy over y (t, 3p), and over the lengths."""
        at = np.concatenate([y.reshape(-1), lengths])
        found = np.empty_like(at)
        for place in range(len(at)):
            ends = []
            for sign in (1, -1):
                moved = at.copy()
                moved[place] += sign * step
                ends.append(
                    self.energy(moved[: y.size].reshape(y.shape), moved[y.size :])
                )
            found[place] = (ends[0] - ends[1]) / (2 * step)
        return found

    def hessian(self, y, lengths, step=1e-3):
        """Second differences of the energy over the frames, the lengths held."""
        n = y.size
        moves = step * np.eye(n).reshape(n, *y.shape)
        H = np.empty((n, n))
        for i in range(n):
            for j in range(i + 1):
                signs = ((1, 1), (1, -1), (-1, 1), (-1, -1))
                H[i, j] = H[j, i] = sum(
                    a * b * self.energy(y + a * moves[i] + b * moves[j], lengths)
                    for a, b in signs
                ) / (4 * step * step)
        return H

    def matrix(self, y):
        """Second derivatives over the frames, responsibilities and directions of bones
        held.
        """
        t, d = y.shape
        whole = self.motion.copy()
        i, j = self.model.bones.T
        along, size = self.bones(y)
        for f in range(t):
            terms = self.log_terms(f, y[f])
            shares = np.exp(terms - np.logaddexp.reduce(terms))
            block = np.einsum("k,kab->ab", shares, self.visible.precision[f])
            block[: self.w.shape[1], : self.w.shape[1]] += np.diag(self.weight[f])
            for b in range(len(i)):
                row = np.zeros((3, d // 3))
                row[:, i[b]] = along[f, :, b] / size[f, b]
                row[:, j[b]] = -row[:, i[b]]
                block += np.outer(row, row) / self.model.bone_tolerance[b] ** 2
            whole[f * d : (f + 1) * d, f * d : (f + 1) * d] += block
        return whole
