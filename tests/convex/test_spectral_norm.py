"""Norms of 2x3 blocks against an SVD."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from shapefit.convex.transforms import nuclear_norm

KINDS = ["any", "equal", "nearly equal", "rank one", "nearly rank one", "zero"]


def make_block(kind: str, seed: int, exponent: float) -> np.ndarray:
    rng = np.random.default_rng(seed)
    if kind == "any":
        return 10**exponent * rng.standard_normal((2, 3))
    second = {"equal": 1.0, "nearly equal": 1 - 1e-9, "rank one": 0.0, "nearly rank one": 1e-9}
    U, V = (np.linalg.qr(rng.standard_normal((m, m)))[0] for m in (2, 3))
    values = 0.0 if kind == "zero" else np.diag([1.0, second[kind]])
    return 10**exponent * (U @ (values * np.eye(2)) @ V[:2])


blocks = st.builds(
    make_block,
    st.sampled_from(KINDS),
    st.integers(0, 2**32 - 1),
    st.floats(-60, 60),
)


@given(blocks)
def test_the_norm_is_the_sum_of_singular_values(Q: np.ndarray) -> None:
    s = np.linalg.svd(Q, compute_uv=False)
    np.testing.assert_allclose(nuclear_norm(Q), s.sum(), rtol=1e-14)
