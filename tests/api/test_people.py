"""Arrays of detectors to people, as the command lifts them; and what a fit shows and hands on."""

import json

import numpy as np
import pytest

import shapefit

from .conftest import run_command


@pytest.fixture(scope="module")
def seen(project):
    return shapefit.read_landmarks(
        project / "sample_data/openpose", keypoints="body_25", track="nearest"
    )


@pytest.fixture(scope="module")
def keypoints(seen):
    """One person (n, 25, 3) with confidences."""
    landmarks = np.nan_to_num(np.asarray(seen.landmarks)[:36])
    return np.dstack([landmarks, np.asarray(seen.confidence)[:36]])


@pytest.fixture(scope="module")
def found(keypoints):
    return shapefit.fit(keypoints, "people", keypoints="body_25")


def test_a_fit_is_the_command_on_the_same_array(found, keypoints, tmp_path):
    np.save(tmp_path / "landmarks.npy", keypoints)
    config = {"landmarks": (str(tmp_path / "landmarks.npy"),), "dictionary": "people"}
    (tmp_path / "fit.yaml").write_text(
        json.dumps({"input": {"keypoints": "body_25"}, "method": "sequences"})
    )
    assert found.attributes["method"] == "sequences"
    wanted = json.loads(found.attributes["config"])
    given = {key: wanted[key] for key in ("lambda", "solver", "posterior", "method", "input")}
    run_command("fit", **config, **given, output=str(tmp_path / "result.h5"))
    result = shapefit.read_results(tmp_path / "result.h5")
    for name in ("shapes", "shape_sd", "plausibility", "trusted"):
        np.testing.assert_array_equal(getattr(found, name), getattr(result, name))


def test_one_image_has_the_method_for_single_images(keypoints):
    given = {"theta": {"head": 1.5, "hips": 1.15}, "camera": {"model": "weak-perspective"}}
    alone = shapefit.fit(keypoints[0], "people", keypoints="body_25", **given)
    assert (len(alone), alone.attributes["method"]) == (1, "posterior")
    config = shapefit.fit(keypoints, "people", keypoints="body_25", config="people", **given)
    np.testing.assert_array_equal(config[0].shapes, alone.shapes)


def test_people_of_a_frame_are_joined_over_frames(seen, found):
    first, second = np.asarray(seen.landmarks).reshape(2, 36, 25, 2)
    pairs = enumerate(zip(first, second, strict=True))
    frames = [np.stack(pair)[:: (-1) ** number] for number, pair in pairs]
    frames[7] = frames[7][:0]
    both = shapefit.fit(frames, "people", keypoints="body_25", config="people")
    assert both.sequences == ("landmarks/person 1",) * 35 + ("landmarks/person 2",) * 35
    assert 7 not in both.extras["frame"]


@pytest.mark.parametrize(
    ("landmarks", "options", "message"),
    [
        (np.ones((3, 25, 3)), {}, r'has 25 landmarks without names, not 15; name them, as in `key'),
        (np.full((3, 25, 2), 9.0), {"keypoints": "body_26"}, "body_25"),
        ([np.ones((1, 25, 2)), np.ones((1, 17, 2))], {}, "frames that differ in their landmarks"),
        (np.full((3, 15, 3), 7.0), {}, "third numbers run from 7 to 7"),
    ],
)  # fmt: skip
def test_arrays_that_cannot_be_are_refused(landmarks, options, message):
    with pytest.raises(shapefit.InputError, match=message):
        shapefit.fit(landmarks, "people", **options)


def test_a_fit_is_one_line_and_has_parts(found):
    assert repr(found) == (
        "<shapefit.Fit: 36 images, 21 landmarks, method sequences, 36 trusted, in unknown>"
    )
    assert len(found) == 36
    part = found[4:9]
    assert part.items == found.items[4:9]
    np.testing.assert_array_equal(part.shapes, found.shapes[4:9])
    np.testing.assert_array_equal(found[-1].shapes, found.shapes[-1:])
    assert len(found[found.trusted]) == int(found.trusted.sum())


def test_the_page_is_that_of_the_command_without_scripts_of_ours(found, tmp_path, monkeypatch):
    opened = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    page = found[:3].view(tmp_path / "page.html")
    assert opened == [page.resolve().as_uri()]
    assert found.items[1] in page.read_text(encoding="utf-8")
    html = found[:3]._repr_html_()
    assert html.startswith('<iframe sandbox="allow-scripts"')
    assert "<script" not in html


def test_a_shape_is_drawn(found):
    pytest.importorskip("matplotlib").use("agg")
    axes = found.plot(3)
    assert axes.get_title() == found.items[3]
    bones = axes.collections[0]._segments3d
    ends = found.shapes[3][found.extras["edges"]]  # y down: up is z of the axes
    np.testing.assert_allclose(bones, ends[..., [0, 2, 1]] * [1, 1, -1])


@pytest.mark.slow
def test_tables_of_other_libraries(found):
    table = found.to_pandas()
    assert list(table.columns[:5]) == ["item", "landmark", "x", "y", "z"]
    np.testing.assert_array_equal(table[["x", "y", "z"]].to_numpy(), found.shapes.reshape(-1, 3))
    dataset = found.to_xarray()
    assert dict(dataset.sizes) == {"time": 36, "space": 3, "keypoints": 21, "individuals": 1}
    of_one = dataset.position.sel(keypoints="lankle").to_numpy()[:, :, 0]
    np.testing.assert_array_equal(of_one, found.shapes[:, found.landmark_names.index("lankle")])
