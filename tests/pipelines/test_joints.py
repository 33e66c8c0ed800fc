"""Landmarks of detectors in the place of joints: which stand for which, and what is
said.
"""

import numpy as np
import pytest

from shapefit.config.paths import find_dictionary
from shapefit.dictionary.model import Dictionary, mapped
from shapefit.errors import InputError
from shapefit.io import (
    read_dictionary,
    write_dictionary,
)
from shapefit.io.arrange import arrange
from shapefit.io.skeletons import PEOPLE, installed_skeletons, people_joints
from shapefit.pipelines.joints import (
    MEANS,
    find_joints,
    match_names,
    named_as_joints,
)
from shapefit.records import Landmarks
from tests.pipelines.fitted import fit_images

BODY = installed_skeletons()["body_25b"]


@pytest.fixture(scope="module")
def people():
    return read_dictionary(find_dictionary("people"))


@pytest.fixture
def images(people, rng):
    """Views of 24 means of the prior, with all joints."""
    n = 24
    turn = np.linalg.qr(rng.standard_normal((n, 3, 3)))[0]
    turn[:, :, 0] *= np.linalg.det(turn)[:, None]
    return Landmarks(
        (100 * (turn @ people.prior.means[:n])[:, :2]).swapaxes(1, 2),
        landmark_names=people.landmark_names,
        items=tuple(f"image{i}" for i in range(n)),
    )


def as_detected(images, skeleton, theta=MEANS):
    """The images with the landmarks of a skeleton in its order, those of no part not
    found.
    """
    joints = find_joints(skeleton.landmark_names, images.landmark_names)
    points = np.full((len(images), 2, len(skeleton.landmark_names)), np.nan)
    names = list(joints.parts)
    columns = [skeleton.landmark_names.index(name) for name in names]
    points[..., columns] = images.as_columns() @ joints.rows(names, theta).T
    return Landmarks(
        points.swapaxes(1, 2),
        landmark_names=skeleton.landmark_names,
        items=images.items,
    )


@pytest.fixture
def lift(tmp_path):
    def lift(images, dictionary="people", **keys):
        keys = {"method": "posterior"} | keys
        found, outcomes = fit_images(tmp_path, images, dictionary, **keys)
        return found, outcomes[-1]

    return lift


@pytest.mark.parametrize(
    "skeleton", installed_skeletons().values(), ids=lambda one: one.name
)
def test_a_detector_s_names_are_lifted_with_the_mapped_dictionary(
    images, lift, people, skeleton, tmp_path
):
    people = match_names(skeleton.landmark_names, people, "here").dictionary
    names, p = people.landmark_names, len(people.landmark_names)
    joints = find_joints(skeleton.landmark_names, names)
    A = joints.to_landmarks(MEANS)
    found, last = lift(as_detected(images, skeleton), skeleton=MEANS)
    visible = named_as_joints(as_detected(images, skeleton), joints, "here")
    visible = arrange(visible, names, "here", omit=True)
    points = arrange(images, names, "here", omit=True).as_columns() @ A.T
    points[..., [j for j, name in enumerate(names) if name not in joints.markers]] = (
        np.nan
    )
    np.testing.assert_allclose(visible.as_columns(), points, atol=1e-9)
    write_dictionary(tmp_path / "seen.h5", mapped(people, A, joints.deviations()))
    direct, _ = lift(
        visible,
        tmp_path / "seen.h5",
        save={"covariance": True},
    )
    back = np.linalg.inv(A)
    assert found.landmark_names == names
    np.testing.assert_allclose(found.points, direct.points @ back.T, atol=1e-5)
    covariance = direct.column("shape_covariance").reshape(len(images), p, 3, p, 3)
    expected = np.einsum("ij,njaka,ik->nia", back, covariance, back)
    np.testing.assert_allclose(found.shape_sd, np.sqrt(expected), rtol=1e-4)
    assert "keypoints" in dict(last.rows)["Read"]


