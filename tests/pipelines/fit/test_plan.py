"""The plan of a fit: the options of each step, and chunks that divide no sequence."""

import time
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from shapefit.config import FitConfig
from shapefit.convex.newton import solve_newton
from shapefit.convex.problem import Loss
from shapefit.dictionary.model import Dictionary
from shapefit.io import LandmarkSet
from shapefit.lifting.lift import Program
from shapefit.lifting.methods import AlternationOptions
from shapefit.lifting.options import PerspectiveOptions
from shapefit.pipelines.fit.plan import (
    choose_options,
    choose_program,
    choose_settings,
    choose_solver,
    find_misfit,
    one_at_a_time,
)
from shapefit.pipelines.fit.read import whole_sequences
from shapefit.pipelines.overlap import side_by_side


@pytest.fixture
def config(tmp_path):
    for name in ("views.h5", "dict.h5"):
        (tmp_path / name).touch()
    paths = {"landmarks": "views.h5", "dictionary": "dict.h5", "output": "result.h5"}
    paths = {key: str(tmp_path / name) for key, name in paths.items()}
    return lambda **keys: FitConfig(**paths, threads=3, **keys)


@pytest.fixture
def dictionary(rng):
    atoms = rng.standard_normal((4, 3, 5))
    return Dictionary(atoms, tuple("abcde"), atoms[1], edges=np.array([[0, 1], [3, 4]]))


def test_settings_of_the_methods(config, dictionary):
    alternation = {"signed": True, "views": 9}
    given = config(alternation=alternation, method="convex+refine")
    found = choose_settings(given, dictionary, choose_solver(given))
    assert found.options == AlternationOptions(**alternation)
    assert found.solve.func is solve_newton
    assert (found.orthogonal, found.threads) == (False, 3)
    assert choose_settings(config(rotations="orthogonal"), dictionary, solve_newton).orthogonal
    everywhere = config(alternation={"views": "all"}, method="alternate")
    options = choose_settings(everywhere, dictionary, solve_newton).options
    assert (options.views, options.number_of_views) == ("all", 6)
    assert found.mean_shape is dictionary.mean_shape
    assert found.needs == {}
    pursuing = choose_settings(config(method="pmp"), dictionary, solve_newton)
    assert pursuing.needs["edges"] is dictionary.edges
    assert pursuing.options is None


def test_the_misfit_is_that_of_the_config_then_of_the_dictionary_then_usual(config, dictionary):
    own = replace(dictionary, misfit=np.array([3e-4]))
    assert find_misfit(config(posterior={"misfit": 0.02}), own) == 0.02
    assert find_misfit(config(), own) == 3e-4
    assert find_misfit(config(), dictionary) == 0.01


def test_options_of_the_solver(config):
    told = {"tolerance": 1e-7, "max_iterations": 23}
    newton = choose_solver(config(solver=told))
    assert (newton.func, newton.keywords) == (solve_newton, told | {"threads": 3})


def test_the_program(config):
    robust = {"method": "sparse-error", "threshold": 0.7}
    given = config(**{"lambda": "auto", "noise": 2.5, "outliers": robust})
    assert choose_program(given) == Program(None, Loss.SPARSE_ERROR, beta=0.7, noise=2.5)
    assert choose_program(config(outliers={"method": "l1"})) == Program(0.1, Loss.ABSOLUTE)
    assert choose_program(config(noise=2.5)).lam == 0.1
    assert choose_program(config(**{"lambda": 0.4})) == Program(0.4)


def test_options_of_the_perspective_camera(config):
    camera = {"model": "perspective", "focal": 500.0}
    assert choose_options(config(camera=camera)) == PerspectiveOptions(threads=3)


def images(names):
    n = len(names)
    return LandmarkSet(
        landmarks=np.arange(6.0 * n).reshape(n, 2, 3),
        landmark_names=("a", "b", "c"),
        items=tuple(f"image{i}" for i in range(n)),
        sequences=tuple(names),
    )


@pytest.mark.parametrize("size", [1, 2, 3, 5, 100])
@pytest.mark.parametrize("names", ["aaabbbbcd", "a", "aaaaaaa", "abcdefgh", "aabbcc", ""])
def test_no_run_is_divided_and_nothing_lost(names, size):
    whole = images(names)
    chunks = [whole.take(slice(at, at + size)) for at in range(0, max(len(names), 1), size)]
    parts = list(whole_sequences(chunks))
    assert [item for part in parts for item in part.items] == list(whole.items)
    np.testing.assert_array_equal(np.concatenate([p.landmarks for p in parts]), whole.landmarks)
    for before, after in pairwise(parts):
        assert before.sequences[-1] != after.sequences[0]
    assert all(len(part) < size + 8 for part in parts)


def test_ended_sequences_are_given_out_before_the_stream_ends():
    def stream():
        yield images("aab")
        yield images("bbc")
        raise AssertionError("read too far")

    assert next(whole_sequences(stream())).sequences == ("a", "a")


def test_what_has_threads_of_its_own_is_done_one_at_a_time():
    inside, most = [], []

    def work(number):
        inside.append(number)
        time.sleep(0.002)
        most.append(len(inside))
        inside.remove(number)
        return number

    assert list(side_by_side(one_at_a_time(work), range(9), 3)) == list(range(9))
    assert max(most) == 1
