"""Images with few landmarks, and what cannot be pursued at all."""

import numpy as np
import pytest

from shapefit.convex.solver import Status
from shapefit.lifting.matching_pursuit import pursue


class TestFewLandmarks:
    @pytest.mark.parametrize("visible", [3, 4])
    def test_the_camera_alone_explains_up_to_four(self, make_scene, visible):
        scene = make_scene(noise=0.3)
        scene.weights[:, visible:] = 0
        found = scene.pursue()
        np.testing.assert_allclose(found.error, 0, atol=1e-10)
        assert not found.coefficients.any()
        X = (scene.mean - scene.mean[:, :visible].mean(axis=1, keepdims=True))[:, :visible]
        W = scene.landmarks[..., :visible]
        least_norm = (W - W.mean(axis=2, keepdims=True)) @ np.linalg.pinv(X)
        np.testing.assert_allclose(found.camera, least_norm, atol=1e-9)

    def test_one_landmark_or_none_is_degenerate_by_itself(self, make_scene):
        scene = make_scene()
        expected = scene.pursue()
        scene.weights[1] = 0
        scene.weights[3, 1:] = 0
        found = scene.pursue()
        assert [found.status[i] for i in (1, 3)] == [Status.DEGENERATE] * 2
        assert np.isnan(found.camera[[1, 3]]).all()
        np.testing.assert_array_equal(found.coefficients[::2], expected.coefficients[::2])

    def test_weights_beyond_arithmetic_are_a_numerical_failure(self, make_scene):
        scene = make_scene()
        scene.weights[2] = 1e200
        found = scene.pursue()
        assert found.status[2] is Status.NUMERICAL_FAILURE
        assert np.isfinite(found.camera[[0, 1, 3, 4]]).all()


class TestRefusals:
    @pytest.mark.parametrize("edges", [None, np.empty((0, 2), np.int64)])
    def test_no_edges(self, make_scene, edges):
        scene = make_scene()
        with pytest.raises(ValueError, match="needs edges"):
            pursue(scene.problem, scene.mean, edges)

    def test_edges_without_a_length(self, make_scene):
        scene = make_scene()
        with pytest.raises(ValueError, match="length 0"):
            pursue(scene.problem, scene.mean, np.array([[1, 1]]))
