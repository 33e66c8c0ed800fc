#!/bin/sh
# Pictures of cars with labelled landmarks, to meshes that Blender opens (File > Import > glTF).
# Run it in the clone: sh docs/gallery/cars_to_blender.sh FOLDER
set -e
out=${1:-results/gallery/cars}
mkdir -p "$out"

# Every 3D model becomes an atom; its mesh moves with its landmarks.
shapefit learn-dict sample_data/cars.h5 --method exemplars --set align=none -o "$out/models.h5"

# Each car is fitted with the other models, under the camera that the file of landmarks states.
fit="--method convex+refine --lambda 1 --set leave_one_out=true_model --set camera.focal=files"
shapefit fit sample_data/cars_views.h5 -d "$out/models.h5" $fit -o "$out/cars.h5"

# A GLB file per image, in metres and in the frame of the car; and a sheet to look through.
shapefit convert "$out/cars.h5" -d "$out/models.h5" -o "$out/meshes" --to glb
shapefit view "$out/cars.h5" -d "$out/models.h5" -o "$out/sheet.png"
shapefit view "$out/cars.h5" -d "$out/models.h5" -o "$out/page.html"
