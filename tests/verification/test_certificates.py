"""Norms in closed form beside LAPACK's, missed claims, a program whose optimum is
known, and by how much its numbers may be off.
"""

import numpy as np
import pytest
from scipy.special import huber

from shapefit.verification.certificate import (
    CertifiedProgram,
    Claims,
    ProgramImages,
    check_certificate,
    check_dual,
    check_gap,
    check_ranges,
    normalise_images,
    nuclear_norms,
    objective,
)
from tests.points import centred

NAN = np.nan


def orthonormal_rows(blocks, rng):
    """Return the blocks with rows of norm 1 that are orthogonal."""
    U, _, Vt = np.linalg.svd(blocks, full_matrices=False)
    return U @ Vt


def nearly_parallel_rows(blocks, rng):
    flat = blocks.copy()
    flat[:, 1] = 2 * flat[:, 0] + 1e-9 * flat[:, 1]
    return flat


def one_row(blocks, rng):
    line = blocks.copy()
    line[:, 1] = 0
    return line


@pytest.mark.parametrize(
    "change",
    [
        lambda blocks, rng: blocks,
        orthonormal_rows,
        nearly_parallel_rows,
        one_row,
        lambda blocks, rng: 0 * blocks,
    ],
    ids=["random", "orthonormal", "nearly parallel", "one row", "zero"],
)
def test_norms_are_sums_of_singular_values(rng, change):
    blocks = change(rng.standard_normal((64, 2, 3)), rng)
    singular_values = np.linalg.svd(blocks, compute_uv=False)
    first_row = blocks[:, 0, :, None]
    second_row = blocks[:, 1, :, None]

    found = nuclear_norms(first_row, second_row)[:, 0]

    expected = singular_values.sum(axis=1)
    assert found == pytest.approx(expected, rel=1e-14, abs=1e-28)


class TestClaims:
    """Of four images, of which the last claims nothing."""

    @pytest.fixture
    def claims(self):
        return Claims(np.array([True, True, True, False]))

    @pytest.fixture
    def far(self, claims):
        """Claims that differences are below 2."""
        off = np.array([[1.0, 3.0], [1.0, 2.0], [NAN, 0.0], [9.0, 9.0]])
        claims.near("c", off, 2.0)
        return claims

    def test_the_worst_of_an_image_counts_and_nan_misses(self, far):
        assert far.missed.tolist() == [True, False, True, False]

    def test_images_that_miss_have_a_reason(self, far):
        assert [*far.reasons] == [0, 2]

    def test_a_claim_may_be_of_other_images(self, far):
        last = np.array([False, False, False, True])
        far.near("d", np.zeros((4, 2)), np.full(4, NAN), where=last)
        assert far.missed[3]

    def test_of_no_values_none_misses(self, claims):
        claims.near("c", np.zeros((4, 0)), 1.0)
        assert not claims.missed.any()

    def test_of_no_images_none_misses(self):
        claims = Claims(np.zeros(0, dtype=bool))
        claims.near("c", np.zeros((0, 3)), 1.0)
        assert claims.missed.tolist() == []


B = np.array([[[1.0, -1, 0, 0], [0, 0, 1, -1], [0.5, 0.5, -0.5, -0.5]]])
"""One atom (1, 3, 4)."""

LAMBDA = 0.1
HALF = 0.5


def mean_std(landmarks):
    """Return the size by which landmarks (2, p) are normalised."""
    return landmarks.std(axis=1).mean()


@pytest.fixture
def planted():
    """One atom, seen from the front at half its size: M = c Rbar, Y = Omega o (V - M
    B).

    V = B_xy / (2 s), with its standard deviation at 1, so that M B = a V with the
    largest a for which Y stays feasible: the nuclear norm of (1 - a) V B^T is lambda.
    """
    front = B[0, :2]
    landmarks = 100 * HALF * front
    V = front / mean_std(front)
    singular_values = np.linalg.svd(V @ B[0].T, compute_uv=False)
    a = 1 - LAMBDA / singular_values.sum()
    M = a * np.eye(2, 3) / mean_std(front)
    Y = (1 - a) * V
    c = M[0, 0]
    objective = 0.5 * (Y**2).sum() + LAMBDA * c
    size = mean_std(landmarks)
    return {
        "landmarks": landmarks[None],
        "lambda": np.array([LAMBDA]),
        "dual": Y[None],
        "convex_translation": np.zeros((1, 2)),
        "transform_count": np.array([1]),
        "transform_atom": np.array([0]),
        "active_transforms": M[None],
        "objective": np.array([objective]),
        "relative_gap": np.zeros(1),
        "coefficients": np.array([[c]]),
        "scale": np.array([size]),
        "translation": np.zeros((1, 2)),
        "shapes": size * c * B,
        "status": np.array(["optimal"]),
        "rotation": np.eye(3)[None],
    }


