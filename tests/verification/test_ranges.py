"""Numbers of a result at the ends of their ranges, rotations, and shapes."""

import numpy as np
import pytest

from shapefit.verification.certificate import Claims, check_ranges

NAN = np.nan


def false_claims(**columns):
    """Return the first false claim of each of two images that have one."""
    common = {
        "shapes": np.ones((2, 3, 4)),
        "status": np.full(2, "optimal"),
        "rotation": np.tile(np.eye(3), (2, 1, 1)),
    }
    claims = Claims(np.ones(2, dtype=bool))
    with np.errstate(all="ignore"):
        check_ranges(common | columns, claims)
    return claims.reasons


OUTSIDE = [
    ("scale", 0.0),
    ("lambda", -1.0),
    ("metres_per_unit", 0.0),
    ("residual", -1e-300),
    ("expected_error", np.inf),
    ("p_value", 1 + 1e-15),
    ("inlier_probability", -1e-15),
    ("shape_correlation", np.float32(1 + 2.0**-22)),
    ("shape_correlation", np.float32(-1 - 2.0**-22)),
    ("log_evidence", -np.inf),
]
"""A column, and a number that it cannot have."""

INSIDE = [
    ("residual", 0.0),
    ("metres_per_unit", 1e-300),
    ("expected_error", NAN),
    ("p_value", 0.0),
    ("p_value", 1.0),
    ("inlier_probability", NAN),
    ("shape_correlation", np.float32(1 + 2.0**-23)),
    ("shape_correlation", np.float32(-1 - 2.0**-23)),
    ("log_evidence", -1e300),
]
"""A column, and a number that it may have: the last that there is, or none."""


class TestRanges:
    """Of the numbers of a column; single precision rounds correlations beyond 1."""

    @pytest.mark.parametrize(("name", "value"), OUTSIDE)
    def test_a_number_outside_is_false(self, name, value):
        values = np.ones((2, 4), np.asarray(value).dtype)
        values[1, 2] = value
        reasons = false_claims(**{name: values})
        assert [*reasons] == [1]
        assert f"{name} is in its range" in reasons[1]

    @pytest.mark.parametrize(("name", "value"), INSIDE)
    def test_a_number_at_its_end_is_true(self, name, value):
        values = np.full((2, 4), value)
        assert false_claims(**{name: values}) == {}


class TestRotations:
    """Of two images, each by itself."""

    def rotations(self, second):
        return np.stack([np.eye(3), np.asarray(second)])

    def test_an_image_may_have_none(self):
        assert false_claims(rotation=self.rotations(np.full((3, 3), NAN))) == {}

    @pytest.mark.parametrize("factor", [0.5, 2.0])
    def test_that_of_another_image_is_orthonormal_nevertheless(self, factor):
        nothing = np.full((3, 3), NAN)
        rotations = np.stack([nothing, factor * np.eye(3)])
        reasons = false_claims(rotation=rotations)
        assert [*reasons] == [1]
        assert "orthonormal" in reasons[1]

    def test_half_a_rotation_is_none(self):
        half = np.eye(3)
        half[0] = NAN
        assert [*false_claims(rotation=self.rotations(half))] == [1]
