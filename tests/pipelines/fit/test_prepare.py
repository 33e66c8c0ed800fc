"""What is found before lifting: method, names, camera and, of one sample, what is
open.
"""

import json
import re
from dataclasses import replace

import h5py
import numpy as np
import pytest
from shapefit.cli.main import run as shapefit

from shapefit.config import FitConfig, load_config
from shapefit.config.paths import ResultFolder, find_dictionaries
from shapefit.dictionary.mixture import Mixture
from shapefit.dictionary.model import Dictionary
from shapefit.errors import InputError
from shapefit.geometry.rotations import random_rotations, rotation_about
from shapefit.io import (
    read_dictionary,
    write_dictionary,
)
from shapefit.io.skeletons import THETA, installed_skeletons, people_parts
from shapefit.lifting import trust
from shapefit.lifting.methods import METHODS
from shapefit.lifting.posterior.p_value import with_p_value_table
from shapefit.pipelines import joints
from shapefit.pipelines.fit import atoms, calibration, choices, posterior, sample
from shapefit.pipelines.fit.calibration import SAMPLE_POOL, calibrate
from shapefit.pipelines.fit.choices import (
    MIN_SEQUENCE_FRAMES,
    choose_method,
    in_sequences,
    match_to_dictionary,
    warn_of_dictionary,
)
from shapefit.pipelines.fit.evidence import choose_factors, maximise_theta, mean_gain
from shapefit.pipelines.fit.fit import fit as run
from shapefit.pipelines.fit.image_posterior import ImagePosterior
from shapefit.pipelines.fit.sample import MAX_SAMPLE, Shares, draw_sample
from shapefit.pipelines.partition.run import fit_parts as run_parts
from shapefit.records import Landmarks
from tests.io.files import save
from tests.pipelines.fitted import fit_images, texts


@pytest.fixture
def chosen(tmp_path):
    """The config of a fit of images of these sequences, and the line about its
    method.
    """

    def find(sequences, dictionary="people", overrides=()):
        n = len(sequences or "12")
        images = Landmarks(
            np.zeros((n, 2, 4)).swapaxes(1, 2),
            landmark_names=tuple("abcd"),
            items=tuple(map(str, range(n))),
            sequences=sequences,
        )
        save(tmp_path / "images.h5", images)
        files = {
            "landmarks": str(tmp_path / "images.h5"),
            "dictionary": str(dictionary),
        }
        files["output"] = str(tmp_path / "result.h5")
        config = load_config("fit", None, overrides, files)
        return choose_method(
            config, read_dictionary(config.dictionary), lambda: in_sequences(config)
        )

    return find


@pytest.mark.parametrize(
    ("sequences", "method"),
    [
        (None, "posterior"),
        (("a",) * MIN_SEQUENCE_FRAMES, "sequences"),
        (("a",) * (MIN_SEQUENCE_FRAMES - 1), "posterior"),
        (("a",) * MIN_SEQUENCE_FRAMES + tuple("bcdefghij"), "sequences"),
        (("a",) * MIN_SEQUENCE_FRAMES + tuple("bcdefghijklm"), "posterior"),
    ],
)
def test_half_of_the_images_decide_whether_there_are_sequences(
    chosen, sequences, method
):
    config, line = chosen(sequences)
    assert config.method == method
    assert line == f"{method} (the dictionary has a prior; change with --method)"


@pytest.mark.parametrize(
    ("overrides", "method", "residual_variance"),
    [
        (["method=sequences"], "sequences", 0.01),
        (["method=posterior", "prior.residual_variance=0.3"], "posterior", 0.3),
        (["method=convex"], "convex", None),
        (["outliers=l1"], "convex", None),
        (["leave_one_out=item"], "convex", None),
        (["prior.scale=2"], "sequences", 0.01),
    ],
)
def test_the_method_has_what_the_config_asks_for(
    chosen, overrides, method, residual_variance
):
    config, _ = chosen(("a",) * MIN_SEQUENCE_FRAMES, overrides=overrides)
    assert config.method == method
    assert config.prior.residual_variance == residual_variance


