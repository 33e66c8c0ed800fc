"""What a user's script may hold, right and wrong, for a type checker.

tests/api/test_arguments.py checks it: each `# wrong` is an error of its line, and
nothing else is.
"""

from typing import reveal_type

import numpy as np

import shapefit

keypoints = np.zeros((3, 17, 2))
good = shapefit.fit(
    keypoints,
    keypoints="coco_17",
    camera={"focal": 1100, "principal_point": (640, 360)},
    prior={"scale": 2.0},
    frame_rate=25,
)
shapefit.fit(keypoints, "people", keypoints="coco_17", frame_rte=25)  # wrong
shapefit.fit(keypoints, "people", heigth=1.8)  # wrong
shapefit.fit(keypoints, method="convx")  # wrong
shapefit.fit(keypoints, camera={"focl": 1100})  # wrong
shapefit.fit(keypoints, prior={"scale": "much"})  # wrong
shapefit.fit(keypoints, frame_rate="25")  # wrong
print(good.shape_sdd)  # wrong
print(shapefit.lift)  # wrong

dictionary = shapefit.learn(keypoints, k=3, prior={"components": "auto"})
shapefit.learn(keypoints, beat=0.1)  # wrong
shapefit.learn(keypoints, method="exemplar")  # wrong
names: list[str] = list(dictionary.landmark_names)
mean: float = dictionary.mean_shape.mean()

errors = shapefit.evaluate(good, keypoints, metrics=["similarity"])
shapefit.evaluate(good, keypoints, metrics=["simlarity"])  # wrong
shapefit.evaluate(good, keypoints, mach="frame")  # wrong

shapefit.read_landmarks("openpose", keypoints="body_25", track="nearest")
shapefit.read_landmarks("openpose", keypoint="body_25")  # wrong
shapefit.read_landmarks("openpose", track="near")  # wrong

optimum = shapefit.solve(keypoints, keypoints, 0.1, loss="l1")
shapefit.solve(keypoints, keypoints, 0.1, loss="l2")  # wrong
shapefit.solve(keypoints, keypoints, 0.1, weigths=None)  # wrong

page: str = good.view("walk.html").html

reveal_type(good.shapes)
reveal_type(good[0].shapes)
reveal_type(good.shape_sd)
reveal_type(errors.mean("similarity"))
