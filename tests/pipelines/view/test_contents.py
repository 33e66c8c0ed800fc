"""What is on a page: numbers come back, frames are thinned, measures and pictures are there."""

import json
from base64 import b64decode

import numpy as np
import pytest

from shapefit.config import ViewConfig
from shapefit.evaluation import metrics
from shapefit.io import read_results, read_shapes, write_dictionary
from shapefit.pipelines.view.run import make_page
from shapefit.viewer.scene import block_of_points


def decoded(block):
    """Undo a block as blocks.js does."""
    codes = np.frombuffer(b64decode(block["data"]), "<" + block["type"]).reshape(block["shape"])
    if "places" not in block:
        return codes
    places = decoded(block["places"]).astype(float)
    values = places[:, None, :-1] + places[:, None, -1:] * codes
    return np.where(codes == -32768, np.nan, values).swapaxes(1, 2)


def test_points_come_back_within_half_a_step_and_far_ones_do_not_spoil_the_others(rng):
    points = rng.normal(size=(50, 3, 4)) * np.array([1, 100, 5])[:, None] + 1000
    points[0] *= 1e9
    points[3, :, 2] = np.nan
    points[7, 0, 1] = np.inf
    back = decoded(block_of_points(points))
    known = np.isfinite(points).all(axis=1)
    steps = np.ptp(np.where(known[:, None], points, 1000), axis=2).max(axis=1) / 65534
    away = np.abs(back - points).max(axis=1)
    assert (away <= 0.6 * steps[:, None] + 1e-7 * np.abs(points).max(axis=1))[known].all()
    assert np.isnan(back.swapaxes(1, 2)[~known]).all()


@pytest.mark.parametrize("far", [1e39, 1.7e308, np.inf, np.nan])
def test_what_32_bits_cannot_hold_is_missing(rng, far):
    points = rng.standard_normal((4, 2, 5))
    without = points.copy()
    points[1, :, 2], points[3, :, 0] = (far, 0.5), (0.25, -far)
    without[1, :, 2] = without[3, :, 0] = np.nan
    found = block_of_points(points)
    json.dumps(found, allow_nan=False)
    assert found == block_of_points(without)


def test_many_frames_are_thinned_and_the_page_says_so(desk, monkeypatch):
    monkeypatch.setattr("shapefit.pipelines.view.run.MEGABYTES", 1)
    n = 20_000
    sequences = tuple("long" if i < 15_000 else "short" for i in range(n))
    result = desk.result(n=n, sequences=sequences, frame_rate=60.0)
    config = ViewConfig(files={"result": (result,)})
    page = make_page(config, kept=("i7", "i19999"))
    assert len(page.html) <= 1_000_000
    assert len(page.html) > 500_000
    step = round(n / len(page.scene.items))
    assert step > 1
    assert f"Every {step}" in page.scene.notes[0]
    assert "of 20,000 frames is shown" in page.scene.notes[0]
    assert page.scene.frame_rate == 60 / step
    assert {"i0", f"i{step}", "i7", "i19999"} <= set(page.scene.items)
    assert "i1" not in page.scene.items
    assert [name for name, _ in page.scene.sequences] == ["long", "short"]
    row = page.scene.items.index(f"i{2 * step}")
    expected = read_results(result).shapes[2 * step]
    np.testing.assert_allclose(page.scene.layers[0].points[row], expected)


def test_sequences_are_put_together_and_single_ones_are_none(desk):
    made = desk.view(desk.result(n=4, sequences=("x", "y", "x", "y")))
    assert made.data["items"] == ["i0", "i2", "i1", "i3"]
    assert made.data["sequences"] == [["x", 0], ["y", 2]]
    made = desk.view(desk.result(n=4, sequences=("x", "y", "z", "w")))
    assert made.data["sequences"] == [["", 0]]


