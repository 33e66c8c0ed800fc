"""Every mesh file that `fit` writes is opened again and compared with what its result says."""

from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

from shapefit.io import read_dictionary
from shapefit.io.records import concatenate
from shapefit.pipelines.export.meshes import has_shape
from tests.io.files import load
from tests.pipelines.told import failures

FORMATS = pytest.mark.parametrize("file_format", ["obj", "ply", "ply-ascii", "glb"])
# OBJ: 8 decimals. PLY and GLB: single precision of coordinates, which go up to 1500 pixels.
PRECISION = {"obj": 5.1e-9, "ply": 6.2e-5, "ply-ascii": 6.2e-5, "glb": 6.2e-5}


def origin(found, image):
    return np.array([*found.translation[image], 0])[:, None]


def landmark_vertices(dictionary):
    """Which vertex of its mesh each landmark of a sample car is."""
    apart = dictionary.mesh_vertices[0, :, None, :] - dictionary.atoms[0, :, :, None]
    return (apart**2).sum(axis=0).argmin(axis=1)


@FORMATS
def test_the_mesh_is_that_of_the_coefficients_in_every_format(
    tmp_path, export, car_atoms, file_format, read_one, mixed
):
    found, outcomes = export(format=file_format, frame="camera")
    assert len(found) == 6
    for image, item in enumerate(found.items):
        place, s, R = origin(found, image), found.scale[image], found.rotation[image]
        expected = s * R @ mixed(car_atoms.mesh_vertices, found, image) + place
        points = s * R @ mixed(car_atoms.atoms, found, image) + place
        np.testing.assert_allclose(points, found.shapes[image], atol=1e-9)
        mesh = read_one(item, file_format)
        assert np.isfinite(mesh.vertices).all()
        np.testing.assert_allclose(mesh.vertices.T, expected, atol=PRECISION[file_format])
        np.testing.assert_array_equal(mesh.faces, car_atoms.mesh_faces)
        assert mesh.is_watertight
        assert mesh.is_winding_consistent
        assert mesh.volume > 0
        # as viewers open it, with vertices that coincide merged
        usual = trimesh.load_mesh(tmp_path / "meshes" / f"{item}.{file_format.split('-')[0]}")
        assert usual.is_watertight
    assert outcomes[-1].written == (tmp_path / "result.h5", tmp_path / "meshes")
    assert outcomes[-1].note == "y down in the images; 6 meshes"
    assert [warning for outcome in outcomes for warning in outcome.warnings] == []


@pytest.mark.parametrize("frame", ["object", "camera"])
@pytest.mark.parametrize("unit", ["landmarks", "dictionary"])
def test_frames_and_units(export, car_atoms, frame, unit, read_one, mixed, metres):
    found, _ = export(frame=frame, unit=unit, format="obj")
    for image, item in enumerate(found.items):
        expected = mixed(car_atoms.mesh_vertices, found, image)
        if frame == "camera":
            expected = found.rotation[image] @ expected
        if unit == "dictionary":
            expected = metres(car_atoms, found, image) * expected
        else:
            place = origin(found, image) if frame == "camera" else 0
            expected = found.scale[image] * expected + place
        mesh = read_one(item, "obj")
        np.testing.assert_allclose(mesh.vertices.T, expected, atol=5.1e-9)


def test_by_default_a_car_stands_upright_and_looks_ahead(export, car_atoms, read_one):
    found, _ = export(unit="dictionary")
    names = car_atoms.landmark_names
    for item in found.items:
        width, height, length = read_one(item, "ply").extents
        assert 1.5 < width < 2.5
        assert 1.2 < height < 2.3
        assert 3.3 < length < 5.6
    found, _ = export()
    for item in found.items:
        rows = read_one(item, "ply").vertices[landmark_vertices(car_atoms)]
        place = dict(zip(names, rows, strict=True))
        assert place["left_windscreen_top"][1] > place["left_front_wheel"][1]
        assert place["left_front_wheel"][2] > place["left_rear_wheel"][2]


@pytest.mark.parametrize("y_axis", ["down", "up"])
def test_in_perspective_the_car_is_where_it_is(
    export, car_atoms, views, y_axis, read_one, mixed, metres
):
    images = views
    if y_axis == "up":  # the same pictures, y counted from below
        flipped = views.landmarks * np.array([1, -1])[:, None]
        images = views.replaced(landmarks=flipped, y_axis="up")
    centre = [640.0, 480.0 if y_axis == "down" else -480.0]
    camera = {"model": "perspective", "focal": 1600.0, "principal_point": centre}
    found, _ = export(images, fit_keys={"camera": camera}, frame="camera", unit="dictionary")
    vertex = landmark_vertices(car_atoms)
    sign = 1 if y_axis == "down" else -1
    for image, item in enumerate(found.items):
        size = metres(car_atoms, found, image)
        t = found.columns["camera_translation"][image][:, None]
        solid = found.rotation[image] @ mixed(car_atoms.mesh_vertices, found, image)
        mesh = read_one(item, "ply")
        np.testing.assert_allclose(mesh.vertices.T, size * (solid + t), atol=2e-6)
        assert 8 < sign * mesh.centroid[2] < 16
        # the camera sees the landmarks in that place where the fit says
        x, y, z = mesh.vertices[vertex].T
        seen = np.array(centre)[:, None] + 1600 * np.array([x, y]) / (sign * z)
        np.testing.assert_allclose(seen, found.landmarks_fitted[image], atol=1e-3)


