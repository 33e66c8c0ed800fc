"""Own animals: the first half of a recording trains, from a file as its tool writes it.

The last 40% of its images are lifted and scored, as in benchmarks/detected.py.
"""

import numpy as np
import pytest

from shapefit.config import FitConfig, LearnDictConfig
from shapefit.evaluation.metrics import similarity, truth_scale
from shapefit.io import read_results, read_shapes
from shapefit.pipelines.fit.run import run as run_fit
from shapefit.pipelines.learn_dict.run import run as run_learn_dict
from tests.io.files import load, save

pytestmark = pytest.mark.real_data


def deeplabcut_3d(path, names, points):
    """Write points (n, p, 3) as DeepLabCut's CSV of triangulated points."""
    heads = [["scorer"], ["bodyparts"], ["coords"]]
    for name in names:
        for axis in "xyz":
            for head, cell in zip(heads, ("DLC_3D", name, axis), strict=True):
                head.append(cell)
    rows = [
        [str(i), *("" if np.isnan(v) else repr(float(v)) for v in row.ravel())]
        for i, row in enumerate(points)
    ]
    path.write_text("\n".join(",".join(row) for row in heads + rows) + "\n")
    return path


def anipose(path, names, points):
    """Write points (n, p, 3) as anipose's CSV."""
    kinds = ("x", "y", "z", "error", "ncams", "score")
    head = [f"{name}_{kind}" for name in names for kind in kinds] + ["fnum"]
    rows = [
        [*(repr(float(v)) for point in row for v in (*point, 0.5, 3, 1)), str(i)]
        for i, row in enumerate(points)
    ]
    path.write_text("\n".join(",".join(row) for row in [head, *rows]) + "\n")
    return path


@pytest.mark.parametrize(
    ("name", "truth", "write", "bound"),
    [
        ("dlc_reaching/camera1", "dlc_reaching/camera1_truth", deeplabcut_3d, 0.065),
        ("fly/Cam-A", "fly/Cam-A_truth", anipose, 0.18),
        ("fly/Cam-C", "fly/Cam-C_truth", anipose, 0.215),
    ],
)
def test_half_of_a_recording_lifts_the_rest(tmp_path, real_data, name, truth, write, bound):
    folder = real_data / "detected"
    known = read_shapes([folder / f"{truth}.h5"], gaps=True)
    images = load(folder / f"{name}.h5")
    n = len(known)
    points = known.shapes[: n // 2].swapaxes(1, 2)
    file = write(tmp_path / "training.csv", known.landmark_names, points)
    learn = LearnDictConfig.model_validate(
        {"shapes": [file], "output": tmp_path / "dictionary.h5", "k": 32}
    )
    for _ in run_learn_dict(learn):
        pass
    last = np.arange(n - round(0.4 * n), n)
    save(tmp_path / "landmarks.h5", images.take(last))
    fit = FitConfig.model_validate(
        {
            "landmarks": [tmp_path / "landmarks.h5"],
            "dictionary": tmp_path / "dictionary.h5",
            "output": tmp_path / "result.h5",
        }
    )
    for _ in run_fit(fit):
        pass
    result = read_results(tmp_path / "result.h5")
    columns = [known.landmark_names.index(name) for name in result.landmark_names]
    target = known.shapes[last][:, :, columns]
    errors = similarity(result.shapes, target) / truth_scale(result.shapes, target)
    assert np.nanmean(errors) < bound
    assert np.isfinite(errors).mean() > 0.9
