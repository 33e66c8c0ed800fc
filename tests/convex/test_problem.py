"""What a problem accepts, refuses and fills in."""

from typing import Any

import numpy as np
import pytest

from shapefit.convex.problem import Loss, Problem, build_problem


def arrays(**changed: Any) -> dict[str, Any]:
    rng = np.random.default_rng(0)
    return {
        "landmarks": rng.standard_normal((3, 2, 5)),
        "weights": np.ones((3, 5)),
        "atoms": rng.standard_normal((4, 3, 5)),
        "lam": np.ones(3),
    } | changed


WRONG_ARRAYS = [
    ({"landmarks": np.ones((3, 3, 5))}, "must be"),
    ({"atoms": np.ones((4, 3, 6))}, "must be"),
    ({"atoms": np.ones((0, 3, 5))}, "must be"),
    ({"atoms": np.full((4, 3, 5), np.nan)}, "atoms must be finite"),
    ({"weights": np.ones((3, 4))}, "weights"),
    ({"weights": -np.ones((3, 5))}, "weights must be finite and >= 0"),
    ({"lam": np.ones(2)}, "lam"),
    ({"lam": np.zeros(3)}, "lam must be finite and > 0"),
    ({"beta": 0.0}, "beta"),
]
"""One wrong array, and what the error says of it."""


def test_arrays_that_fit_make_a_problem() -> None:
    Problem(**arrays())


@pytest.mark.parametrize(("changed", "message"), WRONG_ARRAYS)
def test_one_wrong_array_is_refused(changed: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Problem(**arrays(**changed))


@pytest.fixture
def one_is_nan() -> dict[str, Any]:
    """Arrays of which landmark 2 of image 1 is nan."""
    usual = arrays()
    usual["landmarks"][1, 0, 2] = np.nan
    return usual


def test_landmarks_that_are_nan_are_hidden(one_is_nan) -> None:
    problem = build_problem(one_is_nan["landmarks"], one_is_nan["atoms"], 0.1)

    assert problem.weights[1, 2] == 0
    assert problem.weights.sum() == 14
    assert np.isfinite(problem.landmarks).all()


def test_a_weight_of_a_landmark_that_is_nan_is_refused(one_is_nan) -> None:
    with pytest.raises(ValueError, match="positive weight"):
        build_problem(
            one_is_nan["landmarks"],
            one_is_nan["atoms"],
            0.1,
            weights=one_is_nan["weights"],
        )


def test_weights_of_the_exact_loss_say_only_what_is_seen() -> None:
    usual = arrays(weights=np.array([[0, 1e-9, 0.5, 1, 7.0]] * 3))

    problem = build_problem(**usual, loss=Loss.EXACT)

    assert problem.weights.tolist() == [[0, 1, 1, 1, 1]] * 3