def test_images_without_a_shape_are_counted(tmp_path, export, views):
    landmarks = views.landmarks.copy()
    landmarks[1, :, 2:] = np.nan
    _, outcomes = export(views.replaced(landmarks=landmarks))
    assert list(failures(outcomes)) == [views.items[1]]
    assert outcomes[-1].note == "y down in the images; 5 meshes"
    assert outcomes[-1].warnings == (
        "images without a shape (failed, or with all coefficients 0): 1; they have no mesh",
    )
    _, outcomes = export(fit_keys={"method": "convex", "lambda": 1e6})
    assert "with all coefficients 0): 6; they have no mesh" in outcomes[-1].warnings[0]
    assert outcomes[-1].written == (tmp_path / "result.h5",)


def test_a_shape_without_extent_has_no_mesh():
    shapes = np.zeros((3, 3, 4))
    shapes[1, 0] = range(4)
    shapes[2] = np.nan
    found = SimpleNamespace(shapes=shapes, rotation=np.tile(np.eye(3), (3, 1, 1)))
    assert has_shape(found).tolist() == [False, True, False]


def test_every_file_has_the_mesh_of_its_own_image_wherever_chunks_end(
    export, car_atoms, views, monkeypatch, read_one, mixed
):
    monkeypatch.setattr("shapefit.pipelines.export.meshes.BATCH", 3)
    copies = [views.replaced(items=tuple(f"{i}#{copy}" for i in views.items)) for copy in "ab"]
    landmarks = concatenate(copies)
    landmarks.landmarks[7, :, 2:] = np.nan
    found, _ = export(
        landmarks,
        fit_keys={"method": "convex", "chunk": 5},
        items=["*[0-35-9]#a", "*#b"],
        format="obj",
    )
    written = [i for i, item in enumerate(found.items) if i != 7 and not item.endswith("4#a")]
    assert 7 < len(written) < 12
    for image in written:
        expected = mixed(car_atoms.mesh_vertices, found, image)
        mesh = read_one(found.items[image], "obj")
        np.testing.assert_allclose(mesh.vertices.T, found.scale[image] * expected, atol=5.1e-9)


def test_odd_names_stay_in_the_folder_and_apart(tmp_path, export, views):
    items = ("../up", "/root", "a b", "..", "a/b/c", "a:b?")
    export(views.replaced(items=items))
    assert sorted(
        str(path.relative_to(tmp_path / "meshes")) for path in tmp_path.rglob("*.ply")
    ) == ["%/root.ply", "%2E%2E.ply", "%2E%2E/up.ply", "a b.ply", "a%3Ab%3F.ply", "a/b/c.ply"]


@pytest.mark.parametrize(("file_format", "meshes"), [("glb", 5), ("obj", 6)])
def test_what_is_too_far_for_single_precision_has_no_mesh(export, views, file_format, meshes):
    images = views.replaced(landmarks=views.landmarks.copy())
    images.landmarks[2] *= 1e45
    _, outcomes = export(images, format=file_format)
    assert outcomes[-1].note == f"y down in the images; {meshes} meshes"
    warnings = [warning for outcome in outcomes for warning in outcome.warnings]
    assert len(warnings) == 6 - meshes
    assert all("beyond 1e+38, too far for the format: 1; they have no mesh" in w for w in warnings)


@pytest.mark.parametrize(
    ("unit", "frame", "file_format"),
    [("landmarks", "camera", "ply"), ("dictionary", "object", "glb")],
)
def test_people_are_a_closed_tube_a_bone(
    project, export, people, read_one, metres, file_format, unit, frame
):
    poses = load(project / "sample_data/people_views.csv")
    dictionary = read_dictionary(people)
    found, outcomes = export(poses, people, format=file_format, unit=unit, frame=frame)
    assert outcomes[-1].note == "y down in the images; 12 meshes"
    for image, item in enumerate(found.items):
        points = found.shapes[image]
        if unit == "dictionary":
            size = metres(dictionary, found, image) / found.scale[image]
            points = size * found.rotation[image].T @ (points - origin(found, image))
        mesh = read_one(item, file_format)
        assert mesh.is_watertight
        assert mesh.is_winding_consistent
        assert mesh.volume > 0
        parts = mesh.split()
        assert len(parts) == len(dictionary.edges)
        middles = np.array([part.vertices.mean(axis=0) for part in parts])
        expected = points[:, dictionary.edges].mean(axis=2).T
        apart = np.linalg.norm(middles[:, None] - expected[None], axis=2)
        assert apart.min(axis=0).max() < 1e-6 * np.ptp(points, axis=1).max()
