"""Small parts that are lifted together are, to the last byte, what each is alone."""

import resource
from pathlib import Path

import numpy as np
import pytest

from shapefit.config import load_config
from shapefit.config.paths import ResultFolder
from shapefit.pipelines.partition import together
from shapefit.pipelines.partition.run import fit_parts
from shapefit.records import Landmarks
from tests.columns import in_rows
from tests.io.files import save
from tests.pipelines.fitted import done, failures
from tests.pipelines.partition.made import NAMES, entries, make_dictionary

COUNTS = {"a": 1, "b": 70, "c": 2, "d": 1, "e": 1, "f": 140, "g": 3}
"""File -> its images: some begin in a block of the files before, one goes alone."""


@pytest.fixture(autouse=True)
def folder(tmp_path, rng, monkeypatch):
    """A folder with a dictionary, in which tests run."""
    monkeypatch.chdir(tmp_path)
    make_dictionary(tmp_path / "dict.h5", rng)


@pytest.fixture
def images(rng):
    """Return what makes images of one shape, seen from nearby."""
    shape = rng.normal(size=(2, len(NAMES)))

    def make(count: int, **fields) -> Landmarks:
        points = shape + 0.01 * rng.normal(size=(count, *shape.shape))
        items = tuple(f"i{number}" for number in range(count))
        record = Landmarks(in_rows(points), landmark_names=NAMES, items=items)
        return record.replaced(**fields)

    return make


@pytest.fixture
def lifted(monkeypatch):
    """The numbers of images that were lifted at once."""
    sizes = []
    real = together.lift_batch

    def lift_batch(batch, plan):
        sizes.append(len(batch.images))
        return real(batch, plan)

    monkeypatch.setattr(together, "lift_batch", lift_batch)
    return sizes


def fit(**keys):
    """Fit all files but the dictionary into `out`; return the outcomes."""
    paths = [path for path in sorted(Path().glob("*.*")) if path.name != "dict.h5"]
    arguments = {
        "landmarks": [*map(str, paths)],
        "dictionary": "dict.h5",
        "output": ResultFolder(Path("out").absolute(), replace=True),
        "method": "convex",
        "threads": 2,
        **keys,
    }
    return list(fit_parts(load_config("fit", None, (), arguments)))


def describe(outcomes):
    """Return all that outcomes say, but for the function that gives data."""
    return [
        (*outcome[:3], *map(str, outcome.warnings), *map(str, outcome.reasons))
        for outcome in outcomes
    ]


def check_alone(monkeypatch, outcomes, **keys) -> None:
    """Assert that a fit of each part alone says and writes the same."""
    parts = {path.name: path.read_bytes() for path in Path("out").glob("*.h5")}
    lines = [{**entry, "seconds": 0} for entry in entries()]
    for path in Path("out").iterdir():
        path.unlink()
    monkeypatch.setattr(together.TogetherLifter, "lift_first", lambda *_: ())
    alone = fit(**keys)
    assert describe(outcomes) == describe(alone)
    assert lines == [{**entry, "seconds": 0} for entry in entries()]
    assert parts == {path.name: path.read_bytes() for path in Path("out").glob("*.h5")}


@pytest.mark.parametrize(
    "keys",
    [
        {"method": "convex"},
        {"method": "convex", "outliers": "l1"},
        {
            "method": "convex+refine",
            "camera": {"focal": 900, "principal_point": [0, 0]},
        },
        {"method": "mean-shape"},
    ],
)
def test_parts_of_any_size(images, lifted, monkeypatch, keys):
    for name, count in COUNTS.items():
        save(Path(f"{name}.csv"), images(count))
    outcomes = fit(**keys)
    assert done(outcomes) == sum(COUNTS.values())
    assert lifted[0] == 1 + 70 + 2 + 1 + 1
    check_alone(monkeypatch, outcomes, **keys)


def test_parts_that_fail_fail_alone(images, lifted, monkeypatch):
    """Failing files, and images without a shape, between files without a fault."""
    for name in "abdfhj":
        save(Path(f"{name}.csv"), images(2))
    Path("c.csv").write_text("item,landmark,x,y\ni,a,one,2\n")
    others = tuple(f"other {name}" for name in NAMES)
    save(Path("e.csv"), images(2, landmark_names=others))
    at_one_point = np.full((2, len(NAMES), 2), 5.0)
    save(Path("g.csv"), images(2, landmarks=at_one_point))
    Path("i.csv").write_text("item,landmark,x,y\n")
    outcomes = fit()
    assert [entry["status"] for entry in entries()] == [
        *["done"] * 2,
        "failed",
        "done",
        "failed",
        *["done"] * 5,
    ]
    names = ["part-00002.h5", "part-00004.h5", "i0", "i1"]
    assert [*failures(outcomes)] == names
    assert lifted == [4, 2, 6, 2]
    check_alone(monkeypatch, outcomes)


def test_what_goes_wrong_together_is_done_alone(images, monkeypatch):
    """Once for each part, whatever it is."""
    calls = []

    def lift_batch(batch, plan):
        calls.append(len(batch.images))
        raise ZeroDivisionError

    monkeypatch.setattr(together, "lift_batch", lift_batch)
    for name in "abc":
        save(Path(f"{name}.csv"), images(2))
    assert done(fit()) == 6
    assert calls == [6]


def test_parts_that_differ_are_lifted_each_as_it_is(images, lifted, monkeypatch):
    save(Path("a.h5"), images(2, unit="px"))
    save(Path("b.h5"), images(2, unit="px", y_axis="up"))
    save(Path("c.h5"), images(2, unit="px", file_extras={"camera": np.eye(3)}))
    save(Path("d.h5"), images(2, unit="px", file_extras={"camera": 2 * np.eye(3)}))
    save(Path("e.h5"), images(2, extras={"score": np.array([1.0, 2.0])}))
    save(Path("f.h5"), images(2, extras={"score": np.array([3.0, 4.0])}))
    save(Path("g.h5"), images(2, frame_rate=25.0))
    save(Path("h.h5"), images(2, attributes={"made": "by hand"}))
    reordered = images(2)
    order = [*range(len(NAMES))][::-1]
    points = reordered.landmarks[:, order]
    save(Path("i.h5"), reordered.replaced(landmarks=points, landmark_names=NAMES[::-1]))
    save(Path("j.h5"), images(2, confidence=np.ones((2, len(NAMES)))))
    outcomes = fit()
    assert done(outcomes) == 20
    assert lifted == [2, 2, 2, 2, 4, 2, 2, 2, 2]
    check_alone(monkeypatch, outcomes)


def test_no_more_files_are_open_than_a_process_may_have(images):
    """Sources that wait for their turn hold no file."""
    for number in range(80):
        save(Path(f"{number}.h5"), images(1))
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (64, before[1]))
    try:
        outcomes = fit()
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, before)
    assert not failures(outcomes)
    assert done(outcomes) == 80


def test_each_file_is_read_once(images, monkeypatch):
    read = []
    real = together.open_landmarks

    def open_landmarks(paths, *given, **keys):
        read.extend(paths)
        return real(paths, *given, **keys)

    monkeypatch.setattr("shapefit.io.open_landmarks", open_landmarks)
    for module in ("pipelines.partition.together", "pipelines.fit.fit"):
        monkeypatch.setattr(f"shapefit.{module}.open_landmarks", open_landmarks)
    for name, count in COUNTS.items():
        save(Path(f"{name}.csv"), images(count))
    assert done(fit()) == sum(COUNTS.values())
    assert [path.stem for path in sorted(read)] == [*COUNTS]
