"""`convert`: what can be read is written in another format, nothing lost on the way."""

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
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


IMAGE_COUNT = 9000


@pytest.fixture
def landmarks(rng) -> Landmarks:
    points = rng.normal(size=(IMAGE_COUNT, 4, 2))
    points[3, 1] = np.nan
    return Landmarks(
        points,
        confidence=rng.uniform(size=(IMAGE_COUNT, 4)),
        landmark_names=NAMES,
        items=tuple(f"i{n}" for n in range(IMAGE_COUNT)),
        sequences=tuple(f"s{n // 3000}" for n in range(IMAGE_COUNT)),
        unit="px",
        y_axis="down",
        frame_rate=50.0,
        extras={"age": np.arange(IMAGE_COUNT)},
    )


@pytest.fixture
def views_file(tmp_path, landmarks) -> Path:
    path = tmp_path / "views.h5"
    save(path, landmarks)
    return path


RETAINED = ("landmark_names", "items", "sequences", "unit", "y_axis", "frame_rate")


def test_landmarks_keep_everything_in_hdf5(tmp_path, views_file, landmarks):
    output = tmp_path / "same.h5"
    assert convert(views_file, output=output) == []
    same = load(output)
    assert_array_equal(same.points, landmarks.points)
    assert_array_equal(same.confidence, landmarks.confidence)
    assert_array_equal(same.column("age"), landmarks.column("age"))
    for name in RETAINED:
        assert getattr(same, name) == getattr(landmarks, name)


def test_landmarks_to_csv_and_back(tmp_path, views_file, landmarks):
    table = tmp_path / "views.csv"
    back = tmp_path / "back.h5"
    convert(views_file, output=table)
    convert(table, output=back)
    same = load(back)
    assert_array_equal(same.points, landmarks.points)
    assert same.sequences == landmarks.sequences


def test_doubtful_landmarks_are_hidden(tmp_path, views_file, landmarks):
    output = tmp_path / "sure.h5"
    convert(views_file, output=output, min_confidence=0.5)
    doubtful = landmarks.confidence < 0.5
    unseen = np.isnan(landmarks.points[..., 0])
    hidden = np.isnan(load(output).points[..., 0])
    assert_array_equal(hidden, doubtful | unseen)


@pytest.fixture
def result_of_people(world) -> Path:
    return world.fit("people", images=world.views("people"))


def test_a_result_keeps_its_proof(world, result_of_people, tmp_path):
    again = str(tmp_path / "again.h5")
    dictionary = str(world.dictionary("people"))
    convert(result_of_people, output=Path(again))
    assert shapefit(["verify", again, "-d", dictionary]) == 0


def test_a_table_has_the_shapes_of_a_result(result_of_people, tmp_path):
    table = tmp_path / "result.csv"
    convert(result_of_people, output=table)
    expected = read_results(result_of_people).shapes
    assert_array_equal(read_results(table).shapes, expected)


FRAMES_WALKED = 43


@pytest.fixture
def walkers(tmp_path, rng):
    """Write two who walk for 43 frames at 30 Hz, of whom the second is missing in some;
    return the file and the frames of its items.
    """

    def write(first):
        every_frame = np.arange(first, first + FRAMES_WALKED)
        frames = np.r_[every_frame, np.delete(every_frame, [4, 5, 9])]
        path = tmp_path / "walk.h5"
        shapes = Shapes(
            rng.normal(size=(len(frames), 4, 3)),
            landmark_names=NAMES,
            items=tuple(f"i{n}" for n in range(len(frames))),
            sequences=("walk/a",) * FRAMES_WALKED + ("walk/b",) * 40,
            unit="m",
            frame_rate=30.0,
            frames=frames,
        )
        write_shapes(path, shapes)
        return path, frames

    return write


@pytest.mark.parametrize("every", [1, 2, 7])
@pytest.mark.parametrize("first", [0, 3])
def test_thinned_frames_keep_their_times(tmp_path, walkers, every, first):
    """Both walkers stay in step."""
    walk, frames = walkers(first)
    thin_file = tmp_path / "thin.h5"
    convert(walk, output=thin_file, every=every)
    thin = read_shapes([thin_file])
    kept = frames[[int(item[1:]) for item in thin.items]]
    start = first % every / 30
    times = thin.frames / thin.frame_rate + start
    assert_allclose(times, kept / 30, atol=1e-12)
    assert {*kept} == {*range(first, first + FRAMES_WALKED, every)}


