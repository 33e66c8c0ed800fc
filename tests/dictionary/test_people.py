"""The dictionary `people`: whole, small, with its origin; and joints that few bodies
have.
"""

import json

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from experiments.people.further_joints import extend_prior
from shapefit.config.loader import load_config
from shapefit.config.paths import DICTIONARIES
from shapefit.dictionary.bodies import find_bone_tree
from shapefit.dictionary.mixture import Mixture
from shapefit.geometry.procrustes import mirror, rotation_onto
from shapefit.io import read_dictionary
from shapefit.io.skeletons import (
    FURTHER,
    PEOPLE,
    edges_of,
    installed_skeletons,
    people_joints,
)
from tests.gaussians import covariance_of_root, draw_shapes

JOINTS = (*PEOPLE, *FURTHER)
FILE = DICTIONARIES / "people.h5"
LEARNING = ("method", "every", "align", "mirror", "k", "beta", "iterations", "prior")


@pytest.fixture(scope="module")
def people():
    return read_dictionary(FILE)


def test_it_has_the_joints_of_people(people):
    assert people.landmark_names == JOINTS
    assert people.drop_unmarked(()).landmark_names == PEOPLE


@pytest.mark.parametrize("skeleton", installed_skeletons().values())
def test_every_skeleton_maps_onto_joints_that_it_has(skeleton, people):
    joints = people_joints(skeleton.landmark_names).values()
    assert set(joints) <= set(people.landmark_names)


def undirected(edges):
    return {tuple(sorted(edge)) for edge in edges}


def test_its_edges_are_those_of_the_skeleton(people):
    assert undirected(people.edges.tolist()) == undirected(edges_of(JOINTS))


def test_edges_of_joints_that_all_bodies_have_are_a_tree(people):
    edges = people.drop_unmarked(()).edges
    find_bone_tree(edges, len(PEOPLE))


def test_it_has_what_all_methods_need(people):
    assert people.unit == "m"
    assert people.frame_rate == 24
    assert people.prior is not None
    assert (people.acceleration > 0).all()
    assert people.bone_tolerance.shape == (24,)
    assert people.edge_covariance.shape == (24, 24)


def test_partners_are_joints_of_the_other_side(people):
    opposite = {"r": "l", "l": "r"}

    partners = {
        JOINTS[j]: JOINTS[i] for j, i in enumerate(people.mirror_index) if i != j
    }

    for name, partner in partners.items():
        assert partner == opposite[name[0]] + name[1:]
    for joint in ("hip", "wrist", "toe"):
        assert f"l{joint}" in partners
        assert f"r{joint}" in partners


def test_its_prior_does_not_know_left_from_right(people):
    """The mean of the mixture is its own mirror image, but for what EM and rounding
    leave.
    """
    prior = people.prior
    mean = np.tensordot(prior.weights, prior.means, axes=1)
    images = [mirror(mean[None], people.mirror_index, axis)[0] for axis in range(3)]

    turned = rotation_onto(np.stack(images), mean) @ images

    farthest = np.linalg.norm(turned - mean, axis=1).max(axis=1)
    assert farthest.min() < 0.05


def test_it_is_small(people):
    assert FILE.stat().st_size < 800_000


def test_it_says_where_it_comes_from(people):
    assert "mocap.cs.cmu.edu" in people.provenance["source"]
    assert "may not be resold" in people.provenance["licence"]
    assert "NSF EIA-0196217" in people.provenance["acknowledgement"]


RENAMED = {"stretch": "bone_scale"}
"""Keys of the prior that have another name since the release that learned it."""


def keys_that_are_left(stored, now):
    """Return the stored keys of the prior by the names of now, those that there are."""
    renamed = {RENAMED.get(name, name): value for name, value in stored.items()}
    return {name: value for name, value in renamed.items() if name in now}


def test_it_was_learned_by_the_config_of_the_project(people, project):
    path = project / "configs/people/learn-box.yaml"
    arguments = {"shapes": [str(FILE)], "output": "people.h5"}
    now = load_config("learn-dict", path, (), arguments).as_plain()

    stored = json.loads(people.provenance["config"])

    stored["prior"] = keys_that_are_left(stored["prior"], now["prior"])
    for key in LEARNING:
        assert stored[key] == now[key], key


@pytest.fixture
def prior(rng):
    """Two components over four landmarks."""
    roots = rng.standard_normal((2, 12, 12)) / 4
    covariances = covariance_of_root(roots, floor=0.05)
    means = rng.standard_normal((2, 3, 4))
    return Mixture(np.array([0.4, 0.6]), means, covariances)


def test_the_prior_of_the_known_landmarks_stays_to_the_last_bit(prior, rng):
    shapes = rng.standard_normal((200, 3, 6))

    extended = extend_prior(prior, shapes, shrinkage=0.3, variance_floor=0.01)

    known = extended.marginal(np.arange(4))
    assert_array_equal(known.means, prior.means)
    assert_array_equal(known.covariances, prior.covariances)


def test_an_extended_prior_is_a_prior(prior, rng):
    shapes = rng.standard_normal((200, 3, 6))
    extended = extend_prior(prior, shapes, shrinkage=0.3, variance_floor=0.01)
    assert (np.linalg.eigvalsh(extended.covariances) > 0).all()


def test_a_landmark_that_follows_from_others_is_found(prior, rng):
    """y = x_0 + 0.5 (x_1 - x_2) in all shapes, which the prior drew."""
    landmark_map = np.eye(5, 4)
    landmark_map[4] = [1, 0.5, -0.5, 0]
    shapes = draw_shapes(prior, 4000, rng) @ landmark_map.T

    found = extend_prior(prior, shapes, shrinkage=0.0, variance_floor=1e-6)

    coordinate_map = np.kron(np.eye(3), landmark_map)
    covariances = coordinate_map @ prior.covariances @ coordinate_map.T
    assert_allclose(found.means, prior.means @ landmark_map.T, atol=1e-3)
    assert_allclose(found.covariances, covariances, atol=1e-3)
