"""RANSAC over triples: closed-form poses, planted outliers, and what must not change the labels."""

import h5py
import numpy as np
import pytest

from shapefit import core
from shapefit.convex.problem import build_problem
from shapefit.geometry.normalisation import normalise
from shapefit.geometry.rotations import random_rotations
from shapefit.lifting.outliers.ransac import find_consensus
from shapefit.lifting.shared_rotation.pose import find_pose, spread_views

P, N, THRESHOLD = 30, 70, 0.1


@pytest.fixture
def shape(rng):
    return normalise(rng.standard_normal((3, P))).points


@pytest.fixture
def posed(shape, rng):
    """Landmarks of the shape at N random poses."""
    size, T = rng.uniform(5, 200, N), 300 * rng.standard_normal((N, 2))
    return size[:, None, None] * (random_rotations(N, rng)[:, :2] @ shape) + T[..., None]


def plant(landmarks, share, rng):
    """Replace a share by points of the bounding box that lie outside every tolerance."""
    wrong = rng.random((len(landmarks), landmarks.shape[2])).argsort(1) < round(share * P)
    low, high = (f(landmarks, axis=2, keepdims=True) for f in (np.min, np.max))
    points = rng.uniform(low, high, landmarks.shape)
    unit = np.abs(high - low).max(axis=1, keepdims=True)
    near = np.linalg.norm(points - landmarks, axis=1, keepdims=True) < 0.2 * unit
    points = np.where(near, landmarks + 0.3 * unit, points)
    return np.where(wrong[:, None], points, landmarks), wrong


def search(landmarks, shape, weights=None, **settings):
    n, _, p = landmarks.shape
    weights = np.ones((n, p)) if weights is None else weights
    seeds = settings.pop("seeds", np.arange(n).astype(np.uint64))
    settings = {"threshold": THRESHOLD, "draws": 500, "max_rounds": 100} | settings
    return find_consensus(landmarks, weights, shape, seeds, **settings)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.5])
def test_planted_outliers_are_found_exactly(posed, shape, share, rng):
    landmarks, wrong = plant(posed, share, rng)
    np.testing.assert_array_equal(search(landmarks, shape), ~wrong)


def test_a_triple_gives_the_pose_and_its_reflection_in_depth(shape, rng):
    for R in random_rotations(50, rng):
        size, T = rng.uniform(0.1, 9), rng.standard_normal((2, 1))
        w = size * R[:2] @ shape + T
        triple, found = rng.permutation(P)[:3], np.empty((2, 3, 3))
        s = core.parts.pose_triple(w, shape, triple, found)
        assert s == pytest.approx(size, rel=1e-9)
        assert np.abs(found - R).max(axis=(1, 2)).min() < 1e-7
        np.testing.assert_allclose(np.linalg.det(found), 1)
        edges = shape[:, triple[1:]] - shape[:, triple[:1]]
        seen = w[:, triple[1:]] - w[:, triple[:1]]
        for pose in found:
            np.testing.assert_allclose(pose @ pose.T, np.eye(3), atol=1e-12)
            np.testing.assert_allclose(s * pose[:2] @ edges, seen, atol=1e-7 * size)


def test_points_on_a_line_or_on_one_point_determine_no_pose(shape):
    line, triple, R = np.outer(np.ones(3), np.arange(P)), np.arange(3), np.empty((2, 3, 3))
    assert core.parts.pose_triple(shape[:2], line, triple, R) == 0
    assert core.parts.pose_triple(shape[:2], np.zeros((3, P)), triple, R) == 0
    assert core.parts.pose_triple(np.zeros((2, P)), shape, triple, R) == 0


def test_triples_are_different_and_equally_likely():
    state, triple, draws = np.array([5], np.uint64), np.zeros(3, np.int64), 60_000
    candidates = np.array([3, 4, 9, 7, 1])
    counts = {}
    for _ in range(draws):
        core.parts.draw_triple(candidates, state, triple)
        counts[tuple(triple)] = counts.get(tuple(triple), 0) + 1
    assert len(counts) == 5 * 4 * 3
    expected = draws / 60
    assert max(abs(count - expected) for count in counts.values()) < 5 * np.sqrt(expected)
    assert all(len(set(drawn)) == 3 for drawn in counts)