def test_the_landmarks_of_the_files_come_back_in_3d(images, lift):
    """Those that stand for joints as they were fitted, the others where the joints put
    them.
    """
    found, _ = lift(as_detected(images, BODY), skeleton=MEANS)
    names = tuple(map(str, found.column("input_landmark_names")))
    points = dict(
        zip(names, found.column("input_shapes").transpose(1, 0, 2), strict=True)
    )
    joint = dict(
        zip(found.landmark_names, found.as_columns().transpose(2, 0, 1), strict=True)
    )
    np.testing.assert_allclose(points["LKnee"], joint["lknee"], atol=1e-9)
    middle = (joint["lshoulder"] + joint["rshoulder"]) / 2
    np.testing.assert_allclose(
        points["Head"], middle + 1.5 * (joint["head"] - middle), atol=1e-9
    )
    np.testing.assert_allclose(points["Neck"], middle, atol=1e-9)
    for mark, joint_of_foot in (
        ("BigToe", "toe"),
        ("SmallToe", "ball"),
        ("Heel", "heel"),
    ):
        np.testing.assert_allclose(
            points[f"R{mark}"], joint[f"r{joint_of_foot}"], atol=1e-9
        )
    fitted = dict(
        zip(
            found.landmark_names, found.landmarks_fitted.transpose(1, 0, 2), strict=True
        )
    )
    np.testing.assert_allclose(points["Head"][:, :2], fitted["head"], atol=1e-6)
    sd = found.column("input_shape_sd")
    assert sd.shape == (24, len(names), 3)
    assert (sd > 0).all()
    np.testing.assert_allclose(
        sd[:, names.index("LKnee")], found.shape_sd[:, 5], rtol=1e-9
    )
    # What stands for a joint has its error bars: how far apart they may be is in the
    # prior already.
    toe = found.shape_sd[:, found.landmark_names.index("rtoe")]
    np.testing.assert_allclose(sd[:, names.index("RBigToe")], toe, rtol=1e-9)


@pytest.mark.parametrize(("head", "hips"), [(1.5, 1.15), (1.7, 1.0), (1.3, 1.3)])
def test_planted_parameters_are_found(images, lift, head, hips):
    """Within 10%: a body of any build may have either."""
    theta = {"head": head, "hips": hips}
    _, last = lift(as_detected(images, BODY, theta))
    factors = last.note.split("of the detector: ")[1].partition(";")[0].split(", ")
    found = {name: factor for name, _, factor, *_ in map(str.split, factors)}
    assert float(found["head"]) == pytest.approx(head, rel=0.1)
    assert float(found["hips"]) == pytest.approx(hips, rel=0.1)


def test_feet_hands_and_spine_are_there_where_files_mark_them(people):
    """A marginal of the whole prior: what the files do not mark changes nothing."""
    feet = {f"{s}{part}" for s in "rl" for part in ("heel", "ball", "toe")}
    hands = {"rhand", "lhand"}
    marked = {"coco_17": set(), "coco_18": set(), "h36m_17": {"spine"}}
    marked["mediapipe_33"] = feet | hands
    for skeleton in installed_skeletons().values():
        part = match_names(skeleton.landmark_names, people, "here").dictionary
        assert set(part.landmark_names) - set(PEOPLE) == marked.get(skeleton.name, feet)
        rows = [people.landmark_names.index(name) for name in part.landmark_names]
        np.testing.assert_array_equal(part.atoms, people.atoms[..., rows])
        covariances = people.prior_covariances[:, rows][:, :, :, rows]
        np.testing.assert_array_equal(part.prior_covariances, covariances)
        names = np.array(part.landmark_names)
        assert (part.mirror_index[part.mirror_index] == np.arange(len(names))).all()
        bones = {tuple(sorted(bone)) for bone in names[part.edges]}
        every = {
            tuple(sorted(bone))
            for bone in np.array(people.landmark_names)[people.edges]
        }
        assert bones == {bone for bone in every if set(bone) <= set(names)}
        assert len(part.edge_length) == len(part.edge_covariance) == len(bones)


@pytest.mark.parametrize("theta", [MEANS, {"head": 1.8, "hips": 0.9}])
def test_a_map_moves_with_the_body(theta):
    """Weights add up to 1, and the map can be undone."""
    A = find_joints(BODY.landmark_names, PEOPLE).to_landmarks(theta)
    np.testing.assert_allclose(A.sum(axis=1), 1)
    assert np.linalg.cond(A) < 10


def test_the_convex_program_takes_landmarks_where_joints_are(images, lift):
    shared = people_joints(BODY.landmark_names)
    part = arrange(images, tuple(shared.values()), "here", omit=True)
    expected, _ = lift(part, method="convex")
    named = part.replaced(landmark_names=tuple(shared))
    found, _ = lift(named, method="convex")
    np.testing.assert_allclose(found.shapes, expected.shapes, atol=1e-6)
    assert found.input_shapes is None