def make_program(loss="squared"):
    return CertifiedProgram(B, None, False, True, False, loss, 0.1, 1e-6)


def first_false_claim(columns):
    """Return the first claim of an image that is false, or nothing."""
    claims = Claims(np.ones(1, dtype=bool))
    with np.errstate(all="ignore"):
        is_certified = check_certificate(columns, make_program(), claims)
        check_ranges(columns, claims)
    assert is_certified.tolist() == [True]
    return claims.reasons.get(0, "")


def test_a_known_optimum_is_certified(planted):
    assert first_false_claim(planted) == ""


FALSE_CLAIMS = [
    ("dual", lambda Y: (1 + 1e-8) * Y, "feasible"),
    ("dual", lambda Y: Y + 1e-3, "balanced"),
    ("objective", lambda P: 0.999 * P, "objective"),
    ("active_transforms", lambda M: 0.99 * M, "objective"),
    ("relative_gap", lambda gap: gap - 1e-3, "relative_gap"),
    ("shapes", lambda S: 1.001 * S, "shapes"),
    ("coefficients", lambda c: 1.001 * c, "coefficients"),
    ("scale", lambda scale: 1.001 * scale, "scale"),
    ("translation", lambda x: x + 1, "translation"),
    ("rotation", lambda R: 2 * R, "orthonormal"),
    ("rotation", lambda R: 0.5 * R, "orthonormal"),
    ("rotation", np.negative, "proper"),
    ("lambda", np.negative, "objective"),
    ("status", lambda _: np.array(["degenerate input"]), "status"),
]
"""A column, how it is changed, and a word of the claim that is false then."""


@pytest.mark.parametrize(("name", "change", "word"), FALSE_CLAIMS)
def test_nothing_else_is_certified(planted, name, change, word):
    changed = planted | {name: change(planted[name])}
    assert word in first_false_claim(changed)


def test_half_a_shape_is_no_shape(planted):
    half = planted["shapes"].copy()
    half[0, 0, 0] = NAN
    failed = {"shapes": half, "status": np.array(["degenerate input"])}
    claims = Claims(np.zeros(1, dtype=bool))

    check_ranges(planted | failed, claims)

    assert "whole or absent" in claims.reasons[0]


@pytest.mark.parametrize(("loss", "bound"), [("sparse-error", 0.1), ("l1", 1.0)])
class TestRobustLoss:
    """The dual of a robust loss is bounded: with a lambda so large that nothing else
    limits it.
    """

    def check(self, planted, loss, largest):
        """Check the dual whose largest entry is so large."""
        program = make_program(loss)
        images = normalise_images(planted | {"lambda": np.array([100.0])}, program)
        Y = planted["dual"] * largest / np.abs(planted["dual"]).max()
        claims = Claims(np.ones(1, dtype=bool))
        check_dual(images, Y, program, claims, np.ones(1, dtype=bool))
        return claims

    def test_a_dual_within_the_bound_is_feasible(self, planted, loss, bound):
        claims = self.check(planted, loss, bound * (1 - 1e-6))
        assert claims.missed.tolist() == [False]

    def test_a_dual_beyond_it_is_not(self, planted, loss, bound):
        claims = self.check(planted, loss, bound * (1 + 1e-6))
        assert claims.missed.tolist() == [True]
        assert "within the bound of the loss" in claims.reasons[0]


def shifted(values, amount):
    """Return values of which the first is more by an amount."""
    changed = values.copy()
    changed.flat[0] += amount
    return changed


def objective_without_shape(planted):
    """Return 1/2 ||V||^2."""
    landmarks = planted["landmarks"][0]
    V = landmarks / mean_std(landmarks)
    return (V**2).sum() / 2


