"""The method `sequences` through `fit`: order, motion, known lengths, single images."""

import json
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

import shapefit
from shapefit.config import EvalConfig, LearnDictConfig, ProjectConfig
from shapefit.config.paths import find_dictionaries
from shapefit.dictionary.bodies import LIMB_ENDS
from shapefit.errors import InputError
from shapefit.evaluation.metrics import similarity
from shapefit.geometry.rotations import rotation_about
from shapefit.io import (
    read_dictionary,
    read_shapes,
    write_dictionary,
)
from shapefit.lifting.sequences import clips
from shapefit.pipelines import projection as projecting
from shapefit.pipelines import verify
from shapefit.pipelines.evaluate import run as evaluating
from shapefit.pipelines.fit.sequences import (
    find_usual_lengths,
    hides_the_hips,
    restore_sides,
)
from shapefit.pipelines.fit.whole_sequences import whole_sequences
from shapefit.pipelines.learn_dict import run as learning
from shapefit.records import Landmarks
from tests.columns import put
from tests.io.files import load, save
from tests.pipelines.fitted import fit_file, warnings


@pytest.fixture(scope="module")
def people(project, tmp_path_factory):
    """A dictionary with a prior, and views of some sequences of the sample data."""
    folder = tmp_path_factory.mktemp("people")
    shapes = (project / "sample_data/people_train.h5",)
    config = LearnDictConfig(
        shapes=shapes,
        output=folder / "dictionary.h5",
        k=16,
        iterations=3,
        prior={"components": 4, "floor": 0.01},
    )
    list(learning.learn_dictionary(config))
    test = (project / "sample_data/people_test.h5",)
    list(
        projecting.project_shapes(ProjectConfig(shapes=test, output=folder / "all.h5"))
    )
    save(folder / "views.h5", load(folder / "all.h5").take(slice(0, 320)))
    return folder


def fitted(folder, landmarks, **keys):
    keys = {"method": "sequences", **keys}
    dictionary, output = folder / "dictionary.h5", folder / "result.h5"
    found, outcomes = fit_file(landmarks, dictionary, output, **keys)
    return found, warnings(outcomes)


def written(path, images):
    save(path, images)
    return path


@pytest.mark.slow
def test_without_edges_sequences_go_by_smooth_motion(people, tmp_path):
    known = read_dictionary(people / "dictionary.h5")
    bare = dict.fromkeys(("edges", "bone_tolerance", "edge_length"))
    write_dictionary(tmp_path / "dictionary.h5", replace(known, **bare))
    single, _ = fitted(tmp_path, people / "views.h5", method="posterior")
    whole, _ = fitted(tmp_path, people / "views.h5")
    assert np.isfinite(whole.as_columns()).all()
    refined = np.isfinite(whole.column("sequence_noise"))
    assert refined.any()
    assert (whole.shape_sd[refined] > 0.4 * single.shape_sd[refined]).all()

    second = [
        np.abs(np.diff(result.as_columns()[:, 2], n=2, axis=0)).mean()
        for result in (whole, single)
    ]
    assert second[0] < second[1]


@pytest.mark.parametrize("count", [1, 3])
def test_a_sequence_for_which_a_thread_is_left_is_inferred_on_two(
    people, tmp_path, count
):
    images = load(people / "views.h5")
    sequences = np.array(images.sequences)
    names = list(dict.fromkeys(sequences))[:count]
    assert len(names) == count
    some = images.take(np.flatnonzero(np.isin(sequences, names)))
    path = written(tmp_path / "some.h5", some)
    one, two = (fitted(people, path, threads=threads)[0] for threads in (1, 2))
    assert np.isfinite(one.column("sequence_noise")).any()
    for column in ("shape_sd", "shape_correlation", "sequence_noise"):
        np.testing.assert_array_equal(two.column(column), one.column(column))
    np.testing.assert_array_equal(two.as_columns(), one.as_columns())


@pytest.mark.parametrize(
    ("grow", "noise"), [(1.0, None), (50.0, None), (50.0, 0.0), (50.0, 0.4)]
)
def test_noise_is_stated_and_that_of_the_images_otherwise(
    people, tmp_path, grow, noise
):
    """In the unit of the landmarks, of which the size of a body is some."""
    images = load(people / "views.h5")
    images = images.take(
        np.flatnonzero(np.array(images.sequences) == images.sequences[0])
    )
    path = written(
        tmp_path / "large.h5",
        images.replaced(landmarks=(grow * images.as_columns()).swapaxes(1, 2)),
    )
    found, _ = fitted(people, path, noise=noise)
    unit = np.median(found.scale)
    expected = {None: 0.1 * unit, 0.0: 0.003 * unit}.get(noise, noise)
    np.testing.assert_allclose(found.column("sequence_noise"), expected, rtol=1e-9)