@pytest.mark.parametrize(("own", "known", "expected"), [
    # what the file names itself stays
    (("lhip", "LHip", "RHip"), PEOPLE, {"RHip": "rhip"}),
    # of two alike none is meant
    (("left_hip", "LHip", "RHip"), PEOPLE, {"RHip": "rhip"}),
    (("LHip", "Head"), ("snout", "tail"), {}),
    (PEOPLE, PEOPLE, {}),
])  # fmt: skip
def test_which_names_stand_for_joints(own, known, expected):
    assert find_joints(own, known).names == expected


@pytest.mark.parametrize(
    "own", [("lft_hip", "2", "rhip"), ("snout", "leftear", "tail")]
)
def test_names_that_do_not_match_are_told(people, own):
    found = (
        "the 3 landmarks .* in the dictionary, at least 3 must be .files:"
        f" {', '.join(own)}; "
    )
    with pytest.raises(
        InputError, match=f"{found}dictionary: pelvis, rhip, .*`rename: "
    ):
        match_names(own, people, "here")


def test_two_ears_for_a_head_are_as_sure_as_the_mean_of_those_seen():
    own = (*PEOPLE[:6], "left_ear", "right_ear")
    joints = find_joints(own, PEOPLE)
    assert joints.markers["head"] == ("left_ear", "right_ear")
    confidence = np.full((3, 8), 0.7)
    confidence[:, 6:] = [[0.9, 0.5], [0.0, 0.6], [0.0, 0.0]]
    images = Landmarks(
        np.arange(48.0).reshape(3, 2, 8).swapaxes(1, 2),
        landmark_names=own,
        items=tuple("abc"),
        confidence=confidence,
    )
    named = named_as_joints(images, joints, "place")
    column = named.landmark_names.index("head")
    np.testing.assert_allclose(named.confidence[:, column], [0.7, 0.6, 0.0])
    np.testing.assert_allclose(
        named.as_columns()[0, :, column], images.as_columns()[0, :, 6:].mean(1)
    )
    np.testing.assert_allclose(
        named.as_columns()[1, :, column], images.as_columns()[1, :, 7]
    )


@pytest.mark.parametrize("in_place", [True, False])
def test_joints_are_those_of_the_dictionary_that_is_left(people, in_place):
    for skeleton in installed_skeletons().values():
        try:
            matched = match_names(
                skeleton.landmark_names, people, "file", in_place=in_place
            )
        except InputError:  # hands alone have too few landmarks of the dictionary
            continue
        left = matched.dictionary.landmark_names
        assert matched.joints == find_joints(
            skeleton.landmark_names, left, in_place=in_place
        )


def test_more_landmarks_left_out_than_used_are_said(people):
    """Face and hands of a whole body; eyes and ears are expected to be."""
    for skeleton in installed_skeletons().values():
        said = match_names(skeleton.landmark_names, people, "here").warnings()
        assert len(said) == (skeleton.name == "coco_133"), skeleton.name
    names = installed_skeletons()["coco_133"].landmark_names
    (said,) = match_names(names, people, "here").warnings()
    assert "114 landmarks left out, which the dictionary lacks (nose" in said


FROM_0, FROM_1 = ([str(start + n) for n in range(8)] for start in (0, 1))


@pytest.mark.parametrize(
    ("ours", "theirs", "found"),
    [
        (FROM_1, FROM_0, "refused"),
        (FROM_0, FROM_1, "refused"),
        (FROM_1[1:], FROM_0, "refused"),
        (FROM_1[:-1], FROM_0, "said"),
        (FROM_0[2:], FROM_0, "said"),
        (FROM_0, FROM_0, ""),
        (FROM_1, FROM_1, ""),
        (FROM_1[1:-1], FROM_1, ""),
        (FROM_0[:-2], FROM_0, ""),
        (FROM_0, ["2", "5", "7"], "said"),
        (["a", *FROM_1[1:]], FROM_0, ""),
    ],
)
def test_numbers_from_0_beside_numbers_from_1(rng, ours, theirs, found):
    shapes = rng.normal(size=(3, 3, len(theirs)))
    dictionary = Dictionary(shapes, tuple(theirs), shapes[0])
    if found == "refused":
        with pytest.raises(InputError, match=r"numbered .* of the dictionary .*from 1"):
            match_names(ours, dictionary, "here")
        return
    warnings = match_names(ours, dictionary, "here").warnings()
    said = [text for text in warnings if "all are off by one" in text]
    assert len(said) == (found == "said")
