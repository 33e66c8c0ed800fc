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
        assert set(people_joints(skeleton.landmark_names).values()) <= set(
            people.landmark_names
        )


def test_it_has_what_all_methods_need(people):
    assert people.unit == "m"
    assert people.frame_rate == 24
    find_bone_tree(people.marked(()).edges, len(PEOPLE))
    assert {tuple(sorted(edge)) for edge in people.edges.tolist()} == {
        tuple(sorted(edge)) for edge in edges_of(JOINTS)
    }
    assert people.prior is not None
    assert (people.acceleration > 0).all()
    assert people.bone_tolerance.shape == (24,)
    assert people.edge_covariance.shape == (24, 24)
    swapped = {"r": "l", "l": "r"}
    partners = {
        JOINTS[j]: JOINTS[i] for j, i in enumerate(people.mirror_index) if i != j
    }
    assert all(partners[name] == swapped[name[0]] + name[1:] for name in partners)
    assert {f"{side}{joint}" for side in "lr" for joint in ("hip", "wrist", "toe")} <= {
        *partners
    }


def test_its_prior_does_not_know_left_from_right(people):
    """The mean of the mixture is its own mirror image, but for what EM and rounding
    leave.
    """
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
    config = load_config(
        "learn-dict", project / "configs/people/learn-box.yaml", (), arguments
    )
    now = config.as_plain()
    renamed = {"stretch": "bone_scale"}  # since the release that learned it
    for key in LEARNING:
        was = stored[key]
        if isinstance(was, dict) and key == "prior":
            was = {renamed.get(name, name): value for name, value in was.items()}
            was = {name: value for name, value in was.items() if name in now[key]}
        assert was == now[key], key


@pytest.fixture
def prior(rng):
    """Two components over four landmarks."""
    roots = rng.standard_normal((2, 12, 12)) / 4
    C = roots @ roots.swapaxes(1, 2) + 0.05 * np.eye(12)
    return Mixture(np.array([0.4, 0.6]), rng.standard_normal((2, 3, 4)), C)


def test_the_prior_of_the_known_landmarks_stays_to_the_last_bit(prior, rng):
    shapes = rng.standard_normal((200, 3, 6))
    found = extend_prior(prior, shapes, shrinkage=0.3, floor=0.01)
    known = found.marginal(np.arange(4))
    assert_array_equal(known.means, prior.means)
    assert_array_equal(known.covariances, prior.covariances)
    assert (np.linalg.eigvalsh(found.covariances) > 0).all()


def test_a_landmark_that_follows_from_others_is_found(prior, rng):
    """y = x_0 + 0.5 (x_1 - x_2) in all shapes, which the prior drew."""
    L = np.linalg.cholesky(prior.covariances)
    component = rng.choice(2, size=4000, p=prior.weights)
    drawn = prior.means.reshape(2, 12)[component] + np.einsum(
        "nij,nj->ni", L[component], rng.standard_normal((4000, 12))
    )
    x = drawn.reshape(-1, 3, 4)
    y = x[..., :1] + 0.5 * (x[..., 1:2] - x[..., 2:3])
    found = extend_prior(
        prior, np.concatenate([x, y], axis=2), shrinkage=0.0, floor=1e-6
    )
    rows = np.hstack([np.eye(4), np.zeros((4, 1))]).T
    rows[4] = [1, 0.5, -0.5, 0]
    every = np.kron(np.eye(3), rows)
    assert_allclose(found.means, prior.means @ rows.T, atol=1e-3)
    expected = every @ prior.covariances @ every.T
    assert_allclose(found.covariances, expected, atol=1e-3)
