"""Coding and learning: certificates, planted optima and atoms, a falling objective, PCA
bases.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.arrays import Floats
from shapefit.dictionary.coding import flatten_shapes, objectives, sparse_code
from shapefit.dictionary.learning import (
    learn_atoms,
    principal_components,
    replace_dead_atoms,
    scale_of_atoms,
    update_atoms,
)
from shapefit.geometry.normalisation import normalise
from tests.points import centred, flatten, mix, norms, resized, unit_norm, with_noise


def duality_gaps(
    shapes: Floats, atoms: Floats, beta: float, coefficients: Floats
) -> Floats:
    """objective - D(t R) >= objective - optimum for each shape; (n,), for beta > 0.

    The dual is max D(Y) = <Y, S> - 1/2 ||Y||^2 subject to <B_i, Y> <= beta. Y = t R
    with the residual R and the best t >= 0 that is feasible.
    """
    S = flatten_shapes(shapes)
    B = flatten_shapes(atoms)
    R = S - coefficients @ B
    correlation = (R * S).sum(axis=1)
    energy = (R**2).sum(axis=1)
    highest = (R @ B.T).max(axis=1)

    nothing = np.zeros_like(energy)
    unlimited = np.full_like(energy, np.inf)
    best = np.divide(correlation, energy, out=nothing, where=energy > 0)
    feasible = np.divide(beta, highest, out=unlimited, where=highest > 0)
    t = np.clip(best, 0.0, feasible)
    dual = t * correlation - 0.5 * t**2 * energy
    return objectives(shapes, atoms, beta, coefficients) - dual


PRICE = 0.3
"""Of coefficients, beta."""


@pytest.fixture
def atoms(rng):
    return rng.standard_normal((12, 3, 6))


@pytest.fixture
def coded(rng, atoms):
    """Noisy mixtures of some of the atoms."""
    size = rng.random((40, 12))
    used = rng.random((40, 12)) < 0.4
    mixed = mix(size * used, atoms)
    return with_noise(mixed, 0.3, rng)


class TestOptimality:
    """KKT: the slope is 0 where a coefficient is used, and >= 0 elsewhere."""

    def test_kkt_certificate(self, coded, atoms):
        C = sparse_code(coded, atoms, PRICE)

        residual = C @ flatten_shapes(atoms) - flatten_shapes(coded)
        slope = residual @ flatten_shapes(atoms).T + PRICE
        assert (C >= 0).all()
        assert (slope >= -1e-11).all()
        assert_allclose(slope[C > 0], 0, atol=1e-11)

    def test_every_shape_uses_some_atoms_but_not_all(self, coded, atoms):
        C = sparse_code(coded, atoms, PRICE)
        assert (C > 0).any(axis=1).all()
        assert (C == 0).any(axis=1).all()


def near_copies(few, rng):
    return np.concatenate([few, with_noise(few, 1e-6, rng)])


HOSTILE_ATOMS = {
    "copies": lambda few, rng: np.concatenate([few, few]),
    "scaled copies": lambda few, rng: np.concatenate([few, 1.3 * few, 0.2 * few]),
    "near copies": near_copies,
    "overcomplete": lambda few, rng: rng.standard_normal((100, 3, 4)),
    "positive overcomplete": lambda few, rng: np.abs(rng.standard_normal((100, 3, 4))),
    "one plane": lambda few, rng: mix(rng.standard_normal((20, 2)), few[:2]),
    "with zeros": lambda few, rng: np.concatenate([few, np.zeros((2, 3, 4))]),
}
"""Atoms that depend on each other, exactly and nearly; more atoms than dimensions.