def test_sequences_of_one_image_are_single_images(people, tmp_path):
    images = load(people / "views.h5").take(slice(0, 20))
    alone = images.replaced(sequences=tuple(map(str, range(20))))
    path = written(tmp_path / "alone.h5", alone)
    prior = {"residual_variance": 0.01, "bar_scale": 1.5}
    single, _ = fitted(people, path, method="posterior", prior=prior)
    whole, _ = fitted(people, path, prior=prior)
    # but for the neighbour that the convex program starts from
    np.testing.assert_allclose(
        whole.as_columns(), single.as_columns(), rtol=1e-5, atol=1e-8
    )
    np.testing.assert_allclose(whole.shape_sd, single.shape_sd, rtol=1e-5)
    assert np.isnan(whole.column("sequence_noise")).all()


def test_an_unknown_frame_rate_is_a_warning(people, tmp_path):
    images = load(people / "views.h5").take(slice(0, 10)).replaced(frame_rate=None)
    path = written(tmp_path / "unknown.h5", images)
    assert any("frame rate is unknown" in text for text in fitted(people, path)[1])
    result, warnings = fitted(people, path, frame_rate=24)
    assert not any("frame rate" in text for text in warnings)
    assert result.frame_rate == 24


def test_sequences_out_of_order_are_an_error(people, tmp_path):
    images = load(people / "views.h5").take(slice(0, 6))
    mixed = images.replaced(sequences=("a", "a", "b", "b", "a", "a"))
    with pytest.raises(InputError, match="sequence: 'a' goes on after others"):
        fitted(people, written(tmp_path / "mixed.h5", mixed))


def test_a_sequence_before_a_camera(people, project, tmp_path):
    """Near bodies on a turntable: the camera lowers the error, and verification follows
    it.
    """
    truth = read_shapes([project / "sample_data/people_test.h5"])
    first = truth.sequences[0]
    rows = [row for row, name in enumerate(truth.sequences) if name == first][:40]
    truth = truth.take(rows)
    turn = rotation_about(np.array([0.0, 1.0, 0.0]), np.linspace(0, 3, len(truth)))
    X = turn @ (truth.as_columns() - truth.as_columns().mean(axis=2, keepdims=True))
    X[:, 2] -= 2.5 * np.ptp(X, axis=2).max()
    visible = Landmarks(
        (-900 * X[:, :2] / X[:, 2:] + 500).swapaxes(1, 2),
        landmark_names=truth.landmark_names,
        items=truth.items,
        sequences=truth.sequences,
        y_axis="up",
        frame_rate=24.0,
    )
    path = written(tmp_path / "near.h5", visible)
    weak, _ = fitted(people, path, camera={"focal": "none"})
    camera = {"focal": 900.0, "principal_point": [500.0, 500.0]}
    found, _ = fitted(people, path, camera=camera)
    request = verify.Request(people / "result.h5", people / "dictionary.h5", ())
    assert not any(outcome.failures for outcome in verify.verify_results(request))
    errors = [similarity(each.as_columns(), X).mean() for each in (found, weak)]
    assert errors[0] < 0.95 * errors[1]
    assert found.column("camera_translation").shape == (len(truth), 3)
    assert (found.shape_sd > 0).all()
    assert found.y_axis == "up"


@pytest.fixture
def judged(people, project, tmp_path):
    """Share of the truth in the 90% ellipsoids of a fit, and the factors of its
    report.
    """

    def judged(method, **prior):
        found, _ = fitted(people, people / "views.h5", method=method, prior=prior)
        config = EvalConfig(
            results={method: people / "result.h5"},
            output=tmp_path / "report",
            plots="none",
            truth=(project / "sample_data/people_test.h5",),
            truth_frame="object",
        )
        list(evaluating.evaluate_results(config))
        report = json.loads(
            (tmp_path / "report/report.json").read_text(encoding="utf-8")
        )
        return found, next(
            c["inside"][1] for c in report["calibration"] if c["group"] == "all"
        )

    return judged


