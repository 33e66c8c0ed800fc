"""Arrays in, arrays out: lift landmarks, keep what can be trusted, plot a height with
its band.

Run it in the clone: python docs/gallery/python_arrays.py FOLDER
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import shapefit

out = Path(sys.argv[1] if len(sys.argv) > 1 else "results/gallery/python")
out.mkdir(parents=True, exist_ok=True)

# (n, 25, 2) keypoints in pixels, NaN where hidden, from any detector.
walk = shapefit.read_landmarks(
    "sample_data/openpose", keypoints="body_25", track="nearest"
)
keypoints = np.asarray(walk.landmarks)[:36]

fit = shapefit.fit(
    keypoints,
    "people",
    keypoints="body_25",
    frame_rate=25,
    image_size=(1280, 720),
    height=1.75,
)
print(fit, f"{fit.trusted.mean():.0%} of the frames are trusted", sep="\n")

# A row per frame and joint, in metres, with the standard deviation of each point.
table = fit.metres
figure = Figure(figsize=(8, 4.5), layout="constrained")
axes = figure.subplots()
for joint, colour in (("lankle", "#0072b2"), ("rankle", "#b86e00")):
    rows = table[table.landmark == joint]
    axes.fill_between(
        rows.time, rows.y - rows.sd, rows.y + rows.sd, color=colour, alpha=0.15, lw=0
    )
    axes.plot(rows.time, rows.y, color=colour, label=joint)
axes.set(xlabel="time (s)", ylabel="height (m)", title="Ankles of a walker, one camera")
axes.spines[["top", "right"]].set_visible(False)
axes.legend(frameon=False)
figure.savefig(out / "ankles.png", dpi=150)