def test_other_dictionaries_have_their_own_variance_or_no_prior(chosen, tmp_path):
    people = read_dictionary(find_dictionaries()["people"])
    retained = {key: text for key, text in people.provenance.items() if key != "suits"}
    own_people = replace(people, provenance=retained)
    write_dictionary(tmp_path / "own.h5", own_people)
    config, _ = chosen(None, tmp_path / "own.h5")
    assert config.method == "posterior"
    assert config.prior.residual_variance == 0.006
    write_dictionary(tmp_path / "animal.h5", replace(own_people, edge_length=None))
    config, _ = chosen(None, tmp_path / "animal.h5")
    assert config.method == "posterior"
    assert config.prior.residual_variance is None
    write_dictionary(
        tmp_path / "atoms.h5", replace(people, prior=None, p_value_table=None)
    )
    assert chosen(None, tmp_path / "atoms.h5")[0].method == "convex"
    with pytest.raises(
        InputError, match=r"the method convex has no prior; `prior\.scale` needs"
    ):
        chosen(None, tmp_path / "atoms.h5", ["prior.scale=2"])


def test_auto_is_no_method_with_starts(chosen):
    with pytest.raises(InputError, match="does not support `starts`; use"):
        chosen(None, overrides=["starts=1"])


@pytest.mark.parametrize(
    ("learned", "method", "made_for"),
    [
        ("pca-bases", "convex", "sparse-coding or exemplars"),
        ("pca-bases", "alternate", "sparse-coding or exemplars"),
        ("sparse-coding", "pmp", "pca-bases"),
        ("exemplars", "pmp", "pca-bases"),
        ("pca-bases", "pmp", None),
        ("pca-bases", "mean-shape", None),
        ("sparse-coding", "convex+refine", None),
        ("exemplars", "convex", None),
        (None, "pmp", None),
    ],
)
def test_bases_belong_to_pmp_and_atoms_to_the_others(learned, method, made_for):
    provenance = {} if learned is None else {"method": learned}
    dictionary = Dictionary(
        np.ones((1, 3, 2)), ("a", "b"), np.ones((3, 2)), provenance=provenance
    )
    warnings = warn_of_dictionary(FitConfig.model_construct(method=method), dictionary)
    text = (
        f"the dictionary was learned with `method: {learned}`; {method} is made for"
        f" {made_for}"
    )
    assert warnings == ((text,) if made_for else ())


@pytest.mark.parametrize(("method", "told"), [("convex", True), ("alternate", False)])
@pytest.mark.parametrize("thickness", [0.0, 0.002, 0.3])
def test_flat_dictionaries_are_said(rng, method, told, thickness):
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    shapes = turn @ (rng.normal(size=(6, 3, 8)) * [[1], [1], [thickness]])
    dictionary = Dictionary(shapes, tuple("abcdefgh"), shapes[0])
    warnings = warn_of_dictionary(FitConfig.model_construct(method=method), dictionary)
    flat = [text for text in warnings if "are flat" in text]
    assert len(flat) == (told and thickness < 0.01)


@pytest.mark.parametrize(("factor", "told"), [(300, 1), (1e-3, 1), (1, 0), (0.2, 0)])
@pytest.mark.parametrize("method", ["convex", "alternate", "mean-shape"])
def test_atoms_of_another_size_are_said(rng, factor, told, method):
    shapes = factor * rng.normal(size=(6, 3, 8))
    dictionary = Dictionary(shapes, tuple("abcdefgh"), shapes[0])
    warnings = warn_of_dictionary(FitConfig.model_construct(method=method), dictionary)
    size = [text for text in warnings if "lambda is meant for" in text]
    assert len(size) == (told if METHODS[method].mixes_atoms else 0)


def test_pmp_refuses_a_dictionary_whose_limbs_have_no_length(fit, dictionary, images):
    plain = read_dictionary(dictionary)
    edges = np.array([[0, 0], [2, 2]])
    write_dictionary(dictionary, replace(plain, edges=edges))
    with pytest.raises(
        InputError, match="length 0: the limbs whose lengths pmp keeps; learn it"
    ):
        fit(dictionary, images, method="pmp")


