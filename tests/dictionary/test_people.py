"""The dictionary `people` of the package: whole, small, with its origin, and without any pose."""

import json

import numpy as np
import pytest

from shapefit.config.loader import load_config
from shapefit.config.paths import DICTIONARIES
from shapefit.dictionary.bodies import find_skeleton
from shapefit.geometry.procrustes import mirror, rotation_onto
from shapefit.io import read_dictionary
from shapefit.io.skeletons import FURTHER, PEOPLE, edges_of, installed_skeletons, people_joints

JOINTS = (*PEOPLE, *FURTHER)
FILE = DICTIONARIES / "people.h5"
LEARNING = ("method", "every", "align", "mirror", "k", "beta", "iterations", "prior")


@pytest.fixture(scope="module")
def people():
    return read_dictionary(FILE)


def test_it_has_the_joints_onto_which_all_skeletons_map(people):
    assert people.landmark_names == JOINTS
    assert people.marked(()).landmark_names == PEOPLE
    for skeleton in installed_skeletons().values():
        assert set(people_joints(skeleton.landmark_names).values()) <= set(people.landmark_names)


def test_it_has_what_all_methods_need(people):
    assert people.unit == "m"
    assert people.frame_rate == 24
    find_skeleton(people.marked(()).edges, len(PEOPLE))
    assert {tuple(sorted(edge)) for edge in people.edges.tolist()} == {
        tuple(sorted(edge)) for edge in edges_of(JOINTS)
    }
    assert people.prior is not None
    assert (people.acceleration > 0).all()
    assert people.bone_tolerance.shape == (24,)
    assert people.edge_covariance.shape == (24, 24)
    sides = {"r": "l", "l": "r"}
    for j, i in enumerate(people.mirror_index.tolist()):
        name, other = JOINTS[j], JOINTS[i]
        paired = name[0] in sides and f"r{name[1:]}" in JOINTS
        assert other == (sides[name[0]] + name[1:] if paired else name)


def test_its_prior_does_not_know_left_from_right(people):
    """The mean of the mixture is its own mirror image, but for what EM and rounding leave."""
    mean = np.einsum("k,kcp->cp", people.prior.weights, people.prior.means)[None]
    index = people.mirror_index
    images = np.stack([mirror(mean, index, axis)[0] for axis in range(3)])
    turned = rotation_onto(images, mean[0]) @ images
    apart = np.linalg.norm(turned - mean, axis=1).max(axis=1)
    assert apart.min() < 0.05


def test_it_is_small_and_says_where_it_comes_from(people):
    assert FILE.stat().st_size < 800_000
    assert "mocap.cs.cmu.edu" in people.provenance["source"]
    assert "may not be resold" in people.provenance["licence"]
    assert "NSF EIA-0196217" in people.provenance["acknowledgement"]


def test_it_was_learned_by_the_config_of_the_project(people, project):
    stored = json.loads(people.provenance["config"])
    arguments = {"shapes": [str(FILE)], "output": "people.h5"}
    config = load_config("learn-dict", project / "configs/people/learn-box.yaml", (), arguments)
    now = config.as_plain()
    renamed = {"stretch": "bone_scale"}  # since the release that learned it
    for key in LEARNING:
        was = stored[key]
        if isinstance(was, dict) and key == "prior":
            was = {renamed.get(name, name): value for name, value in was.items()}
            was = {name: value for name, value in was.items() if name in now[key]}
        assert was == now[key], key
