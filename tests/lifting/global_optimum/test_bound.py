"""Cells hold all rotations; the inequalities of a cell."""

import numpy as np
import pytest

from shapefit import core
from tests.lifting.global_optimum.conftest import TRIPLES, best_at, rotation_rows


def unit(q: np.ndarray) -> np.ndarray:
    return q / np.linalg.norm(q, axis=-1, keepdims=True)


def is_inside(q: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Whether quaternions (m, 4) or their negatives lie in the cones of cells (l, 4, 4): (m, l)."""
    mu = np.linalg.solve(corners.swapaxes(1, 2)[None], q[:, None, :, None])[..., 0]
    return (mu > 0).all(axis=2) | (mu < 0).all(axis=2)


def aligned(corners: np.ndarray) -> np.ndarray:
    """Cells (l, 4, 4) with the signs of the hemisphere about the first corner."""
    sign = np.sign(np.einsum("le,lae->la", corners[:, 0], corners))
    return corners * sign[..., None]


@pytest.fixture
def roots() -> tuple[np.ndarray, np.ndarray]:
    vertices, cells = np.zeros((60, 4)), np.zeros((300, 4), np.int64)
    core.root_cells(vertices=vertices, cells=cells)
    return vertices, cells


def test_the_cells_of_the_600_cell_hold_every_rotation_once(roots, rng):
    vertices, cells = roots
    np.testing.assert_allclose(np.linalg.norm(vertices, axis=1), 1)
    corners = aligned(vertices[cells])
    inner = np.einsum("lae,lbe->lab", corners, corners)
    edges = inner[:, ~np.eye(4, dtype=bool)]
    np.testing.assert_allclose(edges, np.cos(np.deg2rad(36)))  # 72 degrees of rotation
    inside = is_inside(unit(rng.standard_normal((2000, 4))), corners)
    np.testing.assert_array_equal(inside.sum(axis=1), 1)


@pytest.mark.parametrize("weighted", [False, True])
def test_the_inequalities_of_a_cell_are_those_of_the_cubic_form(make_scene, weighted, rng):
    """All 20 coefficients, from multipliers that scipy finds, by blossoming the form in NumPy."""
    scene = make_scene(n=1, noise=0.2, weighted=weighted, hidden=0.2 if weighted else 0.0)
    problem = scene.problem(0.3)
    omega = problem.weights[0]
    lam = float(problem.lam[0])
    centre = unit(rng.standard_normal(4))
    corners = unit(centre + 0.1 * rng.standard_normal((4, 4)))
    corners[2] *= -1  # signs do not matter
    found = [best_at(problem, 0, rotation_rows(q)) for q in corners]
    cut = 0.8 * min(value for value, _ in found)
    direction = omega / np.linalg.norm(omega)
    w = problem.landmarks[0] * omega
    w = w - (w @ direction)[:, None] * direction
    scaled = []
    for _, Y in found:
        along, square = (Y * w).sum(), (Y**2).sum()
        s = (along - np.sqrt(along**2 - 2 * square * cut)) / square
        assert 0 < s < 1
        scaled.append(s * Y)
    q = aligned(corners[None])[0]
    G = np.einsum("vap,p,kbp->vkab", scaled, omega, problem.atoms)

    def form(mu: np.ndarray) -> np.ndarray:
        """<Y(mu), Q(q, q) B_i> - lambda |q|^2, largest over the atoms excluded: (k,)."""
        point = mu @ q
        length = np.linalg.norm(point)
        rows = rotation_rows(point / length) * length**2
        return np.einsum("v,vkab,ab->k", mu, G, rows) - lam * length**2 * mu.sum()

    def blossom(a: int, b: int, c: int) -> np.ndarray:
        """Polarise the cubic form: its Bernstein coefficients are the values of the blossom."""
        e = np.eye(4)
        total = form(e[a] + e[b] + e[c])
        total = total - form(e[a] + e[b]) - form(e[a] + e[c]) - form(e[b] + e[c])
        return (total + form(e[a]) + form(e[b]) + form(e[c])) / 6

    excess = np.zeros(20)
    dropped = core.judge_cell(**problem.arrays, corners=corners, cut=cut, excess=excess)
    wanted = [3 * blossom(*triple).max() for triple in TRIPLES]
    np.testing.assert_allclose(excess, wanted, atol=1e-7)
    assert dropped == (max(excess) <= 0)
    # the same inequalities bound the form between the corners
    for mu in rng.dirichlet(np.ones(4), 200):
        assert form(mu).max() <= max(wanted) / 3 + 1e-9