@pytest.fixture(scope="module")
def halves(tmp_path_factory):
    """Two files and one of both, of which the second half reaches out.

    Bodies of the dictionary of people, y down, whose hips are further apart than the
    joints.
    """
    people = read_dictionary(find_dictionaries()["people"]).marked(())
    rng = np.random.default_rng(3)
    parts = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
    names = [f"{side}{part}" for part in parts for side in "lr"]
    columns, hips = [people.landmark_names.index(name) for name in names], [6, 7]
    turns = rotation_about(np.array([0.0, 1, 0]), rng.uniform(0, 2 * np.pi, 40))
    shapes = people.prior.means[rng.integers(len(people.prior.means), size=40)][
        ..., columns
    ]
    shapes = np.diag([1.0, -1, -1]) @ turns @ shapes + np.array([0, 0, 20.0])[:, None]
    shapes[..., hips] += 0.15 * (
        shapes[..., hips] - shapes[..., hips].mean(axis=2, keepdims=True)
    )
    points = 2100 * shapes[:, :2] / shapes[:, 2:] + np.array([960.0, 540])[:, None]
    points += 2 * rng.standard_normal(points.shape)
    points[:, 0] += np.linspace(-300, 300, 40)[:, None]
    sides = {"l": "left", "r": "right"}
    detected = tuple(f"{sides[name[0]]}_{name[1:]}" for name in names)
    images = Landmarks(
        points.swapaxes(1, 2),
        landmark_names=detected,
        items=tuple(f"{i:03}" for i in range(40)),
        unit="px",
    )
    folder = tmp_path_factory.mktemp("halves")
    for name, rows in (("a", slice(17)), ("b", slice(17, None))):
        save(folder / f"{name}.h5", images.take(rows))
    save(folder / "both.h5", images)
    fit([folder / "both.h5"], folder / "result.h5")
    return folder


def fit(landmarks, output, **keys):
    config = {
        "landmarks": list(map(str, landmarks)),
        "dictionary": "people",
        "output": output,
    }
    config = FitConfig(**config, **{"method": "posterior"} | keys)
    return list((run_parts if isinstance(output, ResultFolder) else run)(config))


def shapes_in(path):
    files = sorted(path.glob("part-*")) if path.is_dir() else [path]
    shapes = []
    for file in files:
        with h5py.File(file) as result:
            shapes.append(result["shapes"][:])
    return np.concatenate(shapes)


@pytest.mark.parametrize(
    ("names", "keys"),
    [("a b", {}), ("a b", {"workers": 2}), ("both", {"partition": 1})],
)
def test_files_and_parts_are_the_same_bits(halves, tmp_path, names, keys):
    inputs = [halves / f"{name}.h5" for name in names.split()]
    written = tmp_path / ("parts" if keys else "one.h5")
    results = fit(inputs, ResultFolder(written, **keys) if keys else written)
    told = [result for result in results if result.line.startswith("camera:")]
    assert len(told) == bool(keys)  # of all parts once
    np.testing.assert_array_equal(shapes_in(written), shapes_in(halves / "result.h5"))


def test_the_manifest_holds_what_was_estimated_and_a_later_run_takes_it(
    halves, tmp_path
):
    inputs, parts = [halves / "a.h5", halves / "b.h5"], tmp_path / "parts"
    fit(inputs[:1], ResultFolder(parts, 1))
    first = {path.name: path.read_bytes() for path in parts.glob("part-*")}
    fit(inputs, ResultFolder(parts, 1))
    assert first == {name: (parts / name).read_bytes() for name in first}
    values = json.loads((parts / "manifest.jsonl").read_text().splitlines()[0])[
        "estimated"
    ]
    assert {"camera", "skeleton", "prior_scale"} <= values.keys()


P, IMAGES = 12, 60
NAMES = tuple(f"point{j}" for j in range(P))
RESIDUAL_VARIANCE = 0.002