def test_draws_are_those_of_the_published_generator():
    """SplitMix64 in Python, so that labels with a seed stay what they were."""

    def draw(state, m):
        state = (state + 0x9E3779B97F4A7C15) % 2**64
        z = (state ^ (state >> 30)) * 0xBF58476D1CE4E5B9 % 2**64
        z = (z ^ (z >> 27)) * 0x94D049BB133111EB % 2**64
        return state, ((z ^ (z >> 31)) >> 32) * m >> 32

    expected, places, candidates = 2**64 - 3, list(range(40)), np.arange(40)
    state, triple = np.array([expected], np.uint64), np.zeros(3, np.int64)
    for _ in range(200):
        core.parts.draw_triple(candidates, state, triple)
        drawn, left = [], places.copy()
        for m in (40, 39, 38):
            expected, at = draw(expected, m)
            drawn.append(left.pop(at))
        assert triple.tolist() == drawn
    assert int(state[0]) == expected


def test_few_draws_are_as_good_as_many_where_all_landmarks_agree(posed, shape):
    for draws in (1, 2, 3, 9):
        assert search(posed, shape, draws=draws).all()


def test_the_gain_is_the_formula(shape, rng):
    R = random_rotations(1, rng)[0]
    s, T = 3.0, np.array([1.0, -2.0])
    w = s * R[:2] @ shape + T[:, None] + 0.4 * rng.standard_normal((2, P))
    h = rng.uniform(0.5, 2, P)
    h[:4] = 0.0
    visible = np.flatnonzero(h)
    area = core.parts.find_area(w, visible)
    assert area == pytest.approx(12 * np.sqrt(np.linalg.det(np.cov(w[:, visible], ddof=0))))
    inliers = np.empty(P, bool)
    share = ((w - s * R[:2] @ shape - T[:, None]) ** 2).sum(0) / (0.2 * s) ** 2
    expected = np.log(area / (np.pi * (0.2 * s) ** 2)) * ((h * np.maximum(0, 1 - share)).sum() - 3)
    for lanes in (False, True):
        gain = core.parts.judge(w, h, shape, s, R, T, 0.2, area, lanes, inliers)
        assert gain == pytest.approx(expected)
    np.testing.assert_array_equal(inliers, (share <= 1) & (h > 0))
    for lanes in (False, True):
        assert core.parts.judge(w, h, shape, s, R, T, 99.0, area, lanes, inliers) == -np.inf
    assert not inliers.any()


def test_the_inliers_are_those_of_the_pose_fitted_to_them(posed, shape, rng):
    landmarks, _ = plant(posed, 0.3, rng)
    landmarks += 0.03 * np.ptp(landmarks, axis=2, keepdims=True) * rng.standard_normal((N, 2, P))
    weights = rng.uniform(0.5, 1, (N, P))
    found = search(landmarks, shape, weights)
    problem = build_problem(landmarks, shape[None], 1.0, weights=np.where(found, weights, 0.0))
    pose = find_pose(problem, shape, spread_views(12))
    left = landmarks - pose.size[:, None, None] * pose.rotation[:, :2] @ shape
    share = np.where(found, weights**2, 0.0)
    T = (left * share[:, None]).sum(axis=2) / share.sum(axis=1)[:, None]
    residual = np.linalg.norm(left - T[..., None], axis=1) / pose.size[:, None]
    np.testing.assert_array_equal(residual <= THRESHOLD, found)
    assert 5 < found.sum(axis=1).mean() < 20  # the threshold divides the inliers


def test_what_hidden_landmarks_hold_and_the_scale_of_weights_do_not_matter(posed, shape, rng):
    landmarks, _ = plant(posed, 0.3, rng)
    landmarks += rng.standard_normal(landmarks.shape)
    weights = rng.uniform(0.3, 1, (N, P)) * (rng.random((N, P)) > 0.3)
    base = search(landmarks, shape, weights)
    assert not base[weights == 0].any()
    dirty = np.where((weights > 0)[:, None], landmarks, np.nan)
    np.testing.assert_array_equal(search(dirty, shape, weights), base)
    np.testing.assert_array_equal(search(landmarks, shape, 4 * weights), base)


