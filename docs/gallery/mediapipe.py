"""Landmarks of MediaPipe in memory, lifted, and the path of an ankle in metres as a
table.

Run it in the clone: python docs/gallery/mediapipe.py FOLDER
"""

import sys
from pathlib import Path

import numpy as np

import shapefit

out = Path(sys.argv[1] if len(sys.argv) > 1 else "results/gallery/mediapipe")
out.mkdir(parents=True, exist_ok=True)

# `results.pose_landmarks` of MediaPipe has 33 landmarks with x, y and visibility, as
# shares of the image. Those of the sample walk are put in their places here; what
# OpenPose lacks stays hidden.
NAMES = {
    "Nose": 0,
    "LShoulder": 11,
    "RShoulder": 12,
    "LElbow": 13,
    "RElbow": 14,
    "LWrist": 15,
    "RWrist": 16,
    "LHip": 23,
    "RHip": 24,
    "LKnee": 25,
    "RKnee": 26,
    "LAnkle": 27,
    "RAnkle": 28,
    "LHeel": 29,
    "RHeel": 30,
    "LBigToe": 31,
    "RBigToe": 32,
}
width, height = 1280, 720
walk = shapefit.read_landmarks(
    "sample_data/openpose", keypoints="body_25", track="nearest"
)
points = np.asarray(walk.landmarks)[:36]  # the frames of the first person
frames = np.full((len(points), 33, 3), np.nan)
for name, place in NAMES.items():
    frames[:, place, :2] = points[:, walk.landmark_names.index(name)] / [width, height]
frames[:, :, 2] = np.where(np.isnan(frames[:, :, 0]), 0, 0.9)  # visibility

# From here on it is what you would write: shares become pixels, the third number is a
# confidence.
frames[:, :, :2] *= [width, height]
fit = shapefit.fit(
    frames,
    "people",
    keypoints="mediapipe_33",
    frame_rate=25,
    image_size=(width, height),
)
print(fit)

ankle = fit.metres[fit.metres.landmark == "lankle"]
columns = np.column_stack([ankle.time, ankle.x, ankle.y, ankle.z, ankle.sd])
np.savetxt(
    out / "left_ankle.csv", columns, "%.4f", ",", header="time,x,y,z,sd", comments=""
)
shapefit.write_results(out / "walk.h5", fit)  # for `shapefit view`