@pytest.fixture(scope="module")
def planted(tmp_path_factory):
    """A dictionary with one Gaussian, and what draws images whose truth is as wide as
    stated.
    """
    rng = np.random.default_rng(5)
    mean = rng.normal(size=(3, P))
    root = 0.12 * rng.normal(size=(3 * P, 8)) / np.sqrt(8)
    C = root @ root.T * 8 / 3 + 1e-3 * np.eye(3 * P)
    prior = Mixture(np.ones(1), mean[None], C[None])
    path = tmp_path_factory.mktemp("sample") / "dictionary.h5"
    made = with_p_value_table(
        Dictionary(
            mean[None] / 4,
            NAMES,
            mean,
            prior=prior,
            residual_variance=np.array([RESIDUAL_VARIANCE]),
        )
    )
    write_dictionary(path, made)

    def draw(scale, residual_variance, wrong=None, error=3.0):
        x = np.linalg.cholesky(scale * C) @ rng.normal(size=(3 * P, IMAGES))
        shapes = random_rotations(IMAGES, rng) @ (mean + x.T.reshape(IMAGES, 3, P))
        w = shapes[:, :2] + np.sqrt(residual_variance) * rng.normal(size=(IMAGES, 2, P))
        if wrong is not None:
            w[:, :, wrong] += error * rng.normal(size=(IMAGES, 2))
        items = tuple(f"image{i}" for i in range(IMAGES))
        images = Landmarks((100 * w).swapaxes(1, 2), landmark_names=NAMES, items=items)
        return images, 100 * shapes

    return path, made, draw


KEYS = {"method": "posterior", "camera": {"focal": "none"}}


def estimate(planted, images, **prior):
    path, made, _ = planted
    keys = {"landmarks": [str(path)], "dictionary": str(path), "output": "result.h5"}
    config = FitConfig(**keys, **KEYS, prior=prior)
    match = match_to_dictionary(config, made, images.landmark_names)
    first = images.take(slice(0, SAMPLE_POOL))
    steps = calibrate(config, match, first, len(images))
    with pytest.raises(StopIteration) as end:
        next(steps)
    found = end.value.value
    return found, found.keys_of(config)["prior"]


@pytest.mark.parametrize(
    ("scale", "variance", "given", "expected"),
    [
        (1, RESIDUAL_VARIANCE, {}, (1, RESIDUAL_VARIANCE)),
        (4, RESIDUAL_VARIANCE, {}, (4, RESIDUAL_VARIANCE)),
        (1, 8 * RESIDUAL_VARIANCE, {}, (1, 8 * RESIDUAL_VARIANCE)),
        (4, 8 * RESIDUAL_VARIANCE, {}, (4, 8 * RESIDUAL_VARIANCE)),
        # landmarks more exact than the residual variance of the dictionary keep it
        (1, RESIDUAL_VARIANCE / 20, {}, (1, RESIDUAL_VARIANCE)),
        (
            4,
            8 * RESIDUAL_VARIANCE,
            {"scale": 1.5, "residual_variance": 0.1},
            (1.5, 0.1),
        ),
    ],
)
def test_the_factors_that_images_have_are_found(
    planted, scale, variance, given, expected
):
    found, keys = estimate(planted, planted[2](scale, variance)[0], **given)
    assert (keys["scale"], keys["residual_variance"]) == pytest.approx(expected)
    changed = not given and expected != (1, RESIDUAL_VARIANCE)
    assert (
        any("prior widened" in text or "residual var" in text for text in found.lines)
        == changed
    )


def test_a_landmark_that_is_mostly_wrong_does_not_make_the_others_less_exact(planted):
    _, keys = estimate(planted, planted[2](1, RESIDUAL_VARIANCE, wrong=3)[0])
    assert keys["scale"] == 1
    assert keys["residual_variance"] == RESIDUAL_VARIANCE


@pytest.mark.parametrize("shares", [(0.09, 0.26), (0.11, 0.26), (0.09, 0.24)])
def test_less_than_a_tenth_trusted_and_more_than_a_quarter_doubtful_is_told(
    planted, monkeypatch, shares
):
    monkeypatch.setattr(sample, "judge_shares", lambda *given: Shares(*shares))
    images, given = planted[2](1, RESIDUAL_VARIANCE)[0].take(slice(20)), {"scale": 1.0}
    found, _ = estimate(planted, images, **given, residual_variance=RESIDUAL_VARIANCE)
    assert bool(found.warnings) == bool(found.reason) == (shares == (0.09, 0.26))


def test_a_landmark_that_is_mostly_wrong_is_named(planted, tmp_path):
    images, _ = planted[2](
        1, RESIDUAL_VARIANCE, wrong=3, error=1.5
    )  # of the size of the shape
    _, outcomes = fit_images(tmp_path, images, planted[0], **KEYS)
    (told,) = [each for each in texts(outcomes) if "contradicts the model" in each]
    assert int(told.split()[0]) > 45
    assert "in which point3 contradicts" in told


