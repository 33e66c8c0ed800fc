"""What is found before lifting: the method, and estimates of all inputs, whatever the parts."""

import json
from dataclasses import replace

import h5py
import numpy as np
import pytest

from shapefit.config import FitConfig, load_config
from shapefit.config.paths import ResultFolder, find_dictionaries
from shapefit.dictionary.model import Dictionary
from shapefit.errors import InputError
from shapefit.geometry.rotations import rotation_about
from shapefit.io import LandmarkSet, read_dictionary, write_dictionary
from shapefit.io.skeletons import installed_skeletons
from shapefit.pipelines.fit.prepare import (
    FRAMES,
    choose_method,
    in_sequences,
    warn_of_dictionary,
)
from shapefit.pipelines.fit.run import run
from shapefit.pipelines.partition.run import run as run_parts
from tests.io.files import save


@pytest.fixture
def chosen(tmp_path):
    """The config of a fit of images of these sequences, and the line about its method."""

    def find(sequences, dictionary="people", overrides=()):
        n = len(sequences or "12")
        images = LandmarkSet(
            landmarks=np.zeros((n, 2, 4)),
            landmark_names=tuple("abcd"),
            items=tuple(map(str, range(n))),
            sequences=sequences,
        )
        save(tmp_path / "images.h5", images)
        files = {"landmarks": str(tmp_path / "images.h5"), "dictionary": str(dictionary)}
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
        (("a",) * FRAMES, "sequences"),
        (("a",) * (FRAMES - 1), "posterior"),
        (("a",) * FRAMES + tuple("bcdefghij"), "sequences"),
        (("a",) * FRAMES + tuple("bcdefghijklm"), "posterior"),
    ],
)
def test_half_of_the_images_decide_whether_there_are_sequences(chosen, sequences, method):
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
def test_the_method_has_what_the_config_asks_for(chosen, overrides, method, residual_variance):
    config, _ = chosen(("a",) * FRAMES, overrides=overrides)
    assert (config.method, config.prior.residual_variance) == (method, residual_variance)


def test_other_dictionaries_have_their_own_variance_or_no_prior(chosen, tmp_path):
    people = read_dictionary(find_dictionaries()["people"])
    retained = {key: text for key, text in people.provenance.items() if key != "suits"}
    write_dictionary(tmp_path / "own.h5", replace(people, provenance=retained))
    config, _ = chosen(None, tmp_path / "own.h5")
    assert (config.method, config.prior.residual_variance) == ("posterior", None)
    write_dictionary(tmp_path / "atoms.h5", replace(people, prior=None, p_value_table=None))
    assert chosen(None, tmp_path / "atoms.h5")[0].method == "convex"
    with pytest.raises(InputError, match=r"the method convex has no prior; `prior\.scale` needs"):
        chosen(None, tmp_path / "atoms.h5", ["prior.scale=2"])


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
    dictionary = Dictionary(np.ones((1, 3, 2)), ("a", "b"), np.ones((3, 2)), provenance=provenance)
    warnings = warn_of_dictionary(FitConfig.model_construct(method=method), dictionary)
    text = f"the dictionary was learned with `method: {learned}`; {method} is made for {made_for}"
    assert warnings == ((text,) if made_for else ())


def test_pmp_refuses_a_dictionary_whose_limbs_have_no_length(fit, dictionary, images):
    plain = read_dictionary(dictionary)
    edges = np.array([[0, 0], [2, 2]])
    write_dictionary(dictionary, replace(plain, edges=edges))
    with pytest.raises(InputError, match="length 0: the limbs whose lengths pmp keeps; learn it"):
        fit(dictionary, images, method="pmp")


