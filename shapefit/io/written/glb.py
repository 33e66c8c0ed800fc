"""Write GLB, the file of scenes: for each individual a skeleton in motion, in a skin of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from shapefit.arrays import Floats
from shapefit.geometry.bone_tree import find_bones
from shapefit.geometry.joint_rotations import Rig, find_places
from shapefit.io.written.gltf import Scene, add_morph, quaternions
from shapefit.io.written.motion import Motion
from shapefit.io.written.outputs import by_video, motion_output
from shapefit.io.written.rig import node_names, rigged
from shapefit.meshes.wireframe import tubes

THICKNESS = 0.03
"""Diameter of a bone, as a share of the largest extent of the body at rest."""

COLOURS = ((0.3, 0.47, 0.66), (0.9, 0.5, 0.2), (0.35, 0.63, 0.35), (0.75, 0.35, 0.55))
"""Of one individual after the other, and again."""


def prepared(motions: Sequence[Motion], place: str) -> tuple[list[Motion], str]:
    """Return motions with rigs, but for those of meshes; see `rigged`."""
    bones, note = [motion for motion in motions if motion.morph is None], ""
    if bones:
        bones, note = rigged(bones, place)
    found = iter(bones)
    return [next(found) if each.morph is None else each for each in motions], note


def write_glb(path: Path, motions: Sequence[Motion]) -> None:
    """Write the individuals of a video, as far from each other as in the image.

    Times count from the first frame of any of them.
    """
    scene, roots = Scene(), []
    first = min(motion.first for motion in motions)
    for number, motion in enumerate(motions):
        beside = motion.start - motions[0].start
        times = (motion.frames - first) / motion.rate
        name = motion.name or "motion"
        look = {"baseColorFactor": [*COLOURS[number % len(COLOURS)], 1.0], "metallicFactor": 0.0}
        material = scene.add("materials", name=name, pbrMetallicRoughness=look)
        if motion.morph is not None:
            morph = replace(motion.morph, translation=motion.morph.translation + beside)
            roots.append(add_morph(scene, morph, times[morph.frames], name, material))
            continue
        assert motion.rig is not None
        rig = replace(motion.rig, root=motion.rig.root + beside)
        here = _add_nodes(scene, rig, node_names(motion), times)
        mesh, skin = _skin(scene, rig, here, name, material)
        roots += [here, scene.add("nodes", name=name, mesh=mesh, skin=skin)]
    scene.write(path, roots)


glb_output = motion_output(write_glb, by_video, prepare=prepared)


def _add_nodes(scene: Scene, rig: Rig, names: Sequence[str], times: Floats) -> int:
    """Add the nodes of a rig, and how they turn; returns the number of the first."""
    here, at = len(scene.parts.get("nodes", ())), scene.store(times)
    for node, name in enumerate(names):
        offset = rig.offsets[node] if node else rig.root[rig.rest]
        children = [here + below for below, each in enumerate(rig.tree) if each.above == node]
        scene.add("nodes", name=name, translation=offset.tolist(), children=children or None)
        if rig.tree[node].aims:
            scene.animate(here + node, "rotation", at, quaternions(rig.rotations[node]))
    scene.animate(here, "translation", at, rig.root)
    return here


def _skin(scene: Scene, rig: Rig, here: int, name: str, material: int) -> tuple[int, int]:
    """Add a solid per bone, which turns with the node that aims along it, and what joins them."""
    rest = find_places(rig)[:, rig.rest]
    node_of = {node.joint: number for number, node in reversed([*enumerate(rig.tree)])}
    order = {joint: place for place, joint in enumerate(node_of)}
    bones = {
        tuple(sorted((order[end], order[start]))): rig.tree[node_of[end]].above
        for end, start in find_bones(rig.tree).items()
    }
    pairs = sorted(bones)  # as `tubes` takes them
    vertices, faces = tubes(rest[[*node_of.values()]].T, np.array(pairs), THICKNESS)
    carriers = np.repeat([bones[pair] for pair in pairs], vertices.shape[1] // len(pairs))
    influence = np.eye(1, 4) * np.ones((len(carriers), 1))
    inverse = np.tile(np.eye(4), (len(rest), 1, 1))
    inverse[:, 3, :3] = -rest  # column after column
    attributes = {
        "POSITION": scene.store(vertices.T),
        "JOINTS_0": scene.store(influence * carriers[:, None], "uint16"),
        "WEIGHTS_0": scene.store(influence),
    }
    faces_of = scene.store(faces.ravel(), "uint32")
    solid = {"attributes": attributes, "indices": faces_of, "material": material}
    skin = scene.add(
        "skins",
        name=name,
        joints=[here + number for number in range(len(rest))],
        inverseBindMatrices=scene.store(inverse.reshape(-1, 16)),
        skeleton=here,
    )
    return scene.add("meshes", name=name, primitives=[solid]), skin