def test_of_pairs_as_likely_the_widest_is_taken_with_the_least_variance():
    noise = np.random.default_rng(0).normal(size=(4, 100))
    noise -= noise.mean(axis=1, keepdims=True)
    of = {
        (1.0, 1.0): -10 + noise[0],
        (2.0, 1.0): -5.05 + noise[1],
        (2.0, 2.0): -5 + noise[2],
        (1.0, 2.0): -7 + noise[3],
    }
    images = Landmarks(
        np.zeros((100, P, 2)),
        landmark_names=NAMES,
        items=tuple(map(str, range(100))),
    )
    found = choose_factors(
        lambda pair, some: of[pair][: len(some)], images, (1.0, 2.0), (1.0, 2.0)
    )
    assert found == (2, 1)


@pytest.mark.parametrize("best", [(1.0, 1.0), (2.0, 1.0), (1.0, 2.0), (8.0, 2.0)])
def test_a_wider_prior_or_a_larger_variance_alone_makes_all_pairs_be_tried(best):
    images = Landmarks(
        np.zeros((30, 2, P)).swapaxes(1, 2),
        landmark_names=NAMES,
        items=tuple(map(str, range(30))),
    )

    def evidence(pair, some):
        return np.full(len(some), -np.abs(np.log2(pair) - np.log2(best)).sum())

    assert choose_factors(evidence, images) == best
    tried = (1, 2, 3)
    first = choose_factors(
        lambda pair, some: pair.count(3) * np.ones(len(some)), images, tried, tried
    )
    assert first == (1, 1)  # as the next ones are no likelier


SHARP = 1e4
NAME = next(iter(THETA))


@pytest.mark.parametrize("top", [-0.19, -0.12, 0.0, 0.07, 0.16, 0.21])
def test_a_top_within_the_steps_is_found(top):
    at = np.log(THETA[NAME].mean) + top

    def evidence(theta):
        return -0.5 * SHARP * (np.log(theta[NAME]) - at) ** 2

    theta = maximise_theta(evidence, [NAME], {NAME: THETA[NAME].mean})
    whole = SHARP + THETA[NAME].std ** -2
    expected = (SHARP * at + np.log(THETA[NAME].mean) * THETA[NAME].std ** -2) / whole
    assert np.log(theta[NAME]) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(("rate", "apart"), [(None, 12), (50.0, 25), (0.5, 1)])
@pytest.mark.parametrize("n", [MAX_SAMPLE, 3 * MAX_SAMPLE])
def test_a_sample_is_bounded_and_of_sequences_has_pairs_that_are_a_step_apart(
    planted, n, rate, apart
):
    points = np.random.default_rng(1).random((n, 2, P))
    items = tuple(map(str, range(n)))
    images = Landmarks(
        points.swapaxes(1, 2),
        landmark_names=NAMES,
        items=items,
        sequences=("walk",) * n,
        frame_rate=rate,
    )
    every = ImagePosterior(dictionary=planted[1])
    rows = np.array(draw_sample(images, every).items, int)
    assert MAX_SAMPLE // 2 <= len(rows) <= MAX_SAMPLE
    assert len(np.intersect1d(rows + apart, rows)) >= 40
    single = np.array(draw_sample(images.replaced(sequences=None), every).items, int)
    assert len(single) == MAX_SAMPLE
    assert len(np.unique(np.diff(single))) <= 2
    points[0, :, 5:] = points[1, :, 4:] = np.nan  # four landmarks fit almost any shape
    some = images.replaced(landmarks=points.swapaxes(1, 2)).take([0, 1])
    assert draw_sample(some, every).items == ("0",)


def test_names_camera_and_sample_are_found_once(planted, tmp_path, monkeypatch):
    calls = []
    for module, name in (
        (joints, "find_joints"),
        (choices, "match_names"),
        (posterior, "settle_by_sample"),
        (calibration, "choose_camera"),
        (sample, "draw_sample"),
    ):
        real = getattr(module, name)

        def counted(*given, name=name, real=real, **keys):
            calls.append(name)
            return real(*given, **keys)

        monkeypatch.setattr(module, name, counted)
    fit_images(tmp_path, planted[2](2, RESIDUAL_VARIANCE)[0], planted[0], **KEYS)
    expected = [
        "choose_camera",
        "draw_sample",
        "find_joints",
        "match_names",
        "settle_by_sample",
    ]
    assert sorted(calls) == expected