@pytest.fixture(scope="module")
def halves(tmp_path_factory):
    """Two folders of OpenPose files and two files of HDF5, of which the second half reaches out.

    Bodies of the dictionary of people, y down, whose hips are further apart than the joints.
    """
    people, rng = (
        read_dictionary(find_dictionaries()["people"]).marked(()),
        np.random.default_rng(3),
    )
    parts = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
    names = [f"{side}{part}" for part in parts for side in "lr"]
    columns, hips = [people.landmark_names.index(name) for name in names], [6, 7]
    turns = rotation_about(np.array([0.0, 1, 0]), rng.uniform(0, 2 * np.pi, 40))
    shapes = people.prior.means[rng.integers(len(people.prior.means), size=40)][..., columns]
    shapes = np.diag([1.0, -1, -1]) @ turns @ shapes + np.array([0, 0, 20.0])[:, None]
    shapes[..., hips] += 0.15 * (shapes[..., hips] - shapes[..., hips].mean(axis=2, keepdims=True))
    points = 2100 * shapes[:, :2] / shapes[:, 2:] + np.array([960.0, 540])[:, None]
    points += 2 * rng.standard_normal(points.shape)
    points[:, 0] += np.linspace(-300, 300, 40)[:, None]
    sides = {"l": "left", "r": "right"}
    detected = tuple(f"{sides[name[0]]}_{name[1:]}" for name in names)
    images = LandmarkSet(points, detected, tuple(f"{i:03}" for i in range(40)), unit="px")
    folder = tmp_path_factory.mktemp("halves")
    for name, rows in (("a", slice(17)), ("b", slice(17, None))):
        write_openpose(folder / name, images.take(rows))
        save(folder / f"{name}.h5", images.take(rows))
    save(folder / "both.h5", images)
    fit([folder / "both.h5"], folder / "result.h5")
    return folder


def write_openpose(folder, images):
    """Write a JSON file a frame, BODY_25 with what it has of these landmarks."""
    names = [name.partition("_") for name in images.landmark_names]
    column = {f"{side[0].upper()}{part.title()}": j for j, (side, _, part) in enumerate(names)}
    folder.mkdir()
    for item, points in zip(images.items, images.landmarks, strict=True):
        flat = []
        for name in installed_skeletons()["body_25"].landmark_names:
            flat += [*points[:, column[name]].tolist(), 0.9] if name in column else [0, 0, 0]
        people = [{"person_id": [-1], "pose_keypoints_2d": flat}]
        path = folder / f"{folder.name}_{item}_keypoints.json"
        path.write_text(json.dumps({"version": 1.3, "people": people}))


def fit(landmarks, output, **keys):
    config = {"landmarks": list(map(str, landmarks)), "dictionary": "people", "output": output}
    config = FitConfig(**config, **{"method": "posterior"} | keys)
    return list((run_parts if isinstance(output, ResultFolder) else run)(config))


def shapes_in(path):
    files = sorted(path.glob("part-*")) if path.is_dir() else [path]
    shapes = []
    for file in files:
        with h5py.File(file) as result:
            shapes.append(result["shapes"][:])
    return np.concatenate(shapes)


def test_two_recordings_in_one_run_and_in_parts_are_the_same_bits(halves, tmp_path):
    inputs, keys = [halves / "a", halves / "b"], {"keypoints": "body_25"}
    fit(inputs, tmp_path / "one.h5", **keys)
    results = fit(inputs, ResultFolder(tmp_path / "parts", 10), **keys)
    assert len(list((tmp_path / "parts").glob("part-*"))) == 2
    np.testing.assert_array_equal(shapes_in(tmp_path / "parts"), shapes_in(tmp_path / "one.h5"))
    assert len([result for result in results if result.line.startswith("camera:")]) == 1


@pytest.mark.parametrize(
    ("names", "keys"), [("a b", {}), ("a b", {"workers": 2}), ("both", {"partition": 1})]
)
def test_files_and_parts_are_the_same_bits(halves, tmp_path, names, keys):
    inputs = [halves / f"{name}.h5" for name in names.split()]
    fit(inputs, ResultFolder(tmp_path / "parts", **keys) if keys else tmp_path / "one.h5")
    written = tmp_path / ("parts" if keys else "one.h5")
    np.testing.assert_array_equal(shapes_in(written), shapes_in(halves / "result.h5"))


def test_the_manifest_holds_what_was_estimated_and_a_later_run_takes_it(halves, tmp_path):
    inputs, parts = [halves / "a.h5", halves / "b.h5"], tmp_path / "parts"
    fit(inputs[:1], ResultFolder(parts, 1))
    first = {path.name: path.read_bytes() for path in parts.glob("part-*")}
    fit(inputs, ResultFolder(parts, 1))
    assert first == {name: (parts / name).read_bytes() for name in first}
    values = json.loads((parts / "manifest.jsonl").read_text().splitlines()[0])["estimated"]
    assert {"camera", "skeleton", "prior"} == values["values"].keys()
