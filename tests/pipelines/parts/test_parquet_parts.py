"""A fit part by part from Parquet, and to Parquet: the same bits as from HDF5 to HDF5."""

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from shapefit.config import load_config
from shapefit.errors import InputError
from shapefit.io import read_results, write_shapes
from shapefit.io.layout import RESULTS
from shapefit.io.parquet import writing
from shapefit.io.records import ShapeSet
from shapefit.pipelines.evaluate.run import run as evaluate
from shapefit.pipelines.fit.run import run as fit_whole
from shapefit.pipelines.parts.plan import plan_parts
from shapefit.pipelines.parts.run import run
from shapefit.pipelines.verify import Request
from shapefit.pipelines.verify import run as verify
from tests.pipelines.parts.made import NAMES, make_dictionary, make_images
from tests.pipelines.told import done, failures, texts


@pytest.fixture
def folder(tmp_path, rng, monkeypatch) -> Path:
    """A folder with a dictionary, and 500 images in HDF5 and in Parquet, in groups of 192."""
    make_dictionary(tmp_path / "dict.h5", rng)
    points = rng.normal(size=(500, 2, 8))
    points[::7, :, 3] = np.nan
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(writing, "MOST_ROWS", 192)
    sequences = tuple(f"clip {n // 60}" for n in range(500))
    for suffix in ("h5", "parquet"):
        make_images(f"images.{suffix}", points, sequences=sequences)
    return tmp_path


def config(landmarks: str, output: str, *overrides: str):
    arguments = {"landmarks": (landmarks,), "dictionary": "dict.h5", "output": output}
    return load_config("fit", None, overrides, arguments)


def fit(landmarks: str, output: str, *overrides: str) -> int:
    """Run fit; return how many images it lifted."""
    pipeline = run if output.endswith("/") else fit_whole
    return done(pipeline(config(landmarks, output, *overrides)))


def rows(landmarks: str, *overrides: str) -> list[tuple[int, int] | None]:
    return [part.rows for part in plan_parts(config(landmarks, "out/", *overrides))]


def names() -> list[str]:
    entries = json.loads(Path("out/manifest.json").read_text())["parts"]
    return [entry["file"] for entry in entries]


def same(found, expected) -> None:
    """Assert that results have the same datasets, with the same bits."""
    for dataset in RESULTS.datasets:
        values = getattr(found, dataset.attribute)
        np.testing.assert_array_equal(values, getattr(expected, dataset.attribute))


def test_parts_end_where_row_groups_end(folder):
    assert pq.read_metadata("images.parquet").num_row_groups == 3
    assert rows("images.parquet", "partition=100") == [(0, 192), (192, 384), (384, 500)]
    assert rows("images.parquet", "partition=192") == [(0, 192), (192, 384), (384, 500)]
    assert rows("images.parquet", "partition=200") == [(0, 384), (384, 500)]
    assert rows("images.parquet", "partition=1000") == [None]


def test_a_long_row_group_is_divided(folder):
    cut = [(0, 64), (64, 192), (192, 256), (256, 384), (384, 448), (448, 500)]
    assert rows("images.parquet", "partition=64") == cut


def test_row_groups_of_other_programs_are_cut_after_whole_stretches(folder):
    table = pq.read_table("images.parquet")
    pq.write_table(table, "others.parquet", row_group_size=130)
    assert rows("others.parquet", "partition=100") == [(0, 192), (192, 320), (320, 448), (448, 500)]
    fit("others.parquet", "out/", "partition=100")
    fit("images.h5", "whole.h5")
    found = np.concatenate([read_results(Path("out") / name).shapes for name in names()])
    np.testing.assert_array_equal(found, read_results(Path("whole.h5")).shapes)


def test_sequences_stay_whole(folder):
    found = rows("images.parquet", "partition=100", "method=sequences")
    assert found == [(0, 120), (120, 240), (240, 360), (360, 480), (480, 500)]
    assert found == rows("images.h5", "partition=100", "method=sequences")


def test_parts_in_parquet_are_the_same_bits(folder):
    fit("images.h5", "whole.h5", "proof=true")
    fit("images.parquet", "out/", "partition=100", "part_format=parquet")
    assert names() == [f"part-{n:05}.parquet" for n in range(3)]
    start = 0
    whole = read_results(Path("whole.h5"), proofs=True)
    for name in names():
        part = read_results(Path("out") / name, proofs=True)
        same(part, whole.take(slice(start, start + len(part))))
        start += len(part)
    assert start == 500


def test_what_is_done_stays(folder):
    assert fit("images.parquet", "out/", "partition=100", "part_format=parquet") == 500
    assert fit("images.parquet", "out/", "partition=100", "part_format=parquet") == 0


def test_another_format_of_parts_replaces_those_of_the_first(folder):
    formats = {"hdf5": ".h5", "parquet": ".parquet"}
    for name in ("hdf5", "parquet", "hdf5"):
        assert fit("images.parquet", "out/", "partition=100", f"part_format={name}") == 500
        assert sorted(path.suffix for path in Path("out").glob("part-*")) == [formats[name]] * 3


def test_items_in_two_parts_are_found(folder):
    make_images("more.parquet", np.ones((1, 2, 8)) * np.arange(8), 7)
    arguments = {"landmarks": ("images.parquet", "more.parquet"), "dictionary": "dict.h5"}
    loaded = load_config("fit", None, ("part_format=parquet",), {**arguments, "output": "out/"})
    warnings = texts(run(loaded))
    assert any("'i7' in part-00000.parquet and part-00001.parquet" in text for text in warnings)


def test_proofs_in_parquet_are_verified(folder):
    fit("images.parquet", "out/", "partition=100", "part_format=parquet", "proof=true")
    outcomes = list(verify(Request(Path("out").resolve(), Path("dict.h5"))))
    assert done(outcomes) == 500
    assert not [failure for outcome in outcomes for failure in outcome.failures]
    path = Path("out/part-00001.parquet")
    table = pq.read_table(path).replace_schema_metadata(pq.read_metadata(path).metadata)
    dual = table.column("dual").combine_chunks().flatten().to_numpy().copy()
    dual[0] += 0.5
    lists = type(table.column("dual").chunk(0)).from_arrays(dual, 16)
    column = table.schema.get_field_index("dual")
    pq.write_table(table.set_column(column, table.schema.field(column), lists), path)
    outcomes = list(verify(Request(path.resolve(), Path("dict.h5"))))
    assert list(failures(outcomes)) == ["i192"]


def test_eval_says_the_same_of_both_formats(folder, rng):
    items = tuple(f"i{n}" for n in range(500))
    truth = ShapeSet(rng.normal(size=(500, 3, 8)), NAMES, items)
    write_shapes(Path("truth.parquet"), truth)
    write_shapes(Path("truth.h5"), truth)
    fit("images.h5", "h5/out/", "partition=100")
    fit("images.parquet", "parquet/out/", "partition=100", "part_format=parquet")
    for name, suffix in (("h5", "h5"), ("parquet", "parquet")):
        arguments = {
            "results": (f"{name}/out/",),
            "truth": (f"truth.{suffix}",),
            "output": f"r-{name}",
        }
        list(evaluate(load_config("eval", None, ("plots=false",), arguments)))
    tables = [Path(f"r-{name}/per_image.csv").read_text() for name in ("h5", "parquet")]
    assert tables[0].count("\n") > 500
    assert tables[0] == tables[1]


def test_a_missing_library_is_told_before_the_first_part(folder, without_pyarrow):
    with pytest.raises(InputError, match="run `pip install pyarrow`"):
        fit("images.h5", "out/", "part_format=parquet")
    assert not Path("out").exists()