def test_errors_and_trust_stand_on_the_strip(desk, rng):
    gap = np.array([1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 0.1])
    landmarks = desk.shapes(6)[:, :2]
    extras = {
        "landmarks": landmarks.swapaxes(1, 2),
        "plausibility": np.linspace(0, 1, 6),
        "log_evidence": -np.arange(6.0),
        "outliers": np.eye(6, 5, dtype=bool),
    }
    status = np.array(["optimal", "converged", "iteration limit", "degenerate", "x", "optimal"])
    result = desk.result(
        extras=extras, relative_gap=gap, status=status, shape_sd=np.ones((6, 3, 5))
    )
    made = desk.view(result, truth=(desk.truth(),))
    layer = made.data["layers"][0]
    measures = {measure["name"]: measure for measure in layer["measures"]}
    assert list(measures) == [
        "error", "plausibility", "log evidence", "reprojection", "relative gap", "status",
    ]  # fmt: skip
    found, truth = read_results(result), read_shapes([desk.folder / "truth.h5"])
    for name, expected in (
        ("error", metrics.similarity(found.shapes, truth.shapes)),
        ("reprojection", metrics.reprojection(found.shapes[:, :2], landmarks)),
        ("relative gap", gap),
        ("status", [0.1, 0.1, 0.6, np.nan, np.nan, 0.1]),
        ("plausibility", extras["plausibility"]),
    ):
        np.testing.assert_allclose(decoded(measures[name]["values"]), expected, rtol=0.004)
    assert measures["plausibility"]["bad"] == "low"
    np.testing.assert_allclose(decoded(layer["sd"]), 1, atol=1e-4)
    np.testing.assert_array_equal(decoded(made.data["outliers"]), extras["outliers"])


def mesh_vertices(scene, frame, layer):
    """Return the blended mesh (3, q) of a frame, as the page does; None where there is none."""
    if layer.blend is None or layer.pose is None:
        return None
    start, end = layer.blend.start[frame : frame + 2]
    if start == end:
        return None
    atoms = scene.meshes[layer.blend.mesh_set].vertices[layer.blend.atom[start:end]]
    mixed = np.tensordot(layer.blend.weight[start:end], atoms, axes=1)
    R, scale, t = layer.pose[frame, :9].reshape(3, 3), layer.pose[frame, 9], layer.pose[frame, 10:]
    return scale * (R @ mixed) + t[:, None]


def test_meshes_follow_the_coefficients(desk, made_dictionary, rng):
    write_dictionary(desk.folder / "dict.h5", made_dictionary)
    c = np.array([[1.0, 0, 0.5], [0, 2.0, 0], [np.nan] * 3])
    R = np.linalg.qr(rng.normal(size=(3, 3, 3)))[0]
    s, T = np.array([2.0, 3.0, 1.0]), rng.normal(size=(3, 2))
    result = desk.result(n=3, coefficients=c, rotation=R, scale=s, translation=T)
    config = ViewConfig(files={"r": (result,)}, dictionary=desk.folder / "dict.h5")
    scene = make_page(config).scene
    (layer,) = scene.layers
    for i in range(2):
        expected = s[i] * R[i] @ np.tensordot(c[i], made_dictionary.mesh_vertices, axes=1)
        expected[:2] += T[i][:, None]
        np.testing.assert_allclose(mesh_vertices(scene, i, layer), expected)
    assert mesh_vertices(scene, 2, layer) is None


@pytest.mark.parametrize(
    ("attributes", "fields", "why"),
    [
        ({"method": "pmp"}, {}, "pmp gives no coefficients"),
        ({}, {"coefficients": np.ones((6, 2))}, "2 coefficients are not those of 3 atoms"),
        ({}, {"rotation": None}, "it has no rotation"),
    ],
)
def test_meshes_that_cannot_follow(desk, made_dictionary, attributes, fields, why):
    write_dictionary(desk.folder / "dict.h5", made_dictionary)
    pose = {
        "coefficients": np.ones((6, 3)), "rotation": np.tile(np.eye(3), (6, 1, 1)),
        "scale": np.ones(6), "translation": np.zeros((6, 2)),
    }  # fmt: skip
    result = desk.result(attributes=attributes, **(pose | fields))
    made = desk.view(result, dictionary=desk.folder / "dict.h5")
    assert why in made.notes
    assert "blend" not in made.data["layers"][0]


