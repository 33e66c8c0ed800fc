"""Every kernel ends soon after a signal, on the thread that Python calls first or on
one of a pool.
"""

import signal
import threading
import time
from functools import partial
from math import ceil

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from shapefit import core, threads
from shapefit.convex.problem import Loss, build_problem
from shapefit.convex.solver import solve_newton
from shapefit.dictionary.coding import sparse_code
from shapefit.dictionary.mixture import Mixture
from shapefit.geometry.pinhole import Camera
from shapefit.geometry.rotations import random_rotations
from shapefit.lifting.consensus import find_consensus
from shapefit.lifting.global_optimum import find_optimum
from shapefit.lifting.perspective import refine_perspective
from shapefit.lifting.posterior.posterior import find_posterior
from shapefit.lifting.shared_rotation import alternate
from tests.points import draw_rotations, transpose

MOMENT = 0.2
"""CPU seconds after which the signal comes; each kernel below takes many times that."""

SOON = 0.5
"""CPU seconds from the signal to the end of the kernel."""


class Ended(BaseException):
    pass


def make_problem(rng, n, k, p, loss=Loss.SQUARED):
    atoms = rng.normal(size=(k, 3, p))
    landmarks = rng.normal(size=(n, 2, p))
    return build_problem(landmarks, atoms, 0.5, loss=loss)


def convex(rng, loss=Loss.SQUARED):
    problem = make_problem(rng, 4, 2000, 1000, loss)
    return partial(solve_newton, problem, tolerance=1e-8, threads=2)


def global_optimum(rng):
    problem = make_problem(rng, 128, 64, 15)
    return partial(find_optimum, problem, tolerance=1e-9, threads=2)


def alternation(rng):
    problem = make_problem(rng, 64, 2000, 200)
    starts = draw_rotations(64, 4, rng)
    return partial(alternate, problem, starts, tolerance=0.0, threads=2)


def posterior(rng, n=64, p=120, components=16):
    weights = np.full(components, 1 / components)
    means = rng.normal(size=(components, 3, p))
    covariances = np.tile(0.1 * np.eye(3 * p), (components, 1, 1))
    prior = Mixture(weights, means, covariances)
    starts = draw_rotations(n, 4, rng)
    landmarks = rng.normal(size=(n, 2, p))
    residual_variance = np.full((n, p), 0.02)
    noise = np.zeros((n, p, 2, 2))
    return partial(
        find_posterior, landmarks, residual_variance, noise, prior, starts, threads=2
    )


def coding(rng):
    shapes = rng.normal(size=(64, 3, 700))
    atoms = rng.normal(size=(2000, 3, 700))
    return partial(sparse_code, shapes, atoms, 0.01, threads=2)


def consensus(rng):
    seeds = np.arange(64, dtype=np.uint64)
    landmarks = rng.normal(size=(64, 2, 50))
    weights = np.ones((64, 50))
    shape = rng.normal(size=(3, 50))
    return partial(
        find_consensus,
        landmarks,
        weights,
        shape,
        seeds,
        threshold=0.01,
        draws=10_000_000,
        max_rounds=10,
        threads=2,
    )


def perspective(rng, n=2000, p=60):
    focal_length = np.full((n, 2), 2.0)
    centre = np.zeros((n, 2))
    camera = Camera(focal_length, centre, 1.0)
    atoms = rng.normal(size=(100, 3, p))
    landmarks = rng.normal(size=(n, 2, p))
    weights = np.ones((n, p))
    rotation = np.ascontiguousarray(random_rotations(n, rng))
    coefficient_prior = np.full(100, 0.01)
    return partial(
        refine_perspective,
        landmarks,
        weights,
        atoms,
        camera,
        rotation,
        coefficient_prior,
        max_rounds=10_000,
        threads=2,
    )


def sequence(rng, t=1000, p=15, components=2, bones=14):
    d = 3 * p
    start = rng.normal(size=(t, d))
    return partial(
        core.smooth_sequence,
        landmarks=start[:, : 2 * p],
        weight=np.ones((t, 2 * p)),
        log_share=np.log(np.full((t, components), 1 / components)),
        means=rng.normal(size=(t, components, d)),
        precisions=np.tile(np.eye(d), (t, components, 1, 1)),
        growth=np.ones(t),
        log_det=np.zeros((t, components)),
        stiffness=np.full(p, 3.0),
        differences=np.tile([1.0, -2.0, 1.0], (t, 1)),
        bones=np.stack([np.arange(bones), np.arange(bones) + 1], axis=1),
        rigidity=np.full(bones, 10.0),
        length_precision=np.eye(bones),
        usual_lengths=np.ones(bones),
        max_rounds=10_000,
        tolerance=0.0,
        points=start.copy(),
        lengths=np.ones(bones),
        deviation=np.empty((t, d)),
        correlation=np.empty((t, d)),
        covariance=np.empty((t, d, d)),
        energies=np.empty(t),
        end=np.empty(2),
    )


def densities(rng, n=20_000, components=400, d=90):
    return partial(
        core.find_log_densities,
        shapes=rng.normal(size=(n, d)),
        means=rng.normal(size=(components, d)),
        whiten=np.tile(np.eye(d), (components, 1, 1)),
        constants=np.zeros(components),
        log_densities=np.empty((n, components)),
        threads=2,
    )