def test_a_similarity_of_the_image_changes_no_label(posed, shape, rng):
    landmarks, _ = plant(posed, 0.4, rng)
    landmarks += rng.standard_normal(landmarks.shape)
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    moved = 37 * turn @ landmarks + np.array([[4000.0], [-20.0]])
    np.testing.assert_array_equal(search(moved, shape), search(landmarks, shape))


def test_labels_depend_neither_on_order_nor_on_threads_nor_on_company(posed, shape, rng):
    landmarks, _ = plant(posed, 0.7, rng)  # so hard that the draws decide
    landmarks += 0.02 * np.ptp(landmarks, axis=2).max() * rng.standard_normal(landmarks.shape)
    seeds = rng.integers(0, 2**63, N).astype(np.uint64)
    base = search(landmarks, shape, seeds=seeds, draws=50, threads=1)
    assert (search(landmarks, shape, seeds=seeds + np.uint64(1), draws=50) != base).any()
    np.testing.assert_array_equal(search(landmarks, shape, seeds=seeds, draws=50, threads=2), base)
    order = rng.permutation(N)
    np.testing.assert_array_equal(
        search(landmarks[order], shape, seeds=seeds[order], draws=50), base[order]
    )
    np.testing.assert_array_equal(
        search(landmarks[5:6], shape, seeds=seeds[5:6], draws=50), base[5:6]
    )


def test_degenerate_images(posed, shape):
    landmarks, weights = posed[:5].copy(), np.ones((5, P))
    weights[0, 3:] = 0.0  # three landmarks fit some pose
    weights[1, 2:] = 0.0
    landmarks[2] = 7.0
    landmarks[3, 1] = 2 * landmarks[3, 0]  # on a line
    weights[4] = 0.0
    found = search(landmarks, shape, weights)
    np.testing.assert_array_equal(found[0], weights[0] > 0)
    assert not found[1:].any()


def test_among_random_landmarks_few_agree(shape, rng):
    found = search(rng.uniform(0, 100, (N, 2, P)), shape)
    assert found.sum(axis=1).max() < P / 2


def test_shapes_that_do_not_fit_are_refused(shape):
    with pytest.raises(ValueError, match=r"must be \(n, 2, p\)"):
        search(np.zeros((2, 2, P + 1)), shape)


@pytest.mark.real_data
def test_half_of_the_landmarks_of_real_cars(real_data, rng):
    with h5py.File(real_data / "cars/models.h5") as file:
        models = normalise(np.swapaxes(file["shapes"][:], 1, 2).astype(float)).points
    with h5py.File(real_data / "cars/annotated_cars.h5") as file:
        landmarks = np.swapaxes(file["landmarks"][:], 1, 2).astype(float)
    visible = np.isfinite(landmarks).all(axis=1)
    enough = np.flatnonzero(visible.sum(axis=1) >= 20)[:200]
    landmarks, visible = landmarks[enough], visible[enough]
    wrong = visible & (rng.random(visible.shape) < 0.5)
    low, high = np.nanmin(landmarks, axis=2), np.nanmax(landmarks, axis=2)
    points = rng.uniform(low[..., None], high[..., None], landmarks.shape)
    inliers = search(
        np.where(wrong[:, None], points, landmarks),
        normalise(models.mean(axis=0)).points,
        visible.astype(float),
        threshold=0.25,
    )
    labelled = visible & ~inliers
    assert (labelled & wrong).sum() > 0.93 * labelled.sum()
    assert (labelled & wrong).sum() > 0.93 * wrong.sum()


def test_hidden_landmarks_are_as_good_as_none(shape, rng):
    """Their weights have no part in the mean that the others are measured by."""
    landmarks = rng.uniform(0, 100, (N, 2, P))  # so that poses of few inliers compete
    seen = np.arange(P) % 2 == 0
    found = search(landmarks, shape, np.tile(seen.astype(float), (N, 1)), threshold=0.3)
    np.testing.assert_array_equal(
        found[:, seen], search(landmarks[..., seen], shape[:, seen], threshold=0.3)
    )
    assert not found[:, ~seen].any()


