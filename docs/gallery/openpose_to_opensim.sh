#!/bin/sh
# From OpenPose's JSON of one camera to OpenSim: markers (TRC) and joint angles (MOT) of two people.
# Run it in the clone: sh docs/gallery/openpose_to_opensim.sh FOLDER
set -e
out=${1:-results/gallery/openpose}
mkdir -p "$out"

# A JSON file per frame, as OpenPose writes them.
camera="--frame-rate 25 --image-size 1280x720 --focal 1100"
shapefit fit sample_data/openpose $camera -o "$out/walk.h5"

# One file per person: markers for the Scale and Inverse Kinematics tools, and angles to plot. The
# height of the people sets the scale.
shapefit convert "$out/walk.h5" -o "$out/walk.trc" --markers input --height 1.75
shapefit convert "$out/walk.h5" -o "$out/walk.mot" --height 1.75

# The page shows the same frames with error bars, to decide which of them to trust.
shapefit view "$out/walk.h5" -o "$out/page.html"