@pytest.mark.parametrize("every", [1, 2, 7])
@pytest.mark.parametrize("first", [0, 3])
def test_thinned_motion_lasts_as_long(tmp_path, walkers, every, first):
    """1.40 s of walking last 1.40 s, whoever is missing where."""
    walk, _ = walkers(first)
    convert(walk, output=tmp_path / "thin.h5", every=every)
    convert(tmp_path / "thin.h5", output=tmp_path / "thin.trc", up="y")
    table = np.genfromtxt(tmp_path / "thin_a.trc", skip_header=5)
    times = table[:, 1]
    last_kept = (FRAMES_WALKED - 1) // every * every
    assert times[-1] - times[0] == pytest.approx(last_kept / 30)
    assert np.isfinite(table).all()


@pytest.fixture
def walk(world, result_of_people, tmp_path, monkeypatch) -> Path:
    """A result of one sequence of 80 frames at 30 Hz, and its truth."""
    monkeypatch.chdir(tmp_path)
    result = read_results(result_of_people)
    truth = read_shapes([world.truth("people")])
    name = result.sequences[0]
    for path, record in (("result.h5", result), ("truth.h5", truth)):
        rows = np.flatnonzero(np.array(record.sequences) == name)
        save(tmp_path / path, record.take(rows).replaced(frame_rate=30.0))
    return tmp_path / "result.h5"


@pytest.mark.parametrize("ending", ["trc", "c3d", "metres.csv"])
def test_what_fit_writes_can_be_judged(walk, ending, capsys):
    name = f"walk.{ending}"
    convert(walk, output=walk.with_name(name))
    capsys.readouterr()
    command = ["eval", name, "--truth", "truth.h5", "-o", "report"]
    code = shapefit([*command, "--set", "plots=none"])
    told = capsys.readouterr()
    (warning,) = [line for line in told.err.splitlines() if line.startswith("Warning")]
    assert code == 0
    assert "80 images" in told.err + told.out
    assert "no camera, rotation and reprojection without" in warning


LANDMARKS_OF_ATOMS = tuple("abcde")


@pytest.fixture
def atoms(rng):
    """Twelve atoms (12, 3, 5) of one metre."""
    return rng.normal(size=(12, 3, 5))


@pytest.fixture
def dictionary_file(tmp_path, atoms):
    """Write a dictionary of the atoms with further fields."""

    def write(**fields):
        path = tmp_path / "d.h5"
        dictionary = Dictionary(atoms, LANDMARKS_OF_ATOMS, atoms[0], **fields)
        write_dictionary(path, dictionary)
        return path

    return write


def convert_config(path, output):
    return load_config("convert", None, (), {"files": [path], "output": output})


def test_atoms_of_a_dictionary_are_a_table_of_shapes(
    tmp_path, atoms, dictionary_file, rng
):
    target = tmp_path / "atoms.csv"
    sizes = rng.uniform(1, 2, 12)
    path = dictionary_file(atom_scale=sizes, unit="m")
    (outcome,) = run(convert_config(path, target))
    shapes = read_shapes([target])
    expected = atoms * sizes[:, None, None]
    assert outcome.done == 12
    assert outcome.unit == "shape"
    assert shapes.items[:2] == ("atom 00", "atom 01")
    assert shapes.landmark_names == LANDMARKS_OF_ATOMS
    assert_array_equal(shapes.as_columns(), expected)


def test_atoms_without_sizes_are_as_they_are(tmp_path, atoms, dictionary_file):
    """With the names of what they were made of."""
    target = tmp_path / "atoms.csv"
    names = tuple(f"car {number}" for number in range(12))
    path = dictionary_file(atom_items=names)
    list(run(convert_config(path, target)))
    shapes = read_shapes([target])
    assert shapes.items == names
    assert_array_equal(shapes.as_columns(), atoms)


@pytest.mark.parametrize("name", ["atoms.trc", "atoms.metres.csv"])
def test_a_dictionary_is_written_as_nothing_else(tmp_path, dictionary_file, name):
    config = convert_config(dictionary_file(), tmp_path / name)
    fault = r"in \.h5, or in \.csv for its atoms as shapes"
    with pytest.raises(InputError, match=fault):
        list(run(config))