def test_pictures_lie_under_their_frames(desk):
    from PIL import Image

    images = desk.folder / "images"
    (images / "deep").mkdir(parents=True)
    Image.new("RGB", (2000, 1000), "red").save(images / "i1.jpg")
    Image.new("L", (20, 10)).save(images / "deep" / "i3.png")
    Image.new("L", (20, 10)).save(desk.folder / "secret.png")
    result = desk.result(items=("i0", "x/i1", "i2", "deep/i3", "../secret", "/etc/hosts"))
    made = desk.view(result, images=images)
    assert {k: v["size"] for k, v in made.data["pictures"].items()} == {
        "1": [2000, 1000], "3": [20, 10],
    }  # fmt: skip
    assert made.data["pictures"]["1"]["data"].startswith("data:image/jpeg;base64,")
    assert "2 of 6 frames have a picture" in made.notes
    pattern = desk.view(result, images=images / "{item}.jpg")
    assert list(pattern.data["pictures"]) == ["1"]


def test_pictures_of_a_video_are_numbered(desk):
    from PIL import Image

    images = desk.folder / "frames"
    images.mkdir()
    for number in (8, 9, 10):  # programs count from any number
        Image.new("L", (10 * number, 10)).save(images / f"film_{number}.png")
    (images / "notes.txt").write_text("nothing")
    result = desk.result(items=("v/a/0", "v/a/2", "v/b/2", "v/b/3", "v/c", "v/b/1"))
    found = desk.view(result, images=images).data["pictures"]
    assert {frame: each["size"][0] for frame, each in found.items()} == {
        "0": 80, "1": 100, "2": 100, "5": 90,
    }  # fmt: skip


def test_frame_rates_come_from_the_config_the_result_or_the_truth(desk):
    result = desk.result(sequences=("s",) * 6, frame_rate=30.0)
    assert desk.view(result).data["frame_rate"] == 30
    assert desk.view(result, frame_rate=12.5).data["frame_rate"] == 12.5
    plain = desk.view(desk.result(sequences=("s",) * 6)).data
    assert (plain["frame_rate"], plain["rate_known"]) == (25, False)


def test_shapes_of_another_tool_may_have_gaps(tmp_path):
    names = "a,,,b,,,c,,"
    rows = [f"{n},{n / 10},0,1,{n},1,0,0,{',,' if n % 2 else '2,1,1'}" for n in range(1, 9)]
    head = [
        "PathFileType,4,(X/Y/Z),gaps.trc",
        "DataRate,CameraRate,NumFrames,NumMarkers,Units,OrigDataRate,OrigDataStartFrame,OrigNumFrames",
        "10,10,8,3,m,10,1,8",
        f"Frame#,Time,{names}",
        ",,X1,Y1,Z1,X2,Y2,Z2,X3,Y3,Z3",
    ]
    file = tmp_path / "gaps.trc"
    file.write_text("\n".join([*head, *rows, ""]).replace(",", "\t"), encoding="utf-8")
    scene = make_page(ViewConfig(files={"gaps": (file,)}, output=tmp_path / "page.html")).scene
    (layer,) = scene.layers
    assert np.isnan(layer.points[:, 0, 2]).sum() == 4


def test_a_truth_of_the_detectors_landmarks_is_compared_as_eval_does(desk):
    """A result has joints and the landmarks of its files; the truth names the latter."""
    own = desk.shapes(6)
    columns = {
        "landmarks": desk.shapes(6)[:, :2].swapaxes(1, 2),
        "input_shapes": own.swapaxes(1, 2),
        "input_landmark_names": np.array([f"detected_{name}" for name in "abcde"], dtype=object),
        "edges": np.array([[0, 4]]),
    }
    truth = desk.truth(landmark_names=[f"detected_{name}" for name in "abcde"])
    made = desk.view(desk.result(extras=columns), truth=(truth,))
    measures = made.data["layers"][0]["measures"]
    (error,) = (one["values"] for one in measures if one["name"] == "error")
    expected = metrics.similarity(own, read_shapes([truth]).shapes)
    np.testing.assert_allclose(decoded(error), expected, rtol=0.004)
