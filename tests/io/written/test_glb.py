"""GLB is posed by another program: joints are where the landmarks of the result were."""

import json
import struct

import numpy as np
import pytest
import trimesh

from shapefit.geometry.rotations import rotation_about_axis
from shapefit.io import read_shapes
from shapefit.io.skeletons import PEOPLE
from shapefit.io.written.glb import quaternions
from tests.io.files import save
from tests.io.written.test_bvh import MILLIMETRE, NAMES

DTYPES = {5126: "<f4", 5125: "<u4", 5123: "<u2"}
WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}


class File:
    """A GLB file in memory."""

    def __init__(self, path):
        content = path.read_bytes()
        magic, version, size = struct.unpack_from("<4sII", content)
        assert (magic, version, size) == (b"glTF", 2, len(content))
        length, kind = struct.unpack_from("<I4s", content, 12)
        size, other = struct.unpack_from("<I4s", content, 20 + length)
        assert (kind, other) == (b"JSON", b"BIN\0")
        assert (length % 4, size % 4) == (0, 0)  # chunks begin at multiples of 4 bytes
        assert len(content) == 28 + length + size
        self.parts = json.loads(content[20 : 20 + length])
        self.numbers = content[28 + length :]

    def array(self, accessor):
        about = self.parts["accessors"][accessor]
        start = self.parts["bufferViews"][about["bufferView"]]["byteOffset"]
        width, dtype = WIDTHS[about["type"]], DTYPES[about["componentType"]]
        values = np.frombuffer(self.numbers, dtype, about["count"] * width, start)
        return values.reshape(-1, width)

    def posed(self, path, frame):
        """Return the scene as trimesh reads it once every node is as it is in a frame."""
        (animation,) = self.parts["animations"]
        for channel in animation["channels"]:
            values = self.array(animation["samplers"][channel["sampler"]]["output"])
            target = channel["target"]
            self.parts["nodes"][target["node"]][target["path"]] = values[frame].tolist()
        text = json.dumps(self.parts).encode()
        text += b" " * (-len(text) % 4)
        head = struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(self.numbers))
        chunks = struct.pack("<II", len(text), 0x4E4F534A), text
        numbers = struct.pack("<II", len(self.numbers), 0x004E4942), self.numbers
        path.write_bytes(b"".join((head, *chunks, *numbers)))
        return trimesh.load(path)


@pytest.fixture(scope="module")
def throw(project):
    """A person who throws, 80 frames."""
    shapes = read_shapes([project / "sample_data/people_test.h5"])
    return shapes.take(np.array(shapes.sequences) == "throw_emil")


def test_joints_are_where_the_landmarks_were(tmp_path, throw):
    save(tmp_path / "man.glb", throw)
    file = File(tmp_path / "man.glb")
    (sampler, *_) = file.parts["animations"][0]["samplers"]
    np.testing.assert_allclose(file.array(sampler["input"])[:, 0], np.arange(80) / 24, atol=1e-6)
    for frame in (0, 33, 61):
        posed = file.posed(tmp_path / "posed.glb", frame)
        for joint, name in NAMES.items():
            place = posed.graph.get(name)[0][:3, 3]
            truth = throw.shapes[frame, :, PEOPLE.index(joint)]
            np.testing.assert_allclose(place, truth, atol=0.02 * MILLIMETRE)


def test_between_frames_rotations_take_the_short_way(tmp_path, throw):
    save(tmp_path / "man.glb", throw)
    file = File(tmp_path / "man.glb")
    (animation,) = file.parts["animations"]
    for channel in animation["channels"]:
        if channel["target"]["path"] == "rotation":
            q = file.array(animation["samplers"][channel["sampler"]]["output"])
            assert (q[1:] * q[:-1]).sum(axis=1).min() > 0.9


