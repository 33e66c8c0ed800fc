"""`convert`: what can be read is written in another format, nothing lost on the way."""

from pathlib import Path

import numpy as np
import pytest
from shapefit.cli.main import run as shapefit

from shapefit.config import load_config
from shapefit.dictionary.model import Dictionary
from shapefit.errors import InputError
from shapefit.io import (
    read_results,
    read_shapes,
    write_dictionary,
    write_shapes,
)
from shapefit.pipelines.convert import convert_files as run
from shapefit.records import Landmarks, Shapes
from tests.io.files import load, save
from tests.pipelines.fitted import warnings

NAMES = ("a", "b", "c", "d")
SAMPLES = Path(__file__).resolve().parents[2] / "sample_data"


def convert(*files: Path, output: Path, **more: object) -> list[str | object]:
    """Convert with a config of the command; return its warnings."""
    overrides = [f"{key}={value}" for key, value in more.items()]
    config = load_config("convert", None, overrides, {"files": files, "output": output})
    return warnings(run(config))


@pytest.fixture
def landmarks(tmp_path, rng) -> Landmarks:
    points = rng.normal(size=(9000, 2, 4))
    points[3, :, 1] = np.nan
    images = Landmarks(
        points.swapaxes(1, 2),
        confidence=rng.uniform(size=(9000, 4)),
        landmark_names=NAMES,
        items=tuple(f"i{n}" for n in range(9000)),
        sequences=tuple(f"s{n // 3000}" for n in range(9000)),
        unit="px",
        y_axis="down",
        frame_rate=50.0,
        extras={"age": np.arange(9000)},
    )
    save(tmp_path / "views.h5", images)
    return images


def test_landmarks_keep_everything_in_hdf5(tmp_path, landmarks):
    assert convert(tmp_path / "views.h5", output=tmp_path / "same.h5") == []
    same = load(tmp_path / "same.h5")
    np.testing.assert_array_equal(same.points, landmarks.points)
    np.testing.assert_array_equal(same.confidence, landmarks.confidence)
    np.testing.assert_array_equal(same.column("age"), landmarks.column("age"))
    retained = ("landmark_names", "items", "sequences", "unit", "y_axis", "frame_rate")
    assert all(getattr(same, name) == getattr(landmarks, name) for name in retained)


def test_landmarks_to_csv_and_back(tmp_path, landmarks):
    convert(tmp_path / "views.h5", output=tmp_path / "views.csv")
    convert(tmp_path / "views.csv", output=tmp_path / "back.h5")
    same = load(tmp_path / "back.h5")
    np.testing.assert_array_equal(same.points, landmarks.points)
    assert same.sequences == landmarks.sequences


def test_doubtful_landmarks_are_hidden(tmp_path, landmarks):
    convert(tmp_path / "views.h5", output=tmp_path / "sure.h5", min_confidence=0.5)
    sure = load(tmp_path / "sure.h5")
    doubtful = landmarks.confidence < 0.5
    assert np.isnan(sure.as_columns()[:, 0][doubtful]).all()
    np.testing.assert_array_equal(
        np.isnan(sure.as_columns()[:, 0]).sum(), doubtful.sum() + 1 - (doubtful[3, 1])
    )


def test_a_result_keeps_its_proof(world, tmp_path):
    dictionary = world.dictionary("people")
    result = world.fit("people", images=world.views("people"))
    convert(result, output=tmp_path / "again.h5")
    assert shapefit(["verify", str(tmp_path / "again.h5"), "-d", str(dictionary)]) == 0
    convert(result, output=tmp_path / "result.csv")
    np.testing.assert_array_equal(
        read_results(tmp_path / "result.csv").as_columns(),
        read_results(result).as_columns(),
    )