Each is made of a few random atoms.
"""


@pytest.mark.parametrize("beta", [1.0, 0.1, 1e-3])
@pytest.mark.parametrize("name", HOSTILE_ATOMS)
def test_certificate_with_hostile_atoms(rng, name, beta):
    coded = rng.standard_normal((50, 3, 4))
    few = rng.standard_normal((8, 3, 4))
    atoms = HOSTILE_ATOMS[name](few, rng)

    C = sparse_code(coded, atoms, beta)

    gaps = duality_gaps(coded, atoms, beta, C)
    energy = 0.5 * norms(coded) ** 2
    assert (C >= 0).all()
    assert (gaps <= 1e-7 * energy).all()
    for used in C > 0:
        rank = np.linalg.matrix_rank(flatten_shapes(atoms)[used])
        assert rank == used.sum()  # atoms in use are independent


@pytest.mark.parametrize("size", [0.01, 1.0, 100.0])
def test_the_tolerance_is_a_share_of_the_shape(coded, atoms, size):
    """No single coefficient, set to its best, would move the shape by more than the
    tolerance.
    """
    resized = size * atoms
    price = size * PRICE

    C = sparse_code(coded, resized, price, tolerance=0.1)

    B = flatten_shapes(resized)
    slope = (C @ B - flatten_shapes(coded)) @ B.T + price
    squares = (B**2).sum(axis=1)
    best = np.maximum(C - slope / squares, 0)
    moves = np.abs(best - C) * np.sqrt(squares)
    shares = moves.max(axis=1) / norms(coded)
    assert (shares <= 0.1).all()
    assert shares.max() > 0.01


BETA = 0.1


def last(rounds):
    *_, state = rounds
    return state


def relative_error(shapes, state):
    """Return ||S - C B|| / ||S|| of all shapes together."""
    missed = shapes - mix(state.coefficients, state.atoms)
    return np.linalg.norm(missed) / np.linalg.norm(shapes)


def evenly_spaced(count, among):
    """Return the places of the shapes from which learning starts."""
    return np.linspace(0, among - 1, count).round().astype(int)


@pytest.fixture
def shapes(rng):
    """Noisy mixtures of five forms, centred, of the size of normalised shapes."""
    forms = rng.standard_normal((5, 3, 6))
    mixed = mix(rng.random((80, 5)) ** 3, forms)
    return normalise(with_noise(mixed, 0.1, rng)).points


class TestDescent:
    ATOMS_AND_PRICES = ((1, 0.1), (8, 0.01), (8, 1.0), (30, 0.1), (80, 0.1))

    @pytest.mark.parametrize(("k", "beta"), ATOMS_AND_PRICES)
    def test_no_half_step_raises_the_objective(self, shapes, k, beta):
        state = last(learn_atoms(shapes, k, beta, iterations=30))
        rounding = 1e-13 * state.trace[0]
        assert (np.diff(state.trace) <= rounding).all()

    def test_coefficients_are_optimal_for_the_atoms(self, shapes):
        state = last(learn_atoms(shapes, 8, BETA, iterations=5))
        gaps = duality_gaps(shapes, state.atoms, BETA, state.coefficients)
        assert (gaps <= 1e-9).all()


class TestPlanted:
    """Shapes of two of six atoms each. Evenly spaced pure ones start learning near
    each atom.
    """

    @pytest.fixture
    def planted_atoms(self, rng):
        return unit_norm(centred(rng.standard_normal((6, 3, 8))))

    @pytest.fixture
    def planted_coefficients(self, rng):
        C = np.zeros((600, 6))
        for row in C:
            pair = rng.choice(6, 2, replace=False)
            row[pair] = rng.uniform(2, 6, 2)
        for atom, shape in enumerate(evenly_spaced(6, among=600)):
            C[shape] = 0.3
            C[shape, atom] = 5
        return C

    def test_finds_the_atoms_that_made_the_shapes(
        self, planted_atoms, planted_coefficients
    ):
        shapes = mix(planted_coefficients, planted_atoms)

        state = last(learn_atoms(shapes, 6, 1e-3, iterations=300))

        cosines = (state.atoms * planted_atoms).sum(axis=(1, 2))
        assert_allclose(cosines, 1, atol=1e-4)
        assert_allclose(state.coefficients, planted_coefficients, atol=0.05)
        assert relative_error(shapes, state) < 1e-3


class TestDeadAtoms:
    @pytest.fixture
    def one_dead_atom(self, shapes):
        """Three atoms and coefficients, of which no shape uses the second."""
        atoms = unit_norm(shapes[:3])
        C = np.zeros((80, 3))
        C[:, [0, 2]] = sparse_code(shapes, atoms[[0, 2]], BETA)
        return atoms, C

    def test_the_worst_shape_takes_the_place(self, shapes, one_dead_atom):
        atoms, C = one_dead_atom

        replaced = replace_dead_atoms(shapes, C, atoms)

        residual = norms(shapes - mix(C, atoms))
        worst = shapes[residual.argmax()]
        assert_allclose(replaced[1], worst / norms(worst))
        assert_array_equal(replaced[[0, 2]], atoms[[0, 2]])

    def test_the_objective_does_not_feel_it(self, shapes, one_dead_atom):
        atoms, C = one_dead_atom
        replaced = replace_dead_atoms(shapes, C, atoms)
        before = objectives(shapes, atoms, BETA, C)
        assert_array_equal(objectives(shapes, replaced, BETA, C), before)

    def test_one_round_brings_them_to_life(self, shapes):
        """All 8 shapes that learning starts from are the same one."""
        shapes[evenly_spaced(8, among=80)] = shapes[0]
        start = np.repeat(unit_norm(shapes[:1]), 8, axis=0)
        used_at_start = sparse_code(shapes, start, BETA).any(axis=0)
        assert used_at_start.sum() == 1

        state = next(learn_atoms(shapes, 8, BETA, iterations=1))

        assert state.coefficients.any(axis=0).all()
        assert (np.diff(state.trace) < 0).all()


LIMIT = 3.3
"""Between the norms of the best free atoms."""


class TestUpdateOfAtoms:
    """Atoms of least residual within a ball of radius LIMIT."""

    @pytest.fixture
    def coefficients(self, rng):
        size = rng.random((30, 5))
        used = rng.random((30, 5)) < 0.6
        return size * used

    @pytest.fixture
    def mixtures(self, rng, coefficients):
        mixed = mix(coefficients, rng.standard_normal((5, 3, 4)))
        return with_noise(mixed, 0.1, rng)

    @pytest.fixture
    def start(self, rng):
        return unit_norm(rng.standard_normal((5, 3, 4)))

    def test_there_are_five_sweeps_by_default(self, mixtures, coefficients, start):
        usual = update_atoms(mixtures, coefficients, start, LIMIT)
        five = update_atoms(mixtures, coefficients, start, LIMIT, sweeps=5)
        assert_array_equal(usual, five)

    def test_certificate(self, mixtures, coefficients, start):
        """KKT: the slope at B_i is -u_i B_i with u_i >= 0, and u_i = 0 inside the
        ball.
        """
        atoms = update_atoms(mixtures, coefficients, start, LIMIT, sweeps=2000)

        size = norms(atoms)
        inside = size < LIMIT * (1 - 1e-9)
        residual = mixtures - mix(coefficients, atoms)
        slope = -np.tensordot(coefficients, residual, axes=(0, 0))
        u = -(slope * atoms).sum(axis=(1, 2)) / size**2
        assert inside.any()
        assert (~inside).any()
        assert (size <= LIMIT * (1 + 1e-12)).all()
        assert (u > -1e-9).all()
        assert_allclose(u[inside], 0, atol=1e-8)
        assert_allclose(slope, resized(atoms, -u), atol=1e-8)


def test_sizes_of_atoms_are_those_of_the_shapes_that_use_them():
    """The deviation of each atom is 1/3; the second is used twice by the first shape,
    four times by the other; nobody uses the third.
    """
    atoms = np.zeros((3, 3, 2))
    for number in range(3):
        atoms[number, number] = [1, -1]
    coefficients = np.array([[1.0, 2, 0], [0, 4, 0]])
    sizes_of_shapes = np.array([1.0, 3])

    found = scale_of_atoms(atoms, coefficients, sizes_of_shapes)

    assert_allclose(found, [3, 3 * (2 + 12) / 6, 6])


def orthonormal_columns(matrix):
    return np.linalg.qr(matrix)[0]


class TestPrincipalComponents:
    @pytest.fixture
    def planted(self, rng):
        """Shapes of three components, whose energies are as 25, 4 and 1."""
        components = orthonormal_columns(rng.standard_normal((18, 3))).T
        ones = np.ones(30)
        columns = np.column_stack([ones, rng.standard_normal((30, 3))])
        of_mean_0 = orthonormal_columns(columns)[:, 1:]
        deviations = (of_mean_0 * [5, 2, 1]) @ components
        return rng.standard_normal((3, 6)) + deviations.reshape(30, 3, 6)

    @pytest.mark.parametrize(
        ("share", "count"),
        [(0.5, 1), (0.83, 1), (0.84, 2), (0.96, 2), (0.97, 3), (0.999, 3)],
    )
    def test_as_many_as_the_energy_needs_and_no_more(self, planted, share, count):
        """The first holds 0.833 of the energy, the first two 0.967."""
        assert len(principal_components(planted, share)) == count

    @pytest.mark.parametrize("count", [1, 4, 9])
    def test_they_are_orthonormal(self, shapes, count):
        components = flatten(principal_components(shapes, count))
        assert_allclose(components @ components.T, np.eye(count), atol=1e-12)

    @pytest.mark.parametrize("count", [1, 4, 9])
    def test_they_leave_the_least_residual(self, shapes, count):
        """Certificate (Eckart and Young): the residual is the sum of the other squared
        values.
        """
        components = flatten(principal_components(shapes, count))

        deviations = flatten(shapes - shapes.mean(axis=0))
        projected = deviations @ components.T @ components
        residual = np.linalg.norm(deviations - projected) ** 2
        singular_values = np.linalg.svd(deviations, compute_uv=False)
        least = (singular_values[count:] ** 2).sum()
        assert residual == pytest.approx(least, rel=1e-12)

    @pytest.mark.parametrize("bases", [1 - 1e-15, 99])
    def test_never_more_than_the_rank(self, shapes, bases):
        five = shapes[:5]
        assert len(principal_components(five, bases)) == 4

    @pytest.fixture
    def rounded(self, shapes, rng):
        """One shape again and again, as single precision rounds it."""
        still = np.repeat(10 * shapes[:1], 40, axis=0)
        rounding = np.finfo(np.float32).eps * rng.uniform(-0.5, 0.5, still.shape)
        return still * (1 + rounding)

    def test_rounding_of_single_precision_is_no_motion(self, rounded):
        assert len(principal_components(rounded)) == 0

    def test_a_motion_of_more_than_the_rounding_is_one(self, rounded, shapes):
        swing = np.sin(np.arange(40))
        moving = rounded + 1e-4 * resized(shapes[1], swing)
        assert len(principal_components(moving)) == 1