def test_a_body_that_turns_twice_has_no_jump():
    q = quaternions(rotation_about_axis(1, np.linspace(0, 4 * np.pi, 101)))
    assert (q[1:] * q[:-1]).sum(axis=1).min() > 0.99
    np.testing.assert_allclose(q[50], -q[0], atol=1e-9)  # as one turn has it


def test_the_skin_follows_its_bones(tmp_path, throw):
    """The middle of each solid is that of its bone, once its vertices have moved with the nodes."""
    save(tmp_path / "man.glb", throw)
    file = File(tmp_path / "man.glb")
    (skin,), (mesh,) = file.parts["skins"], file.parts["meshes"]
    (solid,) = mesh["primitives"]
    vertices, carriers, weights = (
        file.array(solid["attributes"][name]) for name in ("POSITION", "JOINTS_0", "WEIGHTS_0")
    )
    inverse = file.array(skin["inverseBindMatrices"]).reshape(-1, 4, 4).swapaxes(1, 2)
    names = [file.parts["nodes"][joint]["name"] for joint in skin["joints"]]
    posed = file.posed(tmp_path / "posed.glb", 61)
    world = np.array([posed.graph.get(name)[0] for name in names])
    moves = (weights[..., None, None] * (world @ inverse)[carriers]).sum(axis=1)
    moved = (moves @ np.c_[vertices, np.ones(len(vertices))][..., None])[:, :3, 0]
    middles = moved.reshape(len(throw.edges), -1, 3).mean(axis=1)
    for a, b in throw.edges:
        middle = throw.shapes[61][:, [a, b]].mean(axis=1)
        assert np.linalg.norm(middles - middle, axis=1).min() < 0.05 * MILLIMETRE


def test_several_people_are_several_skins_as_far_apart_as_in_the_image(tmp_path, scene, without):
    flat = without(scene.result, "camera_translation", "extrinsic_rotation")
    beside = flat.replaced(
        items=tuple(item.replace("anna", "ben") for item in flat.items),
        sequences=("film/ben",) * len(flat),
        shapes=flat.shapes + np.array([300.0, 40, 0])[:, None],
        translation=flat.translation + np.array([300.0, 40]),
    )
    summary = save(tmp_path / "film.glb", flat, beside)
    assert summary.written == (tmp_path / "film.glb",)
    file = File(tmp_path / "film.glb")
    assert [skin["name"] for skin in file.parts["skins"]] == ["film/anna", "film/ben"]
    colours = [m["pbrMetallicRoughness"]["baseColorFactor"] for m in file.parts["materials"]]
    assert colours[0] != colours[1]
    posed = file.posed(tmp_path / "posed.glb", 0)
    nodes = [file.parts["nodes"][skin["skeleton"]]["translation"] for skin in file.parts["skins"]]
    assert {"film/anna", "film/ben"} <= set(posed.graph.nodes)
    metres = float(np.median(flat.columns["metres_per_unit"]))
    np.testing.assert_allclose(np.subtract(*nodes[::-1]), [300 * metres, 0, 0], atol=MILLIMETRE)


def test_trimesh_shows_the_pose_at_rest(tmp_path, scene):
    """A T: as wide as shoulders and arms, as high as legs, trunk and head."""
    save(tmp_path / "man.glb", scene.result)
    loaded = trimesh.load(tmp_path / "man.glb")
    man = dict(zip(scene.result.landmark_names, scene.y_up[0].T, strict=True))

    def along(*joints):
        bones = np.diff([man[joint] for joint in joints], axis=0)
        return np.linalg.norm(bones, axis=1).sum()

    wide = sum(along("neck", *(f"{s}{j}" for j in ("shoulder", "elbow", "wrist"))) for s in "lr")
    high = along("rhip", "rknee", "rankle") + along("pelvis", "neck", "head")
    high += along("pelvis", "rhip") / np.sqrt(2)
    np.testing.assert_allclose(np.ptp(loaded.bounds, axis=0)[:2], [wide, high], atol=0.06)
    assert all(geometry.is_watertight for geometry in loaded.geometry.values())