@pytest.mark.parametrize(("method", "off"), [("posterior", 0.05), ("sequences", 0.07)])
def test_bars_too_narrow_become_true_by_a_report(judged, tmp_path, method, off):
    """Bars of sequences have a share of those of images, which limbs narrow."""
    narrow, inside = judged(method, bar_scale=0.05)
    assert inside == pytest.approx(0.9, abs=off)  # by hidden landmarks alone
    path = (tmp_path / "report/error_bars.json").rename(tmp_path / "rig.json")
    wide, inside = judged(method, bar_scale=0.05, calibration=path)
    factor = json.loads(path.read_text(encoding="utf-8"))[method]["90%"]
    np.testing.assert_allclose(wide.as_columns(), narrow.as_columns(), rtol=1e-6)
    np.testing.assert_allclose(wide.shape_sd, factor * narrow.shape_sd, rtol=1e-5)
    assert inside == pytest.approx(0.9, abs=0.01)


@pytest.mark.parametrize(
    "text",
    [
        "{",
        '{"posterior": {"90%": -2}}',
        '{"posterior": {"50%": 1, "90%": null}}',
        '{"a": {"50%": 1, "90%": 2}, "b": {"50%": 1, "90%": 2}}',
    ],
)
def test_a_file_without_factors_is_refused(people, tmp_path, text):
    path = tmp_path / "rig.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match="no factors of error bars of posterior"):
        fitted(
            people, people / "views.h5", method="posterior", prior={"calibration": path}
        )


def test_lengths_of_other_bodies_leave_the_size_free(people, rng):
    dictionary = read_dictionary(people / "dictionary.h5")
    e = len(dictionary.edges)
    A = rng.standard_normal((e, e))
    known = find_usual_lengths(replace(dictionary, edge_covariance=A @ A.T + np.eye(e)))
    names = [
        [dictionary.landmark_names[end][1:] for end in edge]
        for edge in dictionary.edges
    ]
    limbs = [set(joints) in LIMB_ENDS for joints in names]
    assert 2 < sum(limbs) < e
    np.testing.assert_allclose(known.precision @ np.ones(e), 0, atol=1e-12)
    np.testing.assert_array_equal(known.precision[~np.array(limbs)], 0)
    assert np.linalg.eigvalsh(known.precision[np.ix_(limbs, limbs)])[1] > 1e-3
    np.testing.assert_array_equal(
        known.usual, np.where(limbs, dictionary.edge_length, np.nan)
    )
    assert find_usual_lengths(replace(dictionary, edge_covariance=None)) is None


@pytest.fixture(scope="module")
def walk(people):
    """Images of one sequence of 36 frames at 24 Hz, and the truth that they show."""
    images = load(people / "all.h5")
    first = np.flatnonzero(np.array(images.sequences) == images.sequences[0])[:36]
    return images.take(first).replaced(frame_rate=24.0)


def at_frames(images, frames):
    return put(images, {"frame": np.asarray(frames)})


def lifted(people, folder, images, name="clip.h5", **keys):
    return fitted(people, written(folder / name, images), **keys)[0]


@pytest.mark.parametrize(("gap", "rate"), [(8, 24), (60, 24), (20, 60)])
def test_stretches_on_both_sides_of_a_long_gap_are_lifted_apart(
    people, walk, tmp_path, gap, rate
):
    """But for lengths and size, which they have together."""
    given = walk.replaced(frame_rate=float(rate))
    frames = np.arange(36) + np.where(np.arange(36) < 16, 0, gap - 1)
    together = lifted(people, tmp_path, at_frames(given, frames))
    joined = lifted(people, tmp_path, given)
    parts = [given.take(slice(0, 16)), given.take(slice(16, 36))]
    alone = [lifted(people, tmp_path, part).as_columns() for part in parts]
    unit = np.median(together.scale)
    away = np.abs(np.concatenate(alone) - together.as_columns()) / unit
    assert away.mean() < 0.006
    assert away.max() < 0.1
    over_gap = np.abs(np.concatenate(alone) - joined.as_columns()) / unit
    assert over_gap[14:18].mean() > 1.5 * away[14:18].mean()


def test_frames_without_a_gap_change_no_bit(people, walk, tmp_path):
    plain = lifted(people, tmp_path, walk)
    numbered = lifted(people, tmp_path, at_frames(walk, 100 + np.arange(36)))
    timed = put(walk, {"time": np.round(7 + np.arange(36) / 24, 2)})
    timed = lifted(people, tmp_path, at_frames(timed, np.arange(36)))
    for found in (numbered, timed):
        np.testing.assert_array_equal(found.shapes, plain.shapes)
        np.testing.assert_array_equal(found.shape_sd, plain.shape_sd)
    assert numbered.frames.tolist() == [*range(100, 136)]
    assert timed.times[1] == 7.04
    assert plain.frames is None


