"""A fit from an object store into one: the same bits as on a disk, resumed, and nothing half."""

from __future__ import annotations

import json
from pathlib import Path

import h5py
import numpy as np
import pytest

from shapefit.config import load_config
from shapefit.dictionary.model import Dictionary
from shapefit.errors import InputError
from shapefit.io import landmark_writer, write_dictionary
from shapefit.io.records import LandmarkSet
from shapefit.pipelines.parts.run import run
from shapefit.stores import lock

pytest.importorskip("s3fs")

NAMES = tuple("abcdefgh")
DATASETS = ("item", "shapes", "dual", "coefficients", "objective")


@pytest.fixture
def store(bucket, tmp_path, rng, monkeypatch):
    """A bucket with a dictionary and 300 images in two files, which are in this folder, too."""
    atoms = rng.normal(size=(6, 3, 8))
    atoms -= atoms.mean(axis=2, keepdims=True)
    monkeypatch.chdir(tmp_path)
    write_dictionary(Path("dict.h5"), Dictionary(atoms, NAMES, atoms[0]))
    points = rng.normal(size=(300, 2, 8))
    for name, rows in (("one", slice(0, 200)), ("two", slice(200, 300))):
        with landmark_writer(Path(f"{name}.h5")) as writer:
            items = tuple(f"i{n}" for n in range(300))[rows]
            writer.append(LandmarkSet(landmarks=points[rows], landmark_names=NAMES, items=items))
    for name in ("dict.h5", "one.h5", "two.h5"):
        bucket.files.put_file(name, f"{bucket.name}/{name}")
    return bucket


def fit(store, output: str = "", *overrides: str):
    """Fit the files of the bucket; return the outcomes."""
    arguments = {
        "landmarks": (f"{store.url}/one.h5", f"{store.url}/two.h5"),
        "dictionary": f"{store.url}/dict.h5",
        "output": output or f"{store.url}/results/",
    }
    return list(run(load_config("fit", None, ("partition=100", *overrides), arguments)))


def done(outcomes) -> int:
    return sum(outcome.done for outcome in outcomes)


def failures(outcomes) -> list:
    return [failure for outcome in outcomes for failure in outcome.failures]


def names(store) -> list[str]:
    return sorted(name.rpartition("/")[2] for name in store.files.find(f"{store.name}/results"))


def parts(count: int) -> list[str]:
    return ["manifest.json", *(f"part-{n:05}.h5" for n in range(count))]


def manifest(store) -> dict:
    return json.loads(store.files.cat_file(f"{store.name}/results/manifest.json"))


def datasets(store, *objects: str) -> dict[str, np.ndarray]:
    read = []
    for name in objects:
        with store.files.open(f"{store.name}/{name}") as file, h5py.File(file) as content:
            read.append({name: content[name][:] for name in DATASETS})
    return {name: np.concatenate([each[name] for each in read]) for name in DATASETS}


def same_as_on_a_disk(store) -> None:
    local = {"landmarks": ("one.h5", "two.h5"), "dictionary": "dict.h5", "output": "whole.h5"}
    list(run(load_config("fit", None, (), local)))
    found = datasets(store, *(f"results/{name}" for name in names(store) if name.endswith(".h5")))
    with h5py.File("whole.h5") as whole:
        for name in DATASETS:
            np.testing.assert_array_equal(found[name], whole[name][:])


def test_parts_have_the_bits_of_a_local_run(store):
    assert done(fit(store)) == 300
    assert names(store) == parts(3)
    assert manifest(store)["parts"][0]["inputs"] == [f"{store.url}/one.h5"]
    same_as_on_a_disk(store)


def test_one_file_to_the_store(store):
    assert done(fit(store, f"{store.url}/whole.h5")) == 300
    fit(store, "local.h5")
    found = datasets(store, "whole.h5")
    with h5py.File("local.h5") as local:
        for name in DATASETS:
            np.testing.assert_array_equal(found[name], local[name][:])


def test_only_what_is_missing_is_done(store):
    fit(store)
    assert done(fit(store)) == 0
    store.files.rm_file(f"{store.name}/results/part-00001.h5")
    assert done(fit(store)) == 72
    same_as_on_a_disk(store)


def test_an_input_with_another_etag_is_done_again(store):
    fit(store)
    with h5py.File("two.h5", "a") as file:
        file["landmarks"][0] += 1
    store.files.put_file("two.h5", f"{store.name}/two.h5")
    assert done(fit(store)) == 100
    same_as_on_a_disk(store)


def test_stale_parts_are_removed(store):
    fit(store)
    assert done(fit(store, "", "partition=200")) == 300
    assert names(store) == parts(2)


def test_a_second_client_is_refused(store):
    place = load_config_output(store).parent / ".lock"
    with lock.held_object(place) as held:
        assert held
        with pytest.raises(InputError, match="another run is writing results to it"):
            fit(store)
    assert done(fit(store)) == 300


def load_config_output(store) -> Path:
    arguments = {"landmarks": "one.h5", "dictionary": "dict.h5", "output": f"{store.url}/results/"}
    return load_config("fit", None, (), arguments).output
