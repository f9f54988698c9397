"""A moving mesh as binary glTF with a rig: joints that carry the mesh by linear blend skinning, and their motion.

Positions, joints and bones are the data's own numbers; the node above the root joint carries the turn from z up to
glTF's y up, the scale to metres, and the way to data far from its origin. The mesh's own node stands beside it: glTF
moves a skinned mesh by its joints alone.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from warpdef.export.animation import Animation
from warpdef.export.gltf_buffer import VERTICES, Buffer
from warpdef.export.gltf_parts import add_colors, add_look, add_material, place_node, start_document
from warpdef.export.vertex_normals import vertex_normals
from warpdef.rig.decompose import Rig
from warpdef.rig.skeleton import Skeleton, build_skeleton

_MESH_NODE, _ARMATURE, _FIRST_JOINT = 0, 1, 2


def write_rigged_glb(animation: Animation, path: Path, rig: Rig, meshopt: bool = False) -> None:
    """Write the mesh in its rest shape, with the rig that moves it, to ``path``.

    Args:
        meshopt: pack the arrays, for programs that know EXT_meshopt_compression.

    Raises:
        MissingPackageError: meshopt is asked for and not installed.
        InputError: more than the 4 GiB that the format can hold.
    """
    buffer, skeleton = Buffer(meshopt), build_skeleton(rig)
    document = start_document()
    document["scenes"] = [{"nodes": [_MESH_NODE, _ARMATURE]}]
    document["nodes"] = [
        {"name": "mesh", "mesh": 0, "skin": 0},
        {"name": "warpdef", "children": [_FIRST_JOINT]} | place_node(animation),
        *_joint_nodes(skeleton),
    ]
    document["meshes"] = [{"primitives": [_skinned_mesh(animation, rig, skeleton, buffer)]}]
    document["skins"] = [_skin(skeleton, buffer)]
    add_material(animation, buffer, document)
    if len(animation) > 1:
        document["animations"] = [_motion(animation, skeleton, buffer)]
    buffer.write(path, document)


def _skinned_mesh(animation: Animation, rig: Rig, skeleton: Skeleton, buffer: Buffer) -> dict[str, Any]:
    count = len(rig.rest)
    joint_of_bone = np.argsort(skeleton.order)
    joints, weights = np.zeros((count, 4), dtype=np.uint16), np.zeros((count, 4), dtype=np.uint16)
    kept = rig.weights.shape[1]
    weights[:, :kept] = np.rint(rig.weights * 65535)
    # Rows sum to 1 in the file's own numbers: what rounding left over goes to the largest weight, the first.
    weights[:, 0] += (65535 - weights.sum(axis=1, dtype=np.int64)).astype(np.int64).astype(np.uint16)
    joints[:, :kept] = joint_of_bone[rig.joints]
    joints[weights == 0] = 0
    small = len(skeleton.parents) <= 256
    rest = rig.rest.astype(np.float32)
    attributes = {
        "POSITION": buffer.add(rest, bounds=True, target=VERTICES),
        "NORMAL": buffer.add(vertex_normals(rest, animation.faces), target=VERTICES),
        "JOINTS_0": buffer.add(joints.astype(np.uint8) if small else joints, target=VERTICES),
        "WEIGHTS_0": buffer.add(weights, target=VERTICES, normalized=True),
        **add_look(animation, buffer),
    }
    if animation.measured is not None:
        # A rig moves no colours: the mean over the frames.
        mean = animation.measured.over_time()
        attributes["COLOR_0"] = add_colors(mean.colors()[0], buffer)
    return {"attributes": attributes, "indices": buffer.add_triangles(animation.faces, count), "material": 0}


def _joint_nodes(skeleton: Skeleton) -> list[dict[str, Any]]:
    """Nodes of the joints as they stand in the rest shape, unturned."""
    nodes: list[dict[str, Any]] = []
    for joint, (name, parent) in enumerate(zip(skeleton.names, skeleton.parents.tolist(), strict=True)):
        place = skeleton.places[joint] - (skeleton.places[parent] if parent >= 0 else 0.0)
        node: dict[str, Any] = {"name": name, "translation": place.tolist()}
        children = (np.flatnonzero(skeleton.parents == joint) + _FIRST_JOINT).tolist()
        nodes.append(node | ({"children": children} if children else {}))
    return nodes


def _skin(skeleton: Skeleton, buffer: Buffer) -> dict[str, Any]:
    number = len(skeleton.parents)
    inverse = np.tile(np.eye(4, dtype=np.float32), (number, 1, 1))
    inverse[:, 3, :3] = -skeleton.places  # columns one after the other, as glTF keeps matrices
    return {
        "inverseBindMatrices": buffer.add(inverse.reshape(number, 16)),
        "skeleton": _FIRST_JOINT,
        "joints": list(range(_FIRST_JOINT, _FIRST_JOINT + number)),
    }


def _motion(animation: Animation, skeleton: Skeleton, buffer: Buffer) -> dict[str, Any]:
    times = buffer.add(animation.times, bounds=True)
    samplers, channels = [], []
    for joint in range(len(skeleton.parents)):
        tracks = (("rotation", skeleton.rotations), ("translation", skeleton.translations))
        for track, values in tracks:
            output = buffer.add(np.ascontiguousarray(values[:, joint], dtype=np.float32))
            channels.append({"sampler": len(samplers), "target": {"node": joint + _FIRST_JOINT, "path": track}})
            samplers.append({"input": times, "output": output, "interpolation": "LINEAR"})
    return {"name": "motion", "samplers": samplers, "channels": channels}