def allowed_of_objective(planted):
    return planted["objective"][0] + objective_without_shape(planted)


def allowed_of_gap(planted):
    return 1 + allowed_of_objective(planted) / planted["objective"][0]


def allowed_of_shapes(planted):
    """Return the size of the landmarks and the largest number of the shape."""
    return planted["scale"][0] + np.abs(planted["shapes"]).max()


SIZES = [
    ("objective", "objective", allowed_of_objective),
    ("relative_gap", "relative_gap", allowed_of_gap),
    ("coefficients", "coefficients", lambda planted: 1 + planted["coefficients"][0, 0]),
    ("scale", "scale", lambda planted: planted["scale"][0]),
    ("translation", "translation", lambda planted: planted["scale"][0]),
    ("shapes", "shapes", allowed_of_shapes),
]
"""A column, a word of its claim, and the size of which a number may be off by a share.
"""

SHARE = 1e-9
"""By which a number of size 1 may be off."""


@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize(("name", "word", "size"), SIZES)
class TestNumbersThatAreOff:
    """Of one column, from what is computed again."""

    def test_by_less_than_is_allowed_they_are_certified(
        self, planted, name, word, size, sign
    ):
        amount = sign * 0.99 * SHARE * size(planted)
        changed = planted | {name: shifted(planted[name], amount)}
        assert first_false_claim(changed) == ""

    def test_by_more_they_are_not(self, planted, name, word, size, sign):
        amount = sign * 1.01 * SHARE * size(planted)
        changed = planted | {name: shifted(planted[name], amount)}
        assert word in first_false_claim(changed)


class TestFarFromTheOrigin:
    """Sums of large numbers are rounded, and may be off by 64 halves of a last digit.

    Places are whole numbers, and so exact.
    """

    PLACE = 50 * 2.0**24

    @pytest.fixture
    def far(self, planted):
        shapes = planted["shapes"].copy()
        shapes[:, :2] += self.PLACE
        return planted | {
            "landmarks": planted["landmarks"] + self.PLACE,
            "translation": planted["translation"] + self.PLACE,
            "shapes": shapes,
        }

    @pytest.mark.parametrize("name", ["shapes", "translation"])
    def test_by_less_they_are_certified(self, far, name):
        amount = 60 * 2.0**-53 * self.PLACE
        changed = far | {name: shifted(far[name], amount)}
        assert first_false_claim(changed) == ""

    @pytest.mark.parametrize("name", ["shapes", "translation"])
    def test_by_more_they_are_not(self, far, name):
        amount = 80 * 2.0**-53 * self.PLACE
        changed = far | {name: shifted(far[name], amount)}
        assert name in first_false_claim(changed)


def dual_scaled(planted, share):
    return planted | {"dual": (1 + share) * planted["dual"]}


def dual_unbalanced(planted, share):
    """Return a dual point whose first row has a sum of a share of its magnitudes."""
    Y = planted["dual"].copy()
    Y[0, 0] += share * np.abs(Y[0, 0]).sum() / Y.shape[2]
    return planted | {"dual": Y}


def rotation_scaled(planted, share):
    """Return rotations whose products with themselves differ from 1 by ten shares."""
    return planted | {"rotation": np.sqrt(1 + 10 * share) * planted["rotation"]}


CONSTRAINTS = [
    (dual_scaled, "feasible"),
    (dual_unbalanced, "balanced"),
    (rotation_scaled, "orthonormal"),
]
"""What breaks a constraint by a share, and a word of its claim."""


@pytest.mark.parametrize(("broken", "word"), CONSTRAINTS)
class TestConstraints:
    """They hold up to rounding."""

    def test_broken_by_less_they_hold(self, planted, broken, word):
        assert first_false_claim(broken(planted, 0.9 * SHARE)) == ""

    def test_broken_by_more_they_do_not(self, planted, broken, word):
        assert word in first_false_claim(broken(planted, 1.1 * SHARE))


TOLERANCE = 1e-6
"""Of the relative gap of an optimal image."""


