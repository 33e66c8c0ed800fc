#!/bin/sh
# A dog that DeepLabCut tracked with one camera, lifted with a dictionary of its kind.
# Run it in the clone: sh docs/gallery/animal_from_deeplabcut.sh FOLDER
set -e
out=${1:-results/gallery/animal}
mkdir -p "$out"

# 3D poses of the animal, from markers or several cameras, teach its shape and how it moves.
shapefit learn-dict sample_data/animal_train.h5 -o "$out/dog.h5" --prior

# DeepLabCut's CSV as it is; landmarks with a likelihood below 0.6 count as hidden.
shapefit fit sample_data/animal_walk.csv -d "$out/dog.h5" --min-confidence 0.6 -o "$out/walk.h5"

# How far off is it? The truth is known here.
shapefit eval "$out/walk.h5" --truth sample_data/animal_truth.h5 -o "$out/report"
shapefit view "$out/walk.h5" --truth sample_data/animal_truth.h5 -o "$out/page.html"