def test_a_fit_that_takes_long_is_announced_before_it_begins(
    planted, tmp_path, monkeypatch
):
    clock = iter(range(0, 1000, 30))
    monkeypatch.setattr(atoms.time, "perf_counter", lambda: next(clock))
    monkeypatch.setattr(
        posterior, "SECONDS_PER_IMAGE", 600 / P**3.5
    )  # of one component: 110 minutes
    images = planted[2](1, RESIDUAL_VARIANCE)[0]
    for method, number, text in (
        ("convex", 60, "60 images may take up to 4 minutes, 3.8 s each: give"),
        ("convex", 1, "$"),
        ("posterior", 1, "1 image may take up to 110 minutes: give"),
    ):
        keys = KEYS | {"method": method}
        some = images.take(range(number))
        assert re.match(text, fit_images(tmp_path, some, planted[0], **keys)[1][0].line)


@pytest.mark.parametrize("people", [0, 1])
def test_nothing_that_could_be_seen_ends_with_1_and_without_warnings_of_numpy(
    tmp_path, recwarn, people
):
    """A detector that found nobody, and one that was sure of nobody."""
    for frame in range(6):
        body = {"pose_keypoints_2d": [300.0 + 9 * frame, 200.0, 0.05] * 25}
        text = json.dumps({"version": 1.3, "people": [body] * people})
        (tmp_path / f"f_{frame:04d}.json").write_text(text)
    assert shapefit(["fit", str(tmp_path), "-o", str(tmp_path / "o.h5"), "-q"]) == 1
    assert [
        str(each.message) for each in recwarn if each.category is RuntimeWarning
    ] == []


def test_the_error_of_a_gain_counts_that_neighbours_resemble_each_other(rng):
    gains = rng.standard_normal((400, 96))
    for t in range(1, 96):
        gains[:, t] = 0.7 * gains[:, t - 1] + np.sqrt(1 - 0.7**2) * gains[:, t]
    means, errors = zip(*(mean_gain(0 * gain, gain) for gain in gains), strict=True)
    assert 0.7 < np.sqrt(np.mean(np.square(errors))) / np.std(means) < 1.1


N, SIZE, FOCAL = 30, (1920, 1080), 2000.0
BODIES = 2.5
"""Distance of the camera in heights of a body, of 4.7 units of normalised shapes."""


@pytest.fixture(scope="module")
def poses():
    """Shapes (N, 3, 24) of the prior, y up, and the names of their landmarks."""
    people = read_dictionary(find_dictionaries()["people"])
    rng = np.random.default_rng(3)
    prior = people.prior
    chosen = rng.choice(len(prior), size=N, p=prior.weights)
    shapes = np.array(
        [
            rng.multivariate_normal(
                prior.means[k].ravel(), prior.covariances[k]
            ).reshape(3, -1)
            for k in chosen
        ]
    )
    return shapes, people.landmark_names


def film(poses, skeleton):
    """Return what a detector finds of upright bodies that face all ways, from 2.5
    heights away.
    """
    shapes, joints = poses
    theta = {name: parameter.mean for name, parameter in THETA.items()}
    parts = people_parts(installed_skeletons()[skeleton].landmark_names)
    rows = np.zeros((len(parts), len(joints)))
    for row, part in enumerate(parts.values()):
        for joint, weight in part.weights(theta).items():
            rows[row, joints.index(joint)] = weight
    rng = np.random.default_rng(4)
    turns = rotation_about(np.array([0.0, 1.0, 0.0]), rng.uniform(0, 2 * np.pi, N))
    visible = np.diag([1.0, -1.0, -1.0]) @ turns @ shapes @ rows.T
    visible[:, 2] += BODIES * 4.7
    pixels = FOCAL * visible[:, :2] / visible[:, 2:] + np.array(SIZE)[:, None] / 2
    return Landmarks(
        (pixels + rng.standard_normal(pixels.shape)).swapaxes(1, 2),
        landmark_names=installed_skeletons()[skeleton].landmark_names,
        items=tuple(f"image{i}" for i in range(N)),
        unit="px",
        y_axis="down",
        file_extras={"image_size": np.array(SIZE)},
    )


