"""Ends of bones, which only some readers of BVH give: a second reading in expected.json."""

import json

import pytest

from tests.io.files import load_shapes

pytestmark = pytest.mark.real_data

SAMPLES = ("bvhio_example.bvh", "test_freebvh.bvh")


@pytest.mark.parametrize("name", SAMPLES)
def test_ends_of_the_last_bones_follow_the_joints(real_data, name):
    folder = real_data / "formats"
    entries = json.loads((folder / "expected.json").read_text())["entries"]
    (entry,) = (e for e in entries if e["path"] == f"motion/{name}")
    shapes, _ = load_shapes(folder / "motion" / name)
    (other,) = entry["alternatives"]
    assert len(shapes.landmark_names) == other["landmarks"]
    assert all(name.endswith("_end") for name in shapes.landmark_names[entry["landmarks"] :])
    for axis, letter in enumerate("xyz"):
        assert shapes.shapes[:, axis].sum() == pytest.approx(other[f"sum_{letter}"], rel=1e-9)
