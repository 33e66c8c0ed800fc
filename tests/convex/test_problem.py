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


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"landmarks": np.ones((3, 3, 5))}, "must be"),
        ({"atoms": np.ones((4, 3, 6))}, "must be"),
        ({"atoms": np.ones((0, 3, 5))}, "must be"),
        ({"atoms": np.full((4, 3, 5), np.nan)}, "atoms must be finite"),
        ({"weights": np.ones((3, 4))}, "weights"),
        ({"weights": -np.ones((3, 5))}, "weights must be finite and >= 0"),
        ({"lam": np.ones(2)}, "lam"),
        ({"lam": np.zeros(3)}, "lam must be finite and > 0"),
        ({"beta": 0.0}, "beta"),
    ],
)
def test_one_wrong_array_at_a_time(changed: dict[str, Any], message: str) -> None:
    Problem(**arrays())
    with pytest.raises(ValueError, match=message):
        Problem(**arrays(**changed))


def test_landmarks_that_are_nan_are_hidden() -> None:
    given = arrays()
    given["landmarks"][1, 0, 2] = np.nan
    problem = build_problem(given["landmarks"], given["atoms"], 0.1)
    assert problem.weights.sum() == 14
    assert problem.weights[1, 2] == 0
    assert np.isfinite(problem.landmarks).all()
    with pytest.raises(ValueError, match="positive weight"):
        build_problem(given["landmarks"], given["atoms"], 0.1, weights=np.ones((3, 5)))


def test_weights_of_the_exact_loss_say_only_what_is_seen() -> None:
    given = arrays(weights=np.array([[0, 1e-9, 0.5, 1, 7.0]] * 3))
    found = build_problem(
        given["landmarks"],
        given["atoms"],
        1.0,
        weights=given["weights"],
        loss=Loss.EXACT,
    )
    assert found.weights.tolist() == [[0, 1, 1, 1, 1]] * 3