class TestOptimalImages:
    """Their gap is within the tolerance, up to rounding."""

    def with_gap(self, planted, gap):
        """Shrink the dual point until the relative gap is as large, and state that.

        D = s <Y, V> - s^2 / 2 ||Y||^2 for s Y; at s = 1 there is no gap.
        """
        Y = planted["dual"]
        P = planted["objective"]
        square = (Y**2).sum()
        along = P + square / 2
        s = (along - np.sqrt(along**2 - 2 * square * (1 - gap) * P)) / square
        return planted | {"dual": s * Y, "relative_gap": np.full(1, gap)}

    def test_a_gap_within_it_is_optimal(self, planted):
        assert first_false_claim(self.with_gap(planted, TOLERANCE + 0.9 * SHARE)) == ""

    def test_a_gap_beyond_it_is_not(self, planted):
        found = first_false_claim(self.with_gap(planted, TOLERANCE + 1.1 * SHARE))
        assert "optimal" in found

    def test_a_gap_beyond_it_is_true_of_an_image_that_stopped_before(self, planted):
        stopped = self.with_gap(planted, TOLERANCE + 1.1 * SHARE)
        stopped["status"] = np.array(["iteration limit"])
        assert first_false_claim(stopped) == ""

    def test_a_dual_point_of_zeros_proves_nothing(self, planted):
        changed = planted | {"dual": 0 * planted["dual"]}
        assert "relative_gap" in first_false_claim(changed)


@pytest.mark.parametrize(("share", "is_false"), [(0.99, False), (1.01, True)])
def test_without_an_objective_and_a_bound_the_gap_is_0(share, is_false):
    """And may be off by a share of 1."""
    claims = Claims(np.ones(1, dtype=bool))
    nothing = np.zeros(1)
    stated = (nothing, np.full(1, share * SHARE))

    with np.errstate(all="ignore"):
        check_gap((nothing, nothing), nothing, stated, "", claims, claims.fitted)

    assert claims.missed.tolist() == [is_false]


K = 2
"""Atoms of a program with more landmarks than the atoms have numbers."""

P = 8


class TestDualPoints:
    """Y of one image is feasible for each atom: ||(Y o Omega) B_i^T||_* <= lambda."""

    @pytest.fixture
    def program(self, rng):
        atoms = centred(rng.standard_normal((K, 3, P)))
        return make_program()._replace(atoms=atoms, atom_items=("a", "b"))

    @pytest.fixture
    def unseen(self, program, rng):
        """A balanced dual point (1, 2, P) that the atoms do not see, and large."""
        rows = np.concatenate([program.atoms.reshape(3 * K, P), np.ones((1, P))])
        (null,) = np.linalg.svd(rows)[2][3 * K + 1 :]
        directions = np.array([[1e7], [2e7]])
        return (directions * null)[None]

    @pytest.fixture
    def seen(self, program, rng):
        """A balanced dual point (1, 2, P) of whose norms the largest is lambda."""
        Y = centred(rng.standard_normal((1, 2, P)))
        return LAMBDA * Y / self.norms(program, Y).max()

    def norms(self, program, Y):
        """Return the nuclear norm of Y B_i^T for each atom."""
        products = np.einsum("ap,kbp->kab", Y[0], program.atoms)
        return np.linalg.svd(products, compute_uv=False).sum(axis=1)

    def first_false_claim(self, program, Y, rng, retained=None):
        images = ProgramImages(
            points=rng.standard_normal((1, 2, P)),
            weights=np.ones((1, P)),
            centroid=np.zeros((1, 2)),
            size=np.ones(1),
            lam=np.full(1, LAMBDA),
            retained=retained,
        )
        claims = Claims(np.ones(1, dtype=bool))
        check_dual(images, Y, program, claims, claims.fitted)
        return claims.reasons.get(0, "")

    @pytest.mark.parametrize(("share", "word"), [(0.9, ""), (1.1, "feasible")])
    def test_sums_of_large_terms_may_be_off_by_their_rounding(
        self, program, seen, unseen, rng, share, word
    ):
        """By 64 halves of a last digit of the magnitudes of terms, over lambda."""
        farthest = np.linalg.norm(program.atoms, axis=1).max()
        terms = np.linalg.norm(unseen[0], axis=0).sum() * farthest / LAMBDA
        allowed = SHARE + 64 * 2.0**-53 * terms
        assert allowed > 10 * SHARE

        found = self.first_false_claim(
            program, (1 + share * allowed) * seen + unseen, rng
        )

        assert (word in found) if word else not found

    @pytest.mark.parametrize(("share", "word"), [(0.9, ""), (1.1, "balanced")])
    def test_sums_are_small_beside_the_larger_row(
        self, program, seen, rng, share, word
    ):
        Y = 0.5 * seen
        Y[0, 1] *= 0.1
        largest = np.abs(Y).sum(axis=2).max()
        Y[0, 1] += share * SHARE * largest / P

        found = self.first_false_claim(program, Y, rng)

        assert (word in found) if word else not found

    def test_an_atom_that_is_left_out_bounds_nothing(self, program, seen, rng):
        norms = self.norms(program, seen)
        between = seen * LAMBDA / np.sqrt(norms.prod())
        retained = (norms < norms.max())[None]
        assert "feasible" in self.first_false_claim(program, between, rng)
        assert self.first_false_claim(program, between, rng, retained) == ""


