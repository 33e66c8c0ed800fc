"""The door of the core: what it refuses, and the stub that follows from its list of arguments."""

import numpy as np
import pytest

from shapefit import core
from shapefit.convex.transforms import Transforms
from tools.generate import stub

N, K = 3, 2


@pytest.fixture
def arguments():
    M = Transforms.of(np.ones((N, K, 2, 3)))
    return {**M.arrays, "rotation": np.zeros((N, 3, 3)), "threads": 1}


def test_the_stub_is_that_of_the_core(project):
    assert (project / "shapefit/core/_core.pyi").read_text(encoding="utf-8") == stub()


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("rotation", np.zeros((N + 1, 3, 3)), r"\(n 3 3\) with n = 3, a = 6, not float64 \(4,"),
        ("rotation", np.zeros((N, 3, 4)), "rotation must be"),
        ("rotation", np.zeros((N, 9)), "rotation must be"),
        ("rotation", np.zeros((N, 3, 3), np.float32), "not float32"),
        ("rotation", np.zeros((N, 3, 6))[..., ::2], "C-contiguous"),
        ("rotation", np.broadcast_to(0.0, (N, 3, 3)), "writable"),
        ("rotation", None, "not NoneType"),
        ("threads", "all", "threads must be an integer"),
        ("threads", 1.5, "threads must be an integer"),
        ("further", 1, "7 arguments, 6 are known"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_refused(arguments, name, value, message):
    with pytest.raises((TypeError, ValueError), match=message):
        core.synchronise(**{**arguments, name: value})
    assert not arguments["rotation"].any()


def test_what_lacks_is_named(arguments):
    del arguments["rotation"]
    with pytest.raises(TypeError, match="synchronise: no rotation"):
        core.synchronise(**arguments)


def test_what_is_only_read_may_be_of_another_layout(arguments):
    core.synchronise(**arguments)
    found = np.zeros((N, 3, 3))
    turned = arguments["blocks"].astype(np.float32).swapaxes(0, 1).copy().swapaxes(0, 1)
    core.synchronise(**{**arguments, "blocks": turned, "rotation": found})
    np.testing.assert_array_equal(found, arguments["rotation"])


def test_sizes_that_are_named_with_others_hold_too():
    """3p and 1+k: a size is that of the argument which named it first."""
    smooth = {
        "landmarks": np.zeros((4, 6)), "weight": np.zeros((4, 6)), "log_share": np.zeros((4, 1)),
        "means": np.zeros((4, 1, 10)),
    }  # fmt: skip
    with pytest.raises(ValueError, match=r"means must be .* \(t K 3p\) with t = 4, p = 3, K = 1"):
        core.smooth_sequence(**smooth)
