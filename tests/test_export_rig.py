"""Quantised .glb, .glb with a rig, and .bvh, read back by their specifications."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from glb_reader import Glb
from scipy.spatial.transform import Rotation
from synthetic import bending_bar

from warpdef.errors import InputError, MissingPackageError
from warpdef.export import export
from warpdef.export.animation import Animation
from warpdef.export.gltf import normal_offsets, quantisation
from warpdef.mesh import MeshSequence
from warpdef.rig.decompose import fit_rig

BAR = bending_bar(5, 20, np.random.default_rng(0), subdivisions=2)
VERTICES = (BAR.vertices * 137.0 + [1000.0, -3.0, 0.25]).astype(np.float32)
COLORS = np.random.default_rng(1).integers(0, 256, (VERTICES.shape[1], 3), dtype=np.uint8)
PLAIN = Animation(MeshSequence(VERTICES, BAR.faces), fps=10.0)
TURNED = Animation(MeshSequence(VERTICES, BAR.faces), fps=25.0, up="z", metres_per_unit=0.01, colors=COLORS)
Z_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


def shown(glb: Glb) -> tuple[np.ndarray, np.ndarray]:
    """Places and normals that a program shows with each target alone at weight 1, the base first; both (T, V, 3)."""
    primitive = glb.json["meshes"][0]["primitives"][0]
    matrix = glb.transform(0)
    base = [glb.numbers(primitive["attributes"][name]) for name in ("POSITION", "NORMAL")]
    places, normals = [base[0]], [base[1]]
    for target in primitive["targets"]:
        places.append(base[0] + glb.numbers(target["POSITION"]))
        normals.append(base[1] + glb.numbers(target["NORMAL"]))
    turned = np.stack(normals) @ matrix[:3, :3].T
    return np.stack(places) @ matrix[:3, :3].T + matrix[:3, 3], turned / np.linalg.norm(turned, axis=2, keepdims=True)


def test_quantised_glb(tmp_path):
    export(TURNED, tmp_path / "bar.glb")
    glb = Glb(tmp_path / "bar.glb")
    assert glb.json["extensionsRequired"] == glb.json["extensionsUsed"] == ["KHR_mesh_quantization"]
    primitive = glb.json["meshes"][0]["primitives"][0]
    np.testing.assert_array_equal(glb.array(primitive["indices"]).reshape(-1, 3), BAR.faces)
    step = quantisation(VERTICES)[1] * 0.01
    places, normals = shown(glb)
    np.testing.assert_allclose(places, VERTICES @ (0.01 * Z_UP).T, rtol=0, atol=0.51 * step)
    assert step < 2e-5 * np.ptp(0.01 * VERTICES, axis=(0, 1)).max()
    true = np.stack([TURNED.normals_of(t) for t in range(5)]) @ Z_UP.T
    assert (normals * true).sum(axis=2).min() > np.cos(np.radians(2.0))
    # Base normals count as unit, and bytes do where nothing turns about.
    base = glb.numbers(primitive["attributes"]["NORMAL"])
    np.testing.assert_allclose(np.linalg.norm(base, axis=1), 1.0, atol=0.0067)
    kinds = {glb.json["accessors"][target["NORMAL"]]["componentType"] for target in primitive["targets"]}
    assert kinds == {5120}


def test_quantised_is_small(tmp_path):
    sizes = []
    for precise in (True, False):
        export(PLAIN, tmp_path / f"{precise}.glb", precise=precise)
        sizes.append(sum(view["byteLength"] for view in Glb(tmp_path / f"{precise}.glb").json["bufferViews"]))
    assert sizes[1] < 0.6 * sizes[0]


def test_normals_that_turn_about():
    rng = np.random.default_rng(0)
    axes = np.concatenate([np.eye(3), -np.eye(3), Rotation.random(500, np.random.default_rng(1)).as_matrix()[:, 0]])
    base = np.rint(axes * 0.995 * 32767).astype(np.int16)
    for normals in (-axes, axes[rng.permutation(len(axes))], axes):
        offset = normal_offsets(base, normals)
        most = np.iinfo(offset.dtype).max
        assert np.abs(offset.astype(int)).max() <= most
        said = base / 32767.0 + offset / float(most)
        cosine = (said * normals).sum(axis=1) / np.linalg.norm(said, axis=1)
        assert cosine.min() > np.cos(np.radians(2.0))
    assert normal_offsets(base, axes).dtype == np.int8 and normal_offsets(base, -axes).dtype == np.int16


@pytest.mark.parametrize("animation", [PLAIN, TURNED], ids=["plain", "turned"])
def test_rigged_glb_moves_as_the_rig_does(tmp_path, animation):
    rig = fit_rig(animation.vertices, 5)
    export(animation, tmp_path / "bar.glb", rig=rig)
    glb = Glb(tmp_path / "bar.glb")
    nodes, (skin,), (motion,) = glb.json["nodes"], glb.json["skins"], glb.json["animations"]
    primitive = glb.json["meshes"][0]["primitives"][0]
    assert ("COLOR_0" in primitive["attributes"]) == (animation.colors is not None)
    np.testing.assert_array_equal(glb.array(primitive["indices"]).reshape(-1, 3), BAR.faces)
    rest = glb.numbers(primitive["attributes"]["POSITION"])
    joints, weights = (glb.array(primitive["attributes"][name]) for name in ("JOINTS_0", "WEIGHTS_0"))
    assert (weights.sum(axis=1, dtype=int) == 65535).all()
    inverse = glb.numbers(skin["inverseBindMatrices"]).reshape(-1, 4, 4).swapaxes(1, 2)
    expected = rig.vertices()
    if animation.up == "z":
        expected = 0.01 * expected @ Z_UP.T
    parent_of = {child: parent for parent, node in enumerate(nodes) for child in node.get("children", [])}
    for t in range(len(animation)):
        for channel in motion["channels"]:
            sampler = motion["samplers"][channel["sampler"]]
            np.testing.assert_allclose(glb.array(sampler["input"])[t, 0], t / animation.fps, rtol=1e-6)
            nodes[channel["target"]["node"]][channel["target"]["path"]] = glb.array(sampler["output"])[t].tolist()
        matrices = []
        for joint, back in zip(skin["joints"], inverse, strict=True):
            matrix, node = glb.transform(joint), joint
            while node in parent_of:
                node = parent_of[node]
                matrix = glb.transform(node) @ matrix
            matrices.append((matrix @ back)[:3])
        blend = np.einsum("vk,vkij->vij", weights / 65535.0, np.stack(matrices)[joints])
        moved = np.einsum("vij,vj->vi", blend[:, :, :3], rest) + blend[:, :, 3]
        np.testing.assert_allclose(moved, expected[t], rtol=0, atol=2e-5 * np.abs(expected).max())


def test_the_rest_shape_stands_in_its_bind_pose(tmp_path):
    """Without the animation every joint's matrix undoes its inverse bind matrix."""
    export(PLAIN, tmp_path / "bar.glb", rig=fit_rig(VERTICES, 4))
    glb = Glb(tmp_path / "bar.glb")
    inverse = glb.numbers(glb.json["skins"][0]["inverseBindMatrices"]).reshape(-1, 4, 4).swapaxes(1, 2)
    parent_of = {child: parent for parent, node in enumerate(glb.json["nodes"]) for child in node.get("children", [])}
    for joint, back in zip(glb.json["skins"][0]["joints"], inverse, strict=True):
        matrix, node = glb.transform(joint), joint
        while node in parent_of:
            node = parent_of[node]
            matrix = glb.transform(node) @ matrix
        np.testing.assert_allclose(matrix @ back, np.eye(4), atol=1e-3)


