"""Real files of other tools against what independent readers found in them."""

from __future__ import annotations

import json

import numpy as np
import pytest

from shapefit.io import open_shapes

pytestmark = pytest.mark.real_data

SAMPLES = ("balancing_body25b.trc", "markers.trc", "bvhio_example.bvh", "test_freebvh.bvh")


def read(path, **options):
    with open_shapes([path], gaps=True, **options) as source:
        (shapes,) = source.chunks(max(source.count, 1))
    return shapes


@pytest.mark.parametrize("name", [*SAMPLES, "runway03.c3d"])
def test_real_files_hold_what_independent_readers_found(real_data, name):
    if name.endswith("c3d"):
        pytest.importorskip("ezc3d", reason="ezc3d is the extra `c3d`")
    folder = real_data / "formats"
    entries = json.loads((folder / "expected.json").read_text())["entries"]
    (entry,) = (e for e in entries if e["path"] == f"motion/{name}")
    shapes = read(folder / "motion" / name)
    p = entry["landmarks"]
    known = shapes.shapes[:, :, :p]
    finite = np.isfinite(known).all(axis=1)
    assert len(shapes) == entry["items"]
    assert shapes.landmark_names[:p] == tuple(entry["landmark_names"])
    assert finite.sum() == entry["finite_points"]
    assert shapes.unit == ("m" if entry["unit"] == "m" else "unknown")
    for axis, letter in enumerate("xyz"):
        total = np.nansum(known[:, axis])
        assert abs(total - entry[f"sum_{letter}"]) <= 1e-9 * entry[f"abs_sum_{letter}"]
    frames = shapes.extras["frame"].tolist()
    for spot in entry["spots"]:
        row = frames.index(spot["frame"])
        assert shapes.items[row] == f"{name.rpartition('.')[0]}/{spot['frame_label']}"
        want = [spot[letter] for letter in "xyz"]
        assert known[row, :, spot["landmark_index"]] == pytest.approx(want, rel=1e-9)


@pytest.mark.parametrize("name", SAMPLES[2:])
def test_ends_of_the_last_bones_follow_the_joints(real_data, name):
    folder = real_data / "formats"
    entries = json.loads((folder / "expected.json").read_text())["entries"]
    (entry,) = (e for e in entries if e["path"] == f"motion/{name}")
    shapes = read(folder / "motion" / name)
    (other,) = entry["alternatives"]
    assert len(shapes.landmark_names) == other["landmarks"]
    assert all(name.endswith("_end") for name in shapes.landmark_names[entry["landmarks"] :])
    for axis, letter in enumerate("xyz"):
        assert shapes.shapes[:, axis].sum() == pytest.approx(other[f"sum_{letter}"], rel=1e-9)
