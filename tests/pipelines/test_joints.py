"""Landmarks of detectors in the place of joints: which stand for which, and what is
said.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.config.paths import find_dictionary
from shapefit.dictionary.model import Dictionary, map_landmarks
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
    rename_to_joints,
)
from shapefit.records import Landmarks
from tests.columns import in_rows
from tests.pipelines.fitted import fit_images

BODY = installed_skeletons()["body_25b"]


@pytest.fixture(scope="module")
def people():
    return read_dictionary(find_dictionary("people"))


@pytest.fixture
def images(people, rng):
    """Views of 24 means of the prior, with all joints."""
    count = 24
    turn, _ = np.linalg.qr(rng.standard_normal((count, 3, 3)))
    turn[:, :, 0] *= np.linalg.det(turn)[:, None]
    shapes = 100 * (turn @ people.prior.means[:count])
    return Landmarks(
        in_rows(shapes[:, :2]),
        landmark_names=people.landmark_names,
        items=tuple(f"image{i}" for i in range(count)),
    )


def as_detected(images, skeleton, theta=MEANS):
    """The images with the landmarks of a skeleton in its order, those of no part not
    found.
    """
    joints = find_joints(skeleton.landmark_names, images.landmark_names)
    landmarks = np.full((len(images), len(skeleton.landmark_names), 2), np.nan)
    names = list(joints.parts)
    rows = [skeleton.landmark_names.index(name) for name in names]
    landmarks[:, rows] = joints.weights(names, theta) @ images.landmarks
    return Landmarks(
        landmarks, landmark_names=skeleton.landmark_names, items=images.items
    )


@pytest.fixture
def lift(tmp_path):
    """Lift images; return the result and the last outcome."""

    def lift(images, dictionary="people", **keys):
        keys = {"method": "posterior"} | keys
        result, outcomes = fit_images(tmp_path, images, dictionary, **keys)
        return result, outcomes[-1]

    return lift


@pytest.fixture(params=installed_skeletons().values(), ids=[*installed_skeletons()])
def skeleton(request):
    return request.param


def test_a_detector_s_names_are_read_as_joints(images, people, skeleton):
    dictionary = match_names(skeleton.landmark_names, people, "here").dictionary
    names = dictionary.landmark_names
    joints = find_joints(skeleton.landmark_names, names)
    detected = rename_to_joints(as_detected(images, skeleton), joints, "here")
    visible = arrange(detected, names, "here", omit=True)
    in_order = arrange(images, names, "here", omit=True)
    expected = joints.to_landmarks(MEANS) @ in_order.landmarks
    unmarked = [name not in joints.markers for name in names]
    expected[:, unmarked] = np.nan
    assert_allclose(visible.landmarks, expected, atol=1e-9)


def test_a_detector_s_names_are_lifted_with_the_mapped_dictionary(
    images, lift, people, skeleton, tmp_path
):
    dictionary = match_names(skeleton.landmark_names, people, "here").dictionary
    names = dictionary.landmark_names
    joints = find_joints(skeleton.landmark_names, names)
    A = joints.to_landmarks(MEANS)
    detected = as_detected(images, skeleton)
    visible = arrange(rename_to_joints(detected, joints, "here"), names, "x", omit=True)
    mapped_file = tmp_path / "seen.h5"
    write_dictionary(mapped_file, map_landmarks(dictionary, A, joints.deviations()))
    result, last = lift(detected, skeleton=MEANS)
    direct, _ = lift(visible, mapped_file, save={"covariance": True})
    back = np.linalg.inv(A)
    p = len(names)
    covariance = direct.shape_covariance.reshape(len(images), p, 3, p, 3)
    variance = np.einsum("ij,njaka,ik->nia", back, covariance, back)
    assert result.landmark_names == names
    assert_allclose(result.shapes, back @ direct.shapes, atol=1e-5)
    assert_allclose(result.shape_sd, np.sqrt(variance), rtol=1e-4)
    assert "keypoints" in dict(last.rows)["Read"]


@pytest.fixture
def lifted(images, lift):
    """The result of images of a detector."""
    result, _ = lift(as_detected(images, BODY), skeleton=MEANS)
    return result


def joint(result, name):
    """Return the shapes (n, 3) of a joint."""
    return result.shapes[:, result.landmark_names.index(name)]


def detector_points(result, column):
    """Return landmark of the detector -> what a column has of it, (n, 3)."""
    names = map(str, result.input_landmark_names)
    values = np.moveaxis(result.column(column), 1, 0)
    return dict(zip(names, values, strict=True))


STAND_FOR_JOINTS = {
    "LKnee": "lknee",
    "RBigToe": "rtoe",
    "RSmallToe": "rball",
    "RHeel": "rheel",
}


@pytest.mark.parametrize("name", STAND_FOR_JOINTS)
def test_landmarks_that_stand_for_joints_come_back_as_they_were_fitted(lifted, name):
    point = detector_points(lifted, "input_shapes")[name]
    expected = joint(lifted, STAND_FOR_JOINTS[name])
    assert_allclose(point, expected, atol=1e-9)


def test_other_landmarks_are_where_the_joints_put_them(lifted):
    points = detector_points(lifted, "input_shapes")
    neck = (joint(lifted, "lshoulder") + joint(lifted, "rshoulder")) / 2
    head = neck + 1.5 * (joint(lifted, "head") - neck)
    assert_allclose(points["Neck"], neck, atol=1e-9)
    assert_allclose(points["Head"], head, atol=1e-9)


def test_what_was_fitted_of_a_joint_is_its_landmark_in_the_image(lifted):
    head = detector_points(lifted, "input_shapes")["Head"]
    fitted = lifted.landmarks_fitted[:, lifted.landmark_names.index("head")]
    assert_allclose(head[:, :2], fitted, atol=1e-6)


@pytest.mark.parametrize("name", ["LKnee", "RBigToe"])
def test_what_stands_for_a_joint_has_its_error_bars(lifted, name):
    """How far apart they may be is in the prior already."""
    sd = detector_points(lifted, "input_shape_sd")[name]
    place = lifted.landmark_names.index(STAND_FOR_JOINTS[name])
    assert_allclose(sd, lifted.shape_sd[:, place], rtol=1e-9)


def test_all_landmarks_of_the_detector_have_error_bars(lifted):
    sd = lifted.input_shape_sd
    assert sd.shape == (24, len(lifted.input_landmark_names), 3)
    assert (sd > 0).all()


@pytest.mark.parametrize(("head", "hips"), [(1.5, 1.15), (1.7, 1.0), (1.3, 1.3)])
def test_planted_parameters_are_found(images, lift, head, hips):
    """Within 10%: a body of any build may have either."""
    theta = {"head": head, "hips": hips}
    _, last = lift(as_detected(images, BODY, theta))
    _, _, told = last.note.partition("of the detector: ")
    factors = {}
    for factor in told.partition(";")[0].split(", "):
        name, _, value, *_ = factor.split()
        factors[name] = float(value)
    assert factors["head"] == pytest.approx(head, rel=0.1)
    assert factors["hips"] == pytest.approx(hips, rel=0.1)


FEET = {f"{side}{part}" for side in "rl" for part in ("heel", "ball", "toe")}


HANDS = {"rhand", "lhand"}


MARKED = {
    "coco_17": set(),
    "coco_18": set(),
    "h36m_17": {"spine"},
    "mediapipe_33": FEET | HANDS,
}
"""Skeleton -> joints beyond PEOPLE that it marks; all others mark feet."""


@pytest.fixture
def part_of_people(people, skeleton):
    """The dictionary of the joints that a skeleton marks."""
    return match_names(skeleton.landmark_names, people, "here").dictionary


def bones_of(dictionary):
    """Return the names of the ends of edges, in either order."""
    names = np.array(dictionary.landmark_names)
    return {frozenset(bone) for bone in names[dictionary.edges]}


def test_feet_hands_and_spine_are_there_where_files_mark_them(part_of_people, skeleton):
    further = set(part_of_people.landmark_names) - set(PEOPLE)
    assert further == MARKED.get(skeleton.name, FEET)


def test_what_files_do_not_mark_changes_nothing(people, part_of_people):
    """The prior of a part is a marginal of the whole prior."""
    rows = [people.landmark_names.index(name) for name in part_of_people.landmark_names]
    covariances = people.prior_covariances[:, rows][:, :, :, rows]
    assert_array_equal(part_of_people.atoms, people.atoms[..., rows])
    assert_array_equal(part_of_people.prior_covariances, covariances)


def test_a_part_of_people_has_the_bones_between_its_joints(people, part_of_people):
    names = set(part_of_people.landmark_names)
    expected = {bone for bone in bones_of(people) if bone <= names}
    assert bones_of(part_of_people) == expected
    assert len(part_of_people.edge_length) == len(expected)
    assert len(part_of_people.edge_covariance) == len(expected)


def test_a_part_of_people_mirrors_as_the_whole(part_of_people):
    mirror = part_of_people.mirror_index
    assert_array_equal(mirror[mirror], np.arange(len(mirror)))


@pytest.mark.parametrize("theta", [MEANS, {"head": 1.8, "hips": 0.9}])
def test_a_map_moves_with_the_body(theta):
    """Weights add up to 1, and the map can be undone."""
    A = find_joints(BODY.landmark_names, PEOPLE).to_landmarks(theta)
    assert_allclose(A.sum(axis=1), 1)
    assert np.linalg.cond(A) < 10


def test_the_convex_program_takes_landmarks_where_joints_are(images, lift):
    shared = people_joints(BODY.landmark_names)
    joints = arrange(images, tuple(shared.values()), "here", omit=True)
    detected = joints.replaced(landmark_names=tuple(shared))
    expected, _ = lift(joints, method="convex")
    result, _ = lift(detected, method="convex")
    assert_allclose(result.shapes, expected.shapes, atol=1e-6)
    assert result.input_shapes is None


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
    count = "the 3 landmarks .* in the dictionary, at least 3 must be "
    names = f".files: {', '.join(own)}; dictionary: pelvis, rhip, .*"
    with pytest.raises(InputError, match=f"{count}{names}`rename: "):
        match_names(own, people, "here")


def test_two_ears_for_a_head_are_as_sure_as_the_mean_of_those_seen():
    own = (*PEOPLE[:6], "left_ear", "right_ear")
    joints = find_joints(own, PEOPLE)
    confidence = np.full((3, 8), 0.7)
    confidence[:, 6:] = [[0.9, 0.5], [0.0, 0.6], [0.0, 0.0]]
    images = Landmarks(
        np.arange(48.0).reshape(3, 8, 2),
        landmark_names=own,
        items=tuple("abc"),
        confidence=confidence,
    )
    named = rename_to_joints(images, joints, "place")
    head = named.landmark_names.index("head")
    points = named.landmarks[:, head]
    mean_of_ears = images.landmarks[0, 6:].mean(axis=0)
    right_ear = images.landmarks[1, 7]
    assert joints.markers["head"] == ("left_ear", "right_ear")
    assert_allclose(named.confidence[:, head], [0.7, 0.6, 0.0])
    assert_allclose(points[0], mean_of_ears)
    assert_allclose(points[1], right_ear)


@pytest.mark.parametrize("in_place", [True, False])
def test_joints_are_those_of_the_dictionary_that_is_left(people, in_place):
    for skeleton in installed_skeletons().values():
        names = skeleton.landmark_names
        try:
            matched = match_names(names, people, "file", in_place=in_place)
        except InputError:  # hands alone have too few landmarks of the dictionary
            continue
        left = matched.dictionary.landmark_names
        assert matched.joints == find_joints(names, left, in_place=in_place)


WHOLE_BODY = "coco_133"
"""A skeleton with a face and hands."""


def test_more_landmarks_left_out_than_used_are_said(people):
    names = installed_skeletons()[WHOLE_BODY].landmark_names
    (warning,) = match_names(names, people, "here").warnings()
    assert "114 landmarks left out, which the dictionary lacks (nose" in warning


def test_eyes_and_ears_are_expected_to_be_left_out(people, skeleton):
    warnings = match_names(skeleton.landmark_names, people, "here").warnings()
    assert bool(warnings) == (skeleton.name == WHOLE_BODY)


FROM_0 = [str(number) for number in range(8)]


FROM_1 = [str(number) for number in range(1, 9)]


REFUSED_NUMBERS = [
    (FROM_1, FROM_0),
    (FROM_0, FROM_1),
    (FROM_1[1:], FROM_0),
]
"""Names of files and of a dictionary."""


DOUBTED_NUMBERS = [
    (FROM_1[:-1], FROM_0),
    (FROM_0[2:], FROM_0),
    (FROM_0, ["2", "5", "7"]),
]


EQUAL_NUMBERS = [
    (FROM_0, FROM_0),
    (FROM_1, FROM_1),
    (FROM_1[1:-1], FROM_1),
    (FROM_0[:-2], FROM_0),
    (["a", *FROM_1[1:]], FROM_0),
]


@pytest.fixture
def numbered(rng):
    """Return a dictionary of landmarks with these names."""

    def make(names):
        shapes = rng.normal(size=(3, 3, len(names)))
        return Dictionary(shapes, tuple(names), shapes[0])

    return make


def warnings_of_numbers(ours, dictionary):
    warnings = match_names(ours, dictionary, "here").warnings()
    return [text for text in warnings if "all are off by one" in text]


@pytest.mark.parametrize(("ours", "theirs"), REFUSED_NUMBERS)
def test_numbers_from_0_beside_numbers_from_1_are_refused(numbered, ours, theirs):
    with pytest.raises(InputError, match=r"numbered .* of the dictionary .*from 1"):
        match_names(ours, numbered(theirs), "here")


@pytest.mark.parametrize(("ours", "theirs"), DOUBTED_NUMBERS)
def test_numbers_that_may_be_off_by_one_are_warned_of(numbered, ours, theirs):
    assert len(warnings_of_numbers(ours, numbered(theirs))) == 1


@pytest.mark.parametrize(("ours", "theirs"), EQUAL_NUMBERS)
def test_numbers_that_agree_are_not_warned_of(numbered, ours, theirs):
    assert warnings_of_numbers(ours, numbered(theirs)) == []