def read_bvh(text: str) -> tuple[list[int], np.ndarray, np.ndarray, float]:
    """Parents, offsets (B, 3), channels (T, B, 6) and seconds a frame."""
    parents, offsets, stack, end = [], [], [], False
    lines = iter(text.splitlines())
    for line in lines:
        words = line.split()
        if words[0] in ("ROOT", "JOINT"):
            parents.append(stack[-1] if stack else -1)
            stack.append(len(parents) - 1)
        elif words[0] == "End":
            end = True
            stack.append(-2)
        elif words[0] == "OFFSET" and not end:
            offsets.append([float(x) for x in words[1:]])
        elif words[0] == "CHANNELS":
            assert words[1:] == "6 Xposition Yposition Zposition Zrotation Xrotation Yrotation".split()
        elif words[0] == "}":
            stack.pop()
            end = False
        elif words[0] == "MOTION":
            break
    frames, seconds = int(next(lines).split()[1]), float(next(lines).split()[2])
    values = np.array([[float(x) for x in line.split()] for line in lines]).reshape(frames, len(parents), 6)
    return parents, np.array(offsets), values, seconds


@pytest.mark.parametrize("animation", [PLAIN, TURNED], ids=["plain", "turned"])
def test_bvh_moves_as_the_rig_does(tmp_path, animation):
    rig = fit_rig(animation.vertices, 5)
    export(animation, tmp_path / "bar.bvh", rig=rig)
    parents, offsets, values, seconds = read_bvh((tmp_path / "bar.bvh").read_text())
    assert seconds == pytest.approx(1.0 / animation.fps) and len(values) == 5 and len(parents) == rig.bone_count
    up = Z_UP if animation.up == "z" else np.eye(3)
    bones = up @ rig.bones[..., :3] @ up.T
    shifts = rig.bones[..., 3] @ up.T
    found = []
    for t in range(5):
        worlds, rests = [], []
        for joint, parent in enumerate(parents):
            local = np.eye(4)
            local[:3, :3] = Rotation.from_euler("ZXY", values[t, joint, 3:], degrees=True).as_matrix()
            local[:3, 3] = values[t, joint, :3]
            worlds.append(local if parent < 0 else worlds[parent] @ local)
            rests.append(offsets[joint] + (0.0 if parent < 0 else rests[parent]))
        # x -> W (x - rest of the joint) is a bone's motion.
        found.append(
            [np.column_stack([w[:3, :3], w[:3, 3] - w[:3, :3] @ r]) for w, r in zip(worlds, rests, strict=True)]
        )
    found = np.array(found)
    expected = np.concatenate([bones, shifts[..., None]], axis=3)
    apart = np.abs(found[:, :, None] - expected[:, None]).max(axis=(0, 3, 4))
    assert sorted(apart.argmin(axis=1)) == list(range(rig.bone_count))
    assert apart.min(axis=1).max() < 1e-4 * np.abs(VERTICES).max()


