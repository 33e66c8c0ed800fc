"""Norms and prox of 2x3 blocks against an SVD, and against the condition of optimality."""

import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st

from shapefit.convex.transforms import nuclear_norm, spectral_norm
from tests.convex.admm import prox_spectral_norm

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


def judge_prox(Q: np.ndarray, t: float) -> np.ndarray:
    """The paper's formula: U diag(s - t proj(s / t)) V^T, proj onto the l1 ball by sorting."""
    U, s, Vt = np.linalg.svd(Q, full_matrices=False)
    x = s / t
    if x.sum() <= 1:
        return np.zeros_like(Q)
    theta = x[0] - 1 if x[0] - 1 >= x[1] else (x.sum() - 1) / 2
    return (U * (s - t * np.maximum(x - theta, 0))) @ Vt


@given(blocks)
def test_norms_are_sums_of_singular_values(Q: np.ndarray) -> None:
    s = np.linalg.svd(Q, compute_uv=False)
    np.testing.assert_allclose(spectral_norm(Q), s[0], rtol=1e-14)
    np.testing.assert_allclose(nuclear_norm(Q), s.sum(), rtol=1e-14)


@given(blocks, st.floats(1e-6, 3.0))
@example(make_block("equal", 1, 0), 1e-6)
def test_prox_agrees_with_the_formula_of_the_paper(Q: np.ndarray, share: float) -> None:
    size = np.linalg.norm(Q)
    t = share * (size or 1.0)
    np.testing.assert_allclose(prox_spectral_norm(Q, t), judge_prox(Q, t), atol=1e-14 * size)