def outer_products(rng, n=8000, d=2000):
    return partial(
        core.sum_outer_products,
        shapes=rng.normal(size=(n, d)),
        weights=np.ones(n),
        total=np.empty((d, d)),
    )


def views(rng, n, p=100, q=64):
    return {
        "residuals": rng.normal(size=(n, 2, p)),
        "precisions": np.ones((n, p)),
        "rotation": draw_rotations(n, 1, rng)[:, 0],
        "scale": np.ones(n),
        "modes": rng.normal(size=(3, p, q)),
        "translation_precision": 1e-9,
        "log_density": np.empty(n),
        "threads": 2,
    }


def view_densities(rng):
    return partial(core.find_view_densities, **views(rng, n=40_000))


def shapes_in_views(rng, n=8000, p=100):
    return partial(
        core.expect_shapes,
        **views(rng, n, p),
        mean=rng.normal(size=(3, p)),
        rest=0.1,
        shapes=np.empty((n, 3, p)),
        translation=np.empty((n, 2)),
        left=np.empty((n, 2, p)),
        uncertainty=np.empty((n, p, 2, 2)),
        gradient=np.empty((n, 4)),
        information=np.empty((n, 4, 4)),
        covariance=np.empty((ceil(n / core.IMAGES_PER_BLOCK), 3 * p, 3 * p)),
    )


def pose(rng, n=100_000):
    S = rng.normal(size=(n, 3, 6))
    w = rng.normal(size=(n, 2, 6))
    return partial(
        core.find_pose,
        shape_moments=S @ transpose(S),
        landmarks_by_shape=w @ transpose(S),
        starts=draw_rotations(n, 16, rng),
        rotation=np.empty((n, 3, 3)),
        size=np.empty(n),
        threads=2,
    )


KERNELS = {
    "convex": convex,
    "convex, robust": partial(convex, loss=Loss.SPARSE_ERROR),
    "global": global_optimum,
    "alternate": alternation,
    "posterior": posterior,
    "coding": coding,
    "consensus": consensus,
    "perspective": perspective,
    "sequence": sequence,
    "densities": densities,
    "outer products": outer_products,
    "view densities": view_densities,
    "shapes in views": shapes_in_views,
    "pose": pose,
}


@pytest.fixture
def ends_soon():
    """Run work that a signal is to end, and see that it does, soon.

    It is sent to the first thread, which `kill` and a terminal prefer too: a timer of
    the process may choose any thread that waits for something else.
    """

    def stop(_number, _frame):
        raise Ended

    def send_at(moment):
        while time.process_time() < moment:
            time.sleep(0.01)
        signal.pthread_kill(threading.main_thread().ident, signal.SIGUSR1)

    def ends_soon(work):
        begin = time.process_time()
        sender = threading.Thread(target=send_at, args=[begin + MOMENT])
        sender.start()
        with pytest.raises(Ended):
            work()
        assert time.process_time() - begin < MOMENT + SOON
        sender.join()

    before = signal.signal(signal.SIGUSR1, stop)
    yield ends_soon
    signal.signal(signal.SIGUSR1, before)


def call(kernel):
    return kernel()


@pytest.mark.parametrize("name", KERNELS)
def test_a_signal_ends_a_kernel(name, rng, ends_soon):
    kernel = KERNELS[name](rng)
    ends_soon(kernel)


@pytest.mark.parametrize("name", ["convex", "posterior", "sequence"])
def test_a_signal_ends_kernels_on_threads_of_a_pool(name, rng, ends_soon):
    kernels = [KERNELS[name](rng) for _ in range(3)]
    ends_soon(partial(threads.on_threads, call, kernels, 2))


@pytest.mark.parametrize("name", ["convex", "posterior", "sequence"])
def test_a_signal_ends_a_kernel_that_is_mapped_ahead(name, rng, ends_soon):
    kernel = KERNELS[name](rng)
    ends_soon(lambda: list(threads.map_ahead(call, [kernel], 1)))


def test_a_signal_ends_kernels_of_a_pool_within_a_pool(rng, ends_soon):
    kernels = [coding(rng), global_optimum(rng)]
    inner_pool = partial(threads.on_threads, call, kernels, 2)
    ends_soon(lambda: list(threads.map_ahead(call, [inner_pool], 1)))


def test_a_fault_beside_it_ends_a_kernel(rng):
    kernel = global_optimum(rng)

    def work(number):
        if number == 0:
            time.sleep(0.1)
            raise OSError("the disk is gone")
        return kernel()

    begin = time.process_time()
    with pytest.raises(OSError, match="disk is gone"):
        threads.on_threads(work, range(3), 2)
    assert time.process_time() - begin < SOON


def test_kernels_go_on_after_another_pool_has_ended(rng):
    problem = make_problem(rng, 4, 20, 15)
    kernel = partial(solve_newton, problem, threads=1)
    with pytest.raises(ZeroDivisionError):
        threads.on_threads(lambda number: 1 / number, [0, 1], 2)

    one, other = threads.on_threads(call, [kernel, kernel], 2)

    assert_array_equal(one.objective, other.objective)


def test_a_kernel_goes_on_after_a_handler_that_returns(rng):
    handled = []
    before = signal.signal(signal.SIGPROF, lambda *_: handled.append(1))
    try:
        signal.setitimer(signal.ITIMER_PROF, 0.05, 0.05)
        found = find_optimum(make_problem(rng, 8, 64, 15), threads=2)
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)
    assert handled
    assert np.isfinite(found.objective).all()
