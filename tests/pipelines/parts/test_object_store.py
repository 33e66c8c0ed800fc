"""A fit from an object store into one: the same bits as on a disk, resumed, and nothing half."""

import json
from io import BytesIO
from pathlib import Path

import h5py
import numpy as np
import pytest
from shapefit.cli.main import run as shapefit

from shapefit.config import load_config
from shapefit.config.paths import ResultFolder
from shapefit.errors import InputError
from shapefit.pipelines.fit.run import run as fit_whole
from shapefit.pipelines.parts.run import run
from shapefit.stores import held_object, location
from tests.pipelines.parts.made import make_dictionary, make_images
from tests.pipelines.told import done, failures

DATASETS = ("item", "shapes", "dual", "coefficients", "objective")


@pytest.fixture
def store(bucket, tmp_path, rng, monkeypatch):
    """A bucket with a dictionary and 300 images in two files, which are in this folder, too."""
    monkeypatch.chdir(tmp_path)
    make_dictionary(Path("dict.h5"), rng)
    points = rng.normal(size=(300, 2, 8))
    make_images("one.h5", points[:200])
    make_images("two.h5", points[200:], 200)
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
    in_parts = str(arguments["output"]).endswith("/")
    overrides = ("partition=100", *overrides) if in_parts else overrides
    config = load_config("fit", None, overrides, arguments)
    return list((run if isinstance(config.output, ResultFolder) else fit_whole)(config))


def names(store) -> list[str]:
    return sorted(name.rpartition("/")[2] for name in store.files.find(f"{store.name}/results"))


def entries(store) -> list[dict]:
    text = store.files.cat_file(f"{store.name}/results/manifest.jsonl")
    return list(map(json.loads, text.splitlines()[1:]))


def datasets(store, *objects: str) -> dict[str, np.ndarray]:
    read = []
    for name in objects:
        stored = BytesIO(store.files.cat_file(f"{store.name}/{name}"))
        with h5py.File(stored) as content:
            read.append({name: content[name][:] for name in DATASETS})
    return {name: np.concatenate([each[name] for each in read]) for name in DATASETS}


def same_as_on_a_disk(store) -> None:
    local = {"landmarks": ("one.h5", "two.h5"), "dictionary": "dict.h5", "output": "whole.h5"}
    list(fit_whole(load_config("fit", None, (), local)))
    found = datasets(store, *(f"results/{name}" for name in names(store) if name.endswith(".h5")))
    with h5py.File("whole.h5") as whole:
        for name in DATASETS:
            np.testing.assert_array_equal(found[name], whole[name][:])


def test_parts_have_the_bits_of_a_local_run(store):
    assert done(fit(store)) == 300
    assert names(store) == ["manifest.jsonl", *(f"part-{n:05}.h5" for n in range(3))]
    assert entries(store)[0]["inputs"] == [f"{store.url}/one.h5"]
    same_as_on_a_disk(store)


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


def test_a_second_client_is_refused(store):
    with held_object(location(f"{store.url}/results/.lock")) as held:
        assert held
        with pytest.raises(InputError, match="another run is writing results to it"):
            fit(store)
    assert done(fit(store)) == 300


class TestAPutThatFails:
    @pytest.fixture
    def puts(self, store, reopened, monkeypatch):
        """Let PUTs of these objects fail as often as is said; count them."""
        from s3fs import S3FileSystem

        real = S3FileSystem._put_file
        left: dict[str, int] = {}

        async def put(self, local, name, *arguments, **options):
            key = name.rpartition("/")[2]
            if left.get(key, 0):
                left[key] -= 1
                raise OSError(5, "We encountered an internal error")
            return await real(self, local, name, *arguments, **options)

        monkeypatch.setattr(S3FileSystem, "_put_file", put)
        return left

    def test_it_is_tried_again(self, store, puts):
        puts["part-00001.h5"] = 2
        outcomes = fit(store)
        assert failures(outcomes) == {}
        assert done(outcomes) == 300
        assert puts["part-00001.h5"] == 0

    def test_after_three_times_the_part_is_listed_and_the_others_are_done(self, store, puts):
        puts["part-00001.h5"] = 3
        ((part, reason),) = failures(fit(store)).items()
        assert part == "part-00001.h5"
        assert f"{store.url}/results/part-00001.h5: cannot be written" in reason
        assert names(store) == ["manifest.jsonl", "part-00000.h5", "part-00002.h5"]
        assert done(fit(store)) == 72
        same_as_on_a_disk(store)

    def test_an_earlier_result_stays(self, store, puts):
        fit(store, f"{store.url}/whole.h5")
        before = store.files.cat_file(f"{store.name}/whole.h5")
        puts["whole.h5"] = 1
        with pytest.raises(InputError, match=r"whole.h5: cannot be written .*internal error"):
            fit(store, f"{store.url}/whole.h5", "lambda=0.2")
        assert store.files.cat_file(f"{store.name}/whole.h5") == before


def test_the_folder_is_one_result(store, capsys):
    fit(store)
    fit(store, "whole.h5")
    folder = f"{store.url}/results/"
    for name, table in ((folder, "joined.csv"), ("whole.h5", "whole.csv")):
        assert shapefit(["convert", name, "-o", table, "-q"]) == 0
    assert Path("joined.csv").read_text() == Path("whole.csv").read_text()
    assert shapefit(["verify", folder, "-d", f"{store.url}/dict.h5", "-q"]) == 0
    assert shapefit(["view", folder, "-o", f"{store.url}/page.html", "-q"]) == 0
    assert store.files.size(f"{store.name}/page.html") > 10_000
    assert shapefit(["info", folder]) == 0
    assert store.url in capsys.readouterr().out
