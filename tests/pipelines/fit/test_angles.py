"""Knee and elbow angles of a man on a beam against those of four cameras together."""

import csv
from pathlib import Path

import h5py
import numpy as np
import pytest

from shapefit.config import load_config
from shapefit.geometry.joint_angles import known_angles, measure_angles
from shapefit.io.skeletons import joint_columns
from shapefit.pipelines.fit.run import run

HINGES = tuple(f"{joint}_{side}" for joint in ("knee_angle", "elbow_flex") for side in "rl")
QUANTILE = 1.645
"""Of the normal distribution: 90% lie within so many deviations."""


@pytest.mark.slow
@pytest.mark.real_data
def test_hinges_of_a_man_on_a_beam(real_data, tmp_path):
    errors, deviations = [], []
    for camera in ("cam01", "cam03"):
        landmarks = real_data / f"detected/pose2sim_balancing/{camera}.h5"
        output = tmp_path / f"{camera}.angles.csv"
        arguments = {"landmarks": [str(landmarks)], "dictionary": "people", "output": str(output)}
        rate = ["frame_rate=60"]
        list(run(load_config("fit", Path("sequences"), rate, arguments)))
        with output.open() as file:
            rows = list(csv.DictReader(file))
        with h5py.File(landmarks) as file:
            joints = joint_columns(file["landmark_names"].asstr()[()])
            shapes = file["true_shapes"][()].swapaxes(1, 2)
        truth = dict(
            zip(
                (angle.name for angle in known_angles(joints)),
                measure_angles(shapes, np.array([0.0, -1.0, 0.0]), joints)[0].T,
                strict=True,
            )
        )
        for name in HINGES:
            errors.append(np.array([float(row[name]) for row in rows]) - truth[name])
            deviations.append(np.array([float(row[f"{name}_sd"]) for row in rows]))
    distance = np.abs(errors)
    assert distance.mean() == pytest.approx(13.6, rel=0.02)
    assert (distance <= QUANTILE * np.array(deviations)).mean() == pytest.approx(0.936, abs=0.02)
