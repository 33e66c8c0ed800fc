"""What is estimated before lifting: once, from all inputs together, whatever they are cut into."""

import json
from pathlib import Path

import h5py
import numpy as np
import pytest

from shapefit.config import FitConfig
from shapefit.config.paths import ResultFolder, find_dictionaries
from shapefit.io import LandmarkSet, read_dictionary
from shapefit.io.skeletons import installed_skeletons
from shapefit.pipelines.fit.run import run
from shapefit.pipelines.partition.run import run as run_parts
from tests.io.files import save

SIZE = np.array([1920.0, 1080.0])


def look(shapes, focal, centre, distance):
    """Shapes (n, 3, p) as a camera at a distance in their unit sees them: (n, 2, p)."""
    moved = shapes + np.array([0.0, 0.0, distance])[:, None]
    return focal * moved[:, :2] / moved[:, 2:] + np.asarray(centre, float)[:, None]


@pytest.fixture(scope="module")
def bodies():
    """Shapes of the dictionary of people, 12 landmarks by the names of a detector, y down."""
    people = read_dictionary(find_dictionaries()["people"])
    people = people.marked(())
    rng = np.random.default_rng(3)
    shapes = []
    for _ in range(40):
        drawn = people.prior.means[rng.integers(len(people.prior.means))]
        angle = rng.uniform(0, 2 * np.pi)
        c, s = np.cos(angle), np.sin(angle)
        shapes.append(np.array([[c, 0, s], [0, -1, 0], [s, 0, -c]]) @ drawn)
    joint = dict(zip(people.landmark_names, range(len(people.landmark_names)), strict=True))
    sides = {"left": "l", "right": "r"}
    names = {
        f"{side}_{part}": joint[f"{letter}{part}"]
        for part in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
        for side, letter in sides.items()
    }
    shapes = np.array(shapes)[..., list(names.values())]
    # Hips of detectors are further apart than the joints.
    hips = [list(names).index(f"{side}_hip") for side in sides]
    middle = shapes[..., hips].mean(axis=2, keepdims=True)
    shapes[..., hips] = middle + 1.15 * (shapes[..., hips] - middle)
    return shapes, tuple(names)


def frames(bodies, rows=slice(None), focal=2100.0, distance=20.0, noise=2.0, reach=0.0, **whole):
    """Images of these bodies; the later ones stand further to the right by up to `reach` px."""
    shapes, names = bodies
    rng = np.random.default_rng(5)
    points = look(shapes, focal, SIZE / 2, distance)
    points += noise * rng.standard_normal(points.shape)
    points[:, 0] += np.linspace(-reach, reach, len(points))[:, None]
    return LandmarkSet(
        landmarks=points[rows],
        landmark_names=names,
        items=tuple(f"{i:03}" for i in range(len(shapes)))[rows],
        unit="px",
        y_axis="down",
        whole=whole,
    )


def fit(landmarks, output, dictionary="people", **keys):
    files = [str(path) for path in ([landmarks] if isinstance(landmarks, Path) else landmarks)]
    config = {"landmarks": files, "dictionary": str(dictionary), "output": output}
    config |= {"method": "posterior"} | keys
    config = FitConfig(**config)
    return list((run_parts if isinstance(output, ResultFolder) else run)(config))


def shapes_in(path):
    files = sorted(path.glob("part-*")) if path.is_dir() else [path]
    found = []
    for file in files:
        with h5py.File(file) as result:
            found.append(result["shapes"][:])
    return np.concatenate(found)


def write_openpose(folder, images):
    """One JSON file a frame, BODY_25 with what it has of these landmarks."""
    order = installed_skeletons()["body_25"].landmark_names
    own = {
        ("L" if name[0] == "l" else "R") + name.partition("_")[2].title(): column
        for column, name in enumerate(images.landmark_names)
    }
    folder.mkdir()
    for item, points in zip(images.items, images.landmarks, strict=True):
        flat = []
        for name in order:
            column = own.get(name)
            flat += [0, 0, 0] if column is None else [*points[:, column].tolist(), 0.9]
        people = [{"person_id": [-1], "pose_keypoints_2d": flat}]
        path = folder / f"{folder.name}_{item}_keypoints.json"
        path.write_text(json.dumps({"version": 1.3, "people": people}))


@pytest.fixture(scope="module")
def halves(bodies, tmp_path_factory):
    """Two folders of OpenPose files and two files of HDF5, of which the second half reaches out."""
    folder = tmp_path_factory.mktemp("halves")
    images = frames(bodies, reach=300.0)
    cut = 17
    for name, rows in (("a", slice(0, cut)), ("b", slice(cut, None))):
        write_openpose(folder / name, images.take(rows))
        save(folder / f"{name}.h5", images.take(rows))
    save(folder / "both.h5", images)
    for number in (0, 1):  # a folder with one file per part
        save(folder / f"part{number}.h5", images.take(slice(20 * number, 20 * number + 20)))
    fit(folder / "both.h5", folder / "result.h5")
    return folder


def test_two_recordings_in_one_run_and_in_parts_are_the_same_bits(halves, tmp_path):
    inputs = [halves / "a", halves / "b"]
    keys = {"keypoints": "body_25"}
    fit(inputs, tmp_path / "one.h5", **keys)
    told = fit(inputs, ResultFolder(tmp_path / "parts", 10), **keys)
    assert len(list((tmp_path / "parts").glob("part-*"))) == 2
    np.testing.assert_array_equal(shapes_in(tmp_path / "parts"), shapes_in(tmp_path / "one.h5"))
    lines = [outcome.line for outcome in told if outcome.line.startswith("camera:")]
    assert len(lines) == 1


@pytest.mark.parametrize(
    ("names", "keys"),
    [
        (("a", "b"), {}),
        (("a", "b"), {"partition": 64}),
        (("part0", "part1"), {"workers": 2}),
        (("both",), {"partition": 1}),
    ],
)
def test_files_and_parts_are_the_same_bits(halves, tmp_path, names, keys):
    inputs = [halves / f"{name}.h5" for name in names]
    fit(inputs, ResultFolder(tmp_path / "parts", **keys) if keys else tmp_path / "one.h5")
    written = tmp_path / ("parts" if keys else "one.h5")
    np.testing.assert_array_equal(shapes_in(written), shapes_in(halves / "result.h5"))


def test_the_manifest_holds_what_was_estimated_and_a_later_run_takes_it(halves, tmp_path):
    inputs = [halves / "a.h5", halves / "b.h5"]
    fit(inputs[:1], ResultFolder(tmp_path / "parts", 1))
    first = {p.name: p.read_bytes() for p in (tmp_path / "parts").glob("part-*")}
    fit(inputs, ResultFolder(tmp_path / "parts", 1))
    for name, content in first.items():
        assert (tmp_path / "parts" / name).read_bytes() == content
    text = next((tmp_path / "parts").glob("manifest.json*")).read_text()
    assert '"focal"' in text
    assert '"skeleton"' in text
    assert '"prior"' in text


# --- the camera -----------------------------------------------------------------------------------
