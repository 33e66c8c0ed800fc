"""Dictionaries from files of other tools: one command, and warnings of what they lack."""

import numpy as np
import pytest

from shapefit.config import LearnDictConfig
from shapefit.errors import InputError
from shapefit.io import read_dictionary
from shapefit.pipelines.learn_dict.run import run
from tests.pipelines.told import texts


def learn(path, output, **settings):
    config = LearnDictConfig.model_validate({"shapes": [path], "output": output, **settings})
    warnings = texts(run(config))
    return read_dictionary(output), warnings


def trc(path, points):
    """Write points (n, p, 3), NaN where missing, as TRC in millimetres."""
    n, p, _ = points.shape
    names = "".join(f"\tm{j}\t\t" for j in range(p))
    axes = "".join(f"\tX{j}\tY{j}\tZ{j}" for j in range(1, p + 1))
    rows = (
        f"{i}\t{i / 50}\t" + "\t".join("" if np.isnan(v) else f"{v:.6f}" for v in row.ravel())
        for i, row in enumerate(1000 * points)
    )
    head = f"PathFileType\t4\t(X/Y/Z)\tx.trc\nDataRate\tUnits\tNumFrames\n50\tmm\t{n}\n"
    path.write_text(f"{head}Frame#\tTime{names}\n\t{axes}\n" + "\n".join(rows) + "\n")
    return path


def test_gaps_are_left_out_with_warnings(tmp_path, rng):
    points = rng.normal(size=(40, 6, 3))
    points[:10, 5] = np.nan
    points[3, 2] = np.nan
    dictionary, warnings = learn(
        trc(tmp_path / "walk.trc", points), tmp_path / "d.h5", k=8, iterations=2
    )
    assert dictionary.landmark_names == ("m0", "m1", "m2", "m3", "m4")
    assert dictionary.unit == "m"
    assert any("1 landmark left out" in text and "m5" in text for text in warnings)
    assert any("1 shape left out" in text for text in warnings)


def test_files_without_a_landmark_that_is_mostly_known(tmp_path, rng):
    points = rng.normal(size=(10, 4, 3))
    points[:5, :2], points[5:, 2:] = np.nan, np.nan
    with pytest.raises(InputError, match=r"no landmark is known in 90% of its 10 shapes"):
        learn(trc(tmp_path / "walk.trc", points), tmp_path / "d.h5")
    with pytest.raises(InputError, match="0 shapes to learn from"):
        learn(trc(tmp_path / "walk.trc", points[:0]), tmp_path / "d.h5")