def test_a_rig_needs_a_format_of_bones(tmp_path):
    with pytest.raises(InputError, match="expected .glb or .bvh for a rig"):
        export(PLAIN, tmp_path / "bar.obj", rig=fit_rig(VERTICES, 2))
    with pytest.raises(InputError, match="give --bones auto"):
        export(PLAIN, tmp_path / "bar.bvh")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("rigged", [False, True])
def test_a_packed_glb_holds_what_the_other_holds(tmp_path, rigged):
    """Unpacked by the codec's own reader: every array byte for byte, triangles but for which corner is first."""
    meshopt = pytest.importorskip("meshopt")
    rig = fit_rig(VERTICES, 3) if rigged else None
    plain, packed = tmp_path / "plain.glb", tmp_path / "packed.glb"
    export(TURNED, plain, rig=rig)
    export(TURNED, packed, rig=rig, meshopt=True)
    plain, packed = Glb(plain), Glb(packed)
    name = "EXT_meshopt_compression"
    assert packed.json["extensionsRequired"] == plain.json.get("extensionsRequired", []) + [name]
    assert packed.json["accessors"] == plain.json["accessors"]
    there, absent = packed.json["buffers"]
    assert absent == {"byteLength": plain.json["buffers"][0]["byteLength"], "extensions": {name: {"fallback": True}}}
    assert there["byteLength"] < absent["byteLength"]
    for view, packed_view in zip(plain.json["bufferViews"], packed.json["bufferViews"], strict=True):
        how = packed_view.pop("extensions")[name]
        assert packed_view == view | {"buffer": 1}
        data = packed.binary[how["byteOffset"] : how["byteOffset"] + how["byteLength"]]
        rows = meshopt.decode_gltf_buffer(data, how["count"], how["byteStride"], how["mode"])
        kept = plain.binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
        if how["mode"] == "ATTRIBUTES":
            assert rows.tobytes() == kept
        else:
            np.testing.assert_array_equal(first_corner_first(rows), first_corner_first(np.frombuffer(kept, "<u2")))


def first_corner_first(corners: np.ndarray) -> np.ndarray:
    """Triangles, each turned so that its least corner comes first."""
    faces = corners.reshape(-1, 3).astype(int)
    return np.stack([np.roll(face, -face.argmin()) for face in faces])


def test_only_glb_is_packed_and_a_missing_codec_is_told(tmp_path, monkeypatch):
    with pytest.raises(InputError, match="expected .glb for --meshopt"):
        export(PLAIN, tmp_path / "bar.usdc", meshopt=True)
    monkeypatch.setitem(sys.modules, "meshopt", None)
    with pytest.raises(MissingPackageError, match=r"warpdef\[meshopt\]"):
        export(PLAIN, tmp_path / "bar.glb", meshopt=True)
    assert list(tmp_path.iterdir()) == []