def test_images_are_lifted_in_order_of_their_frames(people, walk, tmp_path, rng):
    order = rng.permutation(36)
    frames = np.arange(36) * 3 // 2
    plain = lifted(people, tmp_path, at_frames(walk, frames))
    mixed = lifted(people, tmp_path, at_frames(walk, frames).take(order))
    assert mixed.items == plain.items
    np.testing.assert_array_equal(mixed.shapes, plain.shapes)


@pytest.mark.parametrize("share", [0.1, 0.2, 0.4])
def test_every_frame_is_refined_though_neighbours_are_missing(
    people, walk, tmp_path, share
):
    rows = np.flatnonzero(np.random.default_rng(1).random(36) >= share)
    found = lifted(people, tmp_path, at_frames(walk.take(rows), rows))
    assert np.isfinite(found.column("sequence_noise")).all()


def test_frames_alone_between_long_gaps_have_the_lengths_of_the_sequence(
    people, walk, tmp_path
):
    rows = np.r_[0:16, 26, 36 - 1]
    found = lifted(people, tmp_path, at_frames(walk.take(rows), rows))
    assert np.isfinite(found.column("sequence_noise")).all()
    i, j = read_dictionary(people / "dictionary.h5").edges.T
    single = lifted(people, tmp_path, walk.take(rows), method="posterior")
    spread = []
    for result in (found, single):
        bones = result.as_columns()[:, :, i] - result.as_columns()[:, :, j]
        share = np.linalg.norm(bones, axis=1)
        share /= share.sum(axis=1, keepdims=True)
        spread.append(np.abs(share[16:] - np.median(share[:16], axis=0)).mean())
    assert spread[0] < 0.3 * spread[1]


@pytest.mark.parametrize(("one", "other"), [(7, 7), (9, 4)])
def test_two_images_of_one_frame_are_refused(people, walk, one, other):
    images = at_frames(walk.take([0, 1]), [one, other])
    fault = f"is of the frame {one}, and then '{images.items[1]}' of {other}"
    with pytest.raises(InputError, match=fault):
        list(whole_sequences([images]))
    apart = images.replaced(sequences=("a", "b"))
    assert sum(map(len, whole_sequences([apart]))) == 2


def frames_of(names):
    n = len(names)
    return Landmarks(
        np.arange(6.0 * n).reshape(n, 2, 3).swapaxes(1, 2),
        landmark_names=("a", "b", "c"),
        items=tuple(f"image{i}" for i in range(n)),
        sequences=tuple(names),
    )


@pytest.mark.parametrize("size", [1, 2, 3, 5, 100])
@pytest.mark.parametrize(
    "names", ["aaabbbbcd", "a", "aaaaaaa", "abcdefgh", "aabbcc", ""]
)
def test_no_run_is_divided_and_nothing_lost(names, size):
    whole = frames_of(names)
    chunks = [
        whole.take(slice(at, at + size)) for at in range(0, max(len(names), 1), size)
    ]
    parts = list(whole_sequences(chunks))
    assert [item for part in parts for item in part.items] == list(whole.items)
    np.testing.assert_array_equal(
        np.concatenate([p.landmarks for p in parts]), whole.landmarks
    )
    for before, after in pairwise(parts):
        assert before.sequences[-1] != after.sequences[0]
    assert all(len(part) < size + 8 for part in parts)


def test_ended_sequences_are_given_out_before_the_stream_ends():
    def stream():
        yield frames_of("aab")
        yield frames_of("bbc")
        raise AssertionError("read too far")

    assert next(whole_sequences(stream())).sequences == ("a", "a")


@pytest.mark.parametrize(
    "names", ["", "aab", "aaaaaaaaab", "aaabbbbbbbbbcc", "abcdefgh"]
)
def test_long_sequences_are_lifted_in_the_pieces_that_are_refined(names, monkeypatch):
    for module in ("lifting.sequences.clips", "pipelines.fit.whole_sequences"):
        monkeypatch.setattr(f"shapefit.{module}.MAX_CLIP_FRAMES", 4)
    whole = frames_of(names)
    pieces = list(whole_sequences([whole]))
    assert [item for piece in pieces for item in piece.items] == list(whole.items)
    ends = np.cumsum([len(piece) for piece in pieces])
    assert set(ends) <= {clip.stop for clip in clips.split_into_clips(tuple(names))} | {
        0
    }
    sizes = [len(piece) for piece in pieces]
    assert all(a + b > 4 for a, b in pairwise(sizes[:-1]))
    assert max(sizes) <= 4