class TestWeights:
    """Of the landmarks of an image in the program."""

    LANDMARKS = np.array([[[0.0, 1.0, 2.0, NAN], [5.0, 3.0, 4.0, 1.0]]])

    def weights(self, hides_outliers=False, **columns):
        program = make_program()._replace(hides_outliers=hides_outliers)
        common = {"landmarks": self.LANDMARKS, "lambda": np.ones(1)}
        return normalise_images(common | columns, program).weights.tolist()

    def test_without_confidences_they_are_1_where_a_landmark_is_seen(self):
        assert self.weights() == [[1, 1, 1, 0]]

    def test_they_are_the_confidences_where_a_landmark_is_seen(self):
        confidence = np.array([[0.25, 0.5, 2.0, 4.0]])
        assert self.weights(confidence=confidence) == [[0.25, 0.5, 2, 0]]

    @pytest.mark.parametrize(("hides", "expected"), [(True, 0), (False, 1)])
    def test_of_outliers_they_are_0_where_the_fit_hides_them(self, hides, expected):
        outliers = np.array([[False, True, False, False]])
        assert self.weights(hides, outliers=outliers) == [[1, expected, 1, 0]]


def squared_loss(r):
    return r**2 / 2


LOSSES = {
    "squared": squared_loss,
    "sparse-error": lambda r: huber(0.1, r),
    "l1": np.abs,
}
"""What a residual costs, by the data term; the threshold of `make_program` is 0.1."""


@pytest.mark.parametrize("loss", LOSSES)
class TestObjective:
    """f(Omega o (V - X - T 1^T)) + lambda c, and the size of its terms."""

    LAM = 0.3
    NORMS = 1.7

    @pytest.fixture
    def V(self, rng):
        return rng.standard_normal((1, 2, P))

    @pytest.fixture
    def weights(self, rng):
        weights = rng.uniform(0.1, 2, (1, P))
        weights[0, 0] = 0.0
        return weights

    @pytest.fixture
    def found(self, loss, V, weights):
        """The objective of the shape V / 2, moved by (0.1, -0.2), and its size."""
        images = ProgramImages(
            points=V,
            weights=weights,
            centroid=np.zeros((1, 2)),
            size=np.ones(1),
            lam=np.full(1, self.LAM),
            retained=None,
        )
        T = np.array([[0.1, -0.2]])
        return objective(
            images, V / 2, T, np.full(1, self.NORMS), make_program(loss=loss)
        )

    def test_it_is_the_loss_of_residuals_and_the_price_of_norms(
        self, found, loss, V, weights
    ):
        residual = weights * (V[0] / 2 - [[0.1], [-0.2]])
        expected = LOSSES[loss](residual).sum() + self.LAM * self.NORMS
        assert found[0] == pytest.approx([expected], rel=1e-12)

    def test_its_terms_are_it_and_the_objective_without_a_shape(
        self, found, loss, V, weights
    ):
        P, size = found
        without_shape = LOSSES[loss](weights * V[0]).sum()
        assert size == pytest.approx(P + without_shape, rel=1e-12)


def test_transforms_that_are_not_finite_are_none(planted):
    infinite = np.full_like(planted["active_transforms"], np.inf)
    changed = planted | {"active_transforms": infinite}
    assert "transforms are finite" in first_false_claim(changed)