@pytest.mark.parametrize("every", [1, 2, 7])
@pytest.mark.parametrize("first", [0, 3])
def test_thinned_frames_keep_their_times(tmp_path, rng, every, first):
    """1.40 s of walking last 1.40 s, whoever is missing where, and both walkers stay in
    step.
    """
    frames = np.r_[
        np.arange(first, first + 43), np.delete(np.arange(first, first + 43), [4, 5, 9])
    ]
    shapes = Shapes(
        rng.normal(size=(len(frames), 3, 4)).swapaxes(1, 2),
        landmark_names=NAMES,
        items=tuple(f"i{n}" for n in range(len(frames))),
        sequences=("walk/a",) * 43 + ("walk/b",) * 40,
        unit="m",
        frame_rate=30.0,
        frames=frames,
    )
    write_shapes(tmp_path / "walk.h5", shapes)
    convert(tmp_path / "walk.h5", output=tmp_path / "thin.h5", every=every)
    thin = read_shapes([tmp_path / "thin.h5"])
    start = first % every / 30
    rows = [int(item[1:]) for item in thin.items]
    times = thin.column("frame") / thin.frame_rate + start
    np.testing.assert_allclose(times, frames[rows] / 30, atol=1e-12)
    assert {*frames[rows]} == {*range(first, first + 43, every)}
    convert(tmp_path / "thin.h5", output=tmp_path / "thin.trc", up="y")
    table = np.genfromtxt(tmp_path / "thin_a.trc", skip_header=5)
    assert table[-1, 1] - table[0, 1] == pytest.approx(42 // every * every / 30)
    assert np.isfinite(table).all()


@pytest.fixture
def walk(world, tmp_path, monkeypatch) -> Path:
    """A result of one sequence of 80 frames at 30 Hz, and its truth."""
    monkeypatch.chdir(tmp_path)
    result = read_results(world.fit("people", images=world.views("people")))
    truth = read_shapes([world.truth("people")])
    name = (result.sequences or ())[0]
    for path, records in (("result.h5", result), ("truth.h5", truth)):
        rows = np.flatnonzero([sequence == name for sequence in records.sequences])
        save(tmp_path / path, records.take(rows).replaced(frame_rate=30.0))
    return tmp_path / "result.h5"


@pytest.mark.parametrize("ending", ["trc", "c3d", "metres.csv"])
def test_what_fit_writes_can_be_judged(walk, ending, capsys):
    convert(walk, output=walk.with_name(f"walk.{ending}"))
    capsys.readouterr()
    command = ["eval", f"walk.{ending}", "--truth", "truth.h5", "-o", "report"]
    assert shapefit([*command, "--set", "plots=none"]) == 0
    told = capsys.readouterr()
    assert "80 images" in told.err + told.out
    (warning,) = [line for line in told.err.splitlines() if line.startswith("Warning")]
    assert "no camera, rotation and reprojection without" in warning


def test_atoms_of_a_dictionary_are_a_table_of_shapes(tmp_path, rng):
    path = tmp_path / "d.h5"
    target = tmp_path / "atoms.csv"
    atoms = rng.normal(size=(12, 3, 5))
    sizes = rng.uniform(1, 2, 12)
    names = tuple("abcde")
    made = Dictionary(atoms, names, atoms[0], atom_scale=sizes, unit="m")
    write_dictionary(path, made)
    (outcome,) = run(
        load_config("convert", None, (), {"files": [path], "output": target})
    )
    assert outcome.done == 12
    assert outcome.unit == "shape"
    shapes = read_shapes([target])
    assert shapes.items[:2] == ("atom 00", "atom 01")
    assert shapes.landmark_names == names
    np.testing.assert_array_equal(shapes.as_columns(), atoms * sizes[:, None, None])


@pytest.mark.parametrize("name", ["atoms.trc", "atoms.metres.csv"])
def test_a_dictionary_is_written_as_nothing_else(tmp_path, rng, name):
    path = tmp_path / "d.h5"
    atoms = rng.normal(size=(4, 3, 5))
    write_dictionary(path, Dictionary(atoms, tuple("abcde"), atoms[0]))
    given = {"files": [path], "output": tmp_path / name}
    with pytest.raises(
        InputError, match=r"in \.h5, or in \.csv for its atoms as shapes"
    ):
        list(run(load_config("convert", None, (), given)))