@pytest.fixture
def warnings_of(tmp_path):
    """Return what fits images by `people`: its warnings; with wrong names, none is
    trusted.
    """

    def warn(images):
        result, outcomes = fit_images(tmp_path, images, "people", method="posterior")
        warnings = texts(outcomes)
        assert result.column("trusted").any() != any(
            "is it " in text for text in warnings
        )
        return warnings

    return warn


@pytest.mark.parametrize(
    ("meant", "given"),
    [
        ("body_25b", "body_25"),
        pytest.param("body_25", "body_25b", marks=pytest.mark.slow),
    ],
)
def test_another_skeleton_of_as_many_landmarks_is_named(
    warnings_of, poses, meant, given
):
    images = film(poses, meant)
    assert not warnings_of(images)
    wrong = images.replaced(landmark_names=installed_skeletons()[given].landmark_names)
    (warning,) = [text for text in warnings_of(wrong) if "is it" in text]
    assert warning.startswith("no shape of this file is to be trusted")
    assert f"is it {meant}? Set `keypoints: {meant}`" in warning


def test_images_that_pass_by_chance_are_not_trusted(tmp_path, poses, monkeypatch):
    """Though landmarks that are hidden in turn would be predicted well."""
    contradicts = trust.contradicts
    monkeypatch.setattr(
        trust,
        "contradicts",
        lambda kappa, distance, *shares: contradicts(1.0, 0.1, *shares),
    )
    images = film(poses, "body_25")
    # As many landmarks as no other skeleton has.
    wrong = images.replaced(
        landmarks=images.as_columns()[..., :19].swapaxes(1, 2),
        landmark_names=images.landmark_names[1:20],
    )
    result, outcomes = fit_images(tmp_path, wrong, "people", method="posterior")
    assert not result.column("trusted").any()
    assert any(
        "% of a sample would be; are the names" in text for text in texts(outcomes)
    )


@pytest.mark.parametrize("angle", [0, 90, 180])
def test_people_on_their_heads_are_counted(warnings_of, poses, angle):
    images = film(poses, "body_25")
    centre = np.array(SIZE)[:, None] / 2
    c = np.cos(np.radians(angle))
    s = np.sin(np.radians(angle))
    turned = np.array([[c, -s], [s, c]]) @ (images.as_columns() - centre) + centre
    warnings = [
        text
        for text in warnings_of(images.replaced(landmarks=turned.swapaxes(1, 2)))
        if "heads" in text
    ]
    assert len(warnings) == (angle == 180)
    told = r"\d+ images with people on their heads: y was taken to point down"
    assert not warnings or re.match(told, warnings[0])


@pytest.mark.parametrize(
    ("factors", "stretched"),
    [
        ((1, 1), False),
        ((7, 7), False),
        ((0.5, 1), True),
        ((100 / SIZE[0], 100 / SIZE[1]), True),
    ],
)
def test_scales_of_x_and_y_that_differ_are_named(tmp_path, poses, factors, stretched):
    images = film(poses, "body_25")
    landmarks = images.as_columns() * np.array(factors)[:, None]
    other = replace_columns(images.replaced(landmarks=landmarks.swapaxes(1, 2)), {})
    result, outcomes = fit_images(tmp_path, other, "people", method="posterior")
    named = [text for text in texts(outcomes) if "x and y have different" in text]
    assert bool(named) == stretched
    assert result.column("trusted").any() != stretched
    if stretched:
        assert named[0].startswith("no shape of this file is to be trusted: people")
        assert "are these percent of the image" in named[0]


def test_landmarks_outside_the_stated_image_are_said(tmp_path, poses):
    images = film(poses, "body_25")
    small = replace_columns(images, {"image_size": np.array([640, 480])})
    _, outcomes = fit_images(tmp_path, small, "people", method="posterior")
    (warning,) = [text for text in texts(outcomes) if "outside" in text]
    assert "% of the landmarks lie outside the stated image of 640 x 480" in warning
    assert "--image-size WxH" in warning


def replace_columns(images, columns):
    """The same images with other datasets."""
    return Landmarks(
        images.points,
        landmark_names=images.landmark_names,
        items=images.items,
        unit=images.unit,
        y_axis=images.y_axis,
        file_extras=columns,
    )
