"""What learns a dictionary from shapes given, through files."""

import pytest

from shapefit.config import LearnDictConfig
from shapefit.io import read_dictionary, write_shapes
from shapefit.pipelines.learn_dict import run as learn_dict


@pytest.fixture
def make(tmp_path):
    """Return what learns from shapes with keys of `learn-dict`: the dictionary, the outcomes."""

    def run(shapes, **keys):
        path = tmp_path / "shapes.h5"
        write_shapes(path, shapes)
        config = LearnDictConfig(shapes=str(path), output=str(tmp_path / "dict.h5"), **keys)
        outcomes = list(learn_dict.run(config))
        return read_dictionary(config.output), outcomes

    return run