def test_moments_are_weighted_and_know_the_inliers_only(shape, rng):
    w, h, inliers = rng.standard_normal((2, P)), rng.uniform(0.1, 3, P), rng.random(P) < 0.6
    P_found, D, middle, origin = np.empty((3, 3)), np.empty((2, 3)), np.empty(3), np.empty(2)
    core.parts.find_moments(w, h, shape, inliers, P_found, D, middle, origin)
    share, S, W = h[inliers], shape[:, inliers], w[:, inliers]
    np.testing.assert_allclose(middle, np.average(S, axis=1, weights=share))
    np.testing.assert_allclose(origin, np.average(W, axis=1, weights=share))
    S, W = S - middle[:, None], W - origin[:, None]
    np.testing.assert_allclose(P_found, (share * S) @ S.T)
    np.testing.assert_allclose(D, (share * W) @ S.T)


def test_the_search_stops_by_the_share_of_inliers(posed, shape, rng):
    """More draws than anyone waits for, where the inliers of the first ones decide."""
    landmarks, wrong = plant(posed, 0.5, rng)
    np.testing.assert_array_equal(search(landmarks, shape, draws=10**12), ~wrong)


def test_the_better_of_the_drawn_and_the_fitted_poses_counts(posed, shape, rng):
    """The search again in Python: one round of fitting, after which the lower gain is forgotten."""
    landmarks, _ = plant(posed, 0.6, rng)
    landmarks += 0.08 * np.ptp(landmarks, axis=2, keepdims=True) * rng.standard_normal((N, 2, P))
    some, draws, threshold, fell = 10, 2, 0.4, 0
    landmarks, shape = np.tile(landmarks[..., :some], (4, 1, 1)), shape[:, :some].copy()
    found = search(landmarks, shape, draws=draws, max_rounds=1, threshold=threshold)
    for image, w in enumerate(landmarks):
        area, ones = core.parts.find_area(w, np.arange(some)), np.ones(some)

        def judge(size, R, T, w=w, area=area, ones=ones):
            inside = np.empty(some, bool)
            gain = core.parts.judge(w, ones, shape, size, R, T, threshold, area, False, inside)
            return gain, inside

        state, triple = np.array([image], np.uint64), np.zeros(3, np.int64)
        drawn, best, labels = -np.inf, -np.inf, np.zeros(some, bool)
        for _ in range(draws):
            core.parts.draw_triple(np.arange(some), state, triple)
            poses = np.empty((2, 3, 3))
            size = core.parts.pose_triple(w, shape, triple, poses)
            for R in poses:
                T = w[:, triple[0]] - size * R[:2] @ shape[:, triple[0]]
                gain, inside = judge(size, R, T)
                if gain <= drawn:
                    continue
                drawn = gain
                if gain > best:
                    best, labels = gain, inside
                if inside.sum() > 3:
                    gain, inside = judge(*fitted(w, shape, inside, R))
                    fell += gain < drawn == best
                    if gain > best:
                        best, labels = gain, inside
        np.testing.assert_array_equal(found[image], labels, err_msg=f"image {image}")
    assert fell > 3


def fitted(w, shape, inside, start):
    """Return size, rotation and translation of the pose of the shape nearest to these landmarks."""
    from scipy.optimize import least_squares
    from scipy.spatial.transform import Rotation

    w, S = w[:, inside], shape[:, inside]
    middle, origin = S.mean(axis=1), w.mean(axis=1)

    def left(x):
        M = np.exp(x[3]) * (Rotation.from_rotvec(x[:3]).as_matrix() @ start)[:2]
        return (M @ (S - middle[:, None]) - (w - origin[:, None])).ravel()

    size = np.linalg.norm(w - origin[:, None]) / np.linalg.norm(S - middle[:, None])
    x = least_squares(left, [0, 0, 0, np.log(size)], xtol=1e-12, ftol=1e-14, gtol=1e-14).x
    R, size = Rotation.from_rotvec(x[:3]).as_matrix() @ start, np.exp(x[3])
    return size, R, origin - size * R[:2] @ middle
