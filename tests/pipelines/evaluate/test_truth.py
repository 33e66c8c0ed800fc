"""What is unknown of the truth is counted."""

import numpy as np

from shapefit.config import EvalConfig
from shapefit.io import ShapeSet
from shapefit.pipelines.evaluate.run import open_truth
from tests.io.files import save


def test_landmarks_and_shapes_with_gaps_are_counted(tmp_path, rng):
    shapes = rng.standard_normal((4, 3, 5))
    shapes[1, :, 2] = shapes[2, :, 3] = shapes[2, 0, 4] = np.nan
    save(tmp_path / "t.csv", ShapeSet(shapes, tuple("abcde"), tuple("1234")))
    config = EvalConfig.model_construct(truth=(tmp_path / "t.csv",))
    with open_truth(config) as (_, lacks):
        assert lacks == ["the truth lacks 3 landmarks of 2 shapes (NaN): left out"]