def test_exchanged_frames_are_put_back_with_their_scores(rng):
    t, partner = 60, np.array([1, 0, 3, 2, 5, 4, 7, 6])
    left = rng.normal(size=(2, 4)) + np.array([[3.0], [0.0]])
    w = np.stack([left, -left], axis=2).reshape(2, 8)
    w = w + 0.1 * np.sin(np.arange(t) / 5)[:, None, None]
    score = np.tile(np.linspace(0.2, 0.9, 8), (t, 1))
    items = tuple(map(str, range(t)))
    clean = Landmarks(
        w.swapaxes(1, 2),
        landmark_names=tuple("abcdefgh"),
        items=items,
        sequences=("walk",) * t,
        confidence=score,
    )
    dictionary = SimpleNamespace(mirror_index=partner)

    def restore(wrong):
        landmarks = np.where(wrong[:, None, None], w[..., partner], w)
        confidence = np.where(wrong[:, None], score[:, partner], score)
        images = clean.replaced(
            landmarks=landmarks.swapaxes(1, 2), confidence=confidence
        )
        return restore_sides(images, np.ones((t, 8), bool), dictionary, None)

    wrong = np.isin(np.arange(t), range(20, 28))
    images, exchanged = restore(wrong)
    np.testing.assert_array_equal(exchanged, wrong)
    np.testing.assert_array_equal(images.as_columns(), w)
    np.testing.assert_array_equal(images.confidence, score)
    assert np.isnan(restore(np.arange(t) >= 30)[1]).all()


@pytest.mark.slow
def test_a_dog_that_walks_in_a_curve_is_no_worse_than_its_images(project):
    """Its scale in the image changes by a third."""
    folder = project / "sample_data"
    truth = shapefit.read_shapes(folder / "animal_truth.h5")
    images = shapefit.read_landmarks(folder / "animal_walk.csv")
    dog = shapefit.learn(
        shapefit.read_shapes(folder / "animal_train.h5"), prior={"components": "auto"}
    )
    keys = {"min_confidence": 0.6, "frame_rate": 25, "image_size": (1280, 720)}
    single, whole = (
        shapefit.evaluate(shapefit.fit(images, dog, method=method, **keys), truth).mean(
            "similarity"
        )
        for method in ("posterior", "sequences")
    )
    assert whole < single


@pytest.mark.parametrize(
    ("unseen", "hidden"),
    [
        (("lhip", "rhip"), True),
        (("lhip",), False),
        (("lknee", "rknee", "lankle", "rankle"), False),
        ((), False),
    ],
)
def test_people_without_a_hip_are_not_refined(unseen, hidden):
    people = read_dictionary(find_dictionaries()["people"])
    shown = np.array([name not in unseen for name in people.landmark_names])
    assert hides_the_hips(people, shown) == hidden
    animal = replace(
        people, landmark_names=tuple(f"{n}_x" for n in people.landmark_names)
    )
    assert not hides_the_hips(animal, shown)
    assert not hides_the_hips(people, None)


def test_a_clip_without_hips_is_its_single_images(people, tmp_path):
    """The refined clip would differ by far more."""
    images = load(people / "views.h5").take(slice(0, 40))
    lower = [
        name for name in images.landmark_names if name[1:] in ("hip", "knee", "ankle")
    ]
    rows = [images.landmark_names.index(name) for name in (*lower, "pelvis")]
    landmarks = images.as_columns().copy()
    landmarks[..., rows] = np.nan
    half = images.replaced(landmarks=landmarks.swapaxes(1, 2), sequences=("a",) * 40)
    path = written(tmp_path / "half.h5", half)
    prior = {"residual_variance": 0.01, "bar_scale": 1.5}
    single, _ = fitted(people, path, method="posterior", prior=prior)
    whole, _ = fitted(people, path, prior=prior)
    assert np.isnan(whole.column("sequence_noise")).all()
    np.testing.assert_allclose(
        whole.as_columns(), single.as_columns(), rtol=1e-5, atol=1e-8
    )
