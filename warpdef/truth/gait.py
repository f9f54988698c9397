"""A walk cycle: the joint angles of a walking figure and the path of its pelvis, frame by frame.

Angles follow the usual curves of human gait (hip: one swing a cycle; knee: a small bend when the leg takes the weight
and a large one while it swings; ankle: down at push-off). Degrees; a cycle is two steps.
"""

from __future__ import annotations

import numpy as np

from warpdef.truth.body import JOINTS
from warpdef.truth.skinning import chain_motions

CYCLE_FRAMES = 40
"""Frames of a whole cycle of two steps."""
SPEED = 0.031
"""Way of the pelvis along its path, metres a frame."""
TURN = 4.5
"""Turn of the whole body to its left, degrees a frame: 72 over 17 frames."""

_PARENT = {
    "pelvis": None,
    "abdomen": "pelvis",
    "chest": "abdomen",
    "neck": "chest",
    "head": "neck",
    "upper_arm": "chest",
    "forearm": "upper_arm",
    "hand": "forearm",
    "thigh": "pelvis",
    "shin": "thigh",
    "foot": "shin",
}


def _bones() -> tuple[tuple[str, ...], tuple[int, ...], np.ndarray]:
    names, parents, joints = [], [], []
    for bone, parent in _PARENT.items():
        paired = JOINTS[bone][0] > 0
        for suffix, side in (("_l", 1.0), ("_r", -1.0)) if paired else (("", 1.0),):
            names.append(bone + suffix)
            of_pair = paired and parent is not None and JOINTS[parent][0] > 0
            parents.append(-1 if parent is None else names.index(parent + suffix if of_pair else parent))
            joints.append(JOINTS[bone] * [side, 1.0, 1.0])
    return tuple(names), tuple(parents), np.array(joints)


BONES, PARENTS, BONE_JOINTS = _bones()
_SOLE_POINTS = np.array([[0.113, 0.002, -0.060], [0.124, 0.002, 0.110], [0.126, 0.006, 0.165]])


def _turn(axis: str, degrees: float) -> np.ndarray:
    """Rotation matrix about x, y or z."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    matrix = np.eye(3)
    matrix[i, i], matrix[i, j], matrix[j, i], matrix[j, j] = c, -s, s, c
    return matrix


def _bump(phase: float, centre: float, width: float) -> float:
    """A periodic bell of height 1 at ``centre``; degrees."""
    return float(np.exp((np.cos(np.radians(phase - centre)) - 1.0) / np.radians(width) ** 2))


def _leg(phase: float) -> tuple[float, float, float]:
    """Flexion of hip, knee and ankle; phase 0 is the strike of the heel, the foot leaves the ground near 220."""
    hip = 6.0 + 25.0 * np.cos(np.radians(phase + 12.0))
    knee = 6.0 + 12.0 * _bump(phase, 50.0, 30.0) + 46.0 * _bump(phase, 262.0, 40.0)
    ankle = 8.0 * _bump(phase, 150.0, 50.0) - 20.0 * _bump(phase, 226.0, 26.0) - 3.0 * _bump(phase, 25.0, 25.0)
    return float(hip), knee, ankle


def _local_rotations(phase: float, heading: float) -> np.ndarray:
    """Rotation of every bone relative to its parent, shape (B, 3, 3); ``phase`` is the left leg's."""
    swing = np.cos(np.radians(phase))
    sway = np.sin(np.radians(phase))
    rotation = {
        # The pelvis follows the swinging leg; the chest turns against it and looks a little into the turn.
        "pelvis": _turn("y", heading - 6.0 * swing) @ _turn("z", 3.0 * sway) @ _turn("x", 3.0),
        "abdomen": _turn("y", 5.0 * swing + 1.0) @ _turn("z", -2.0 * sway) @ _turn("x", 2.0),
        "chest": _turn("y", 8.0 * swing + 3.0) @ _turn("z", -1.5 * sway),
        "neck": _turn("y", -3.0 * swing + 4.0) @ _turn("x", -2.0),
        "head": _turn("y", -4.0 * swing + 6.0) @ _turn("x", -1.0),
    }
    for suffix, side, leg_phase in (("_l", 1.0, phase), ("_r", -1.0, phase + 180.0)):
        hip, knee, ankle = _leg(leg_phase)
        rotation["thigh" + suffix] = _turn("x", -hip)
        rotation["shin" + suffix] = _turn("x", knee)
        rotation["foot" + suffix] = _turn("x", -ankle)
        # Arms hang 15 degrees off the vertical and swing against the leg of their side.
        arm_swing = -np.cos(np.radians(leg_phase - 8.0))
        lower = _turn("z", side * -30.0)
        rotation["upper_arm" + suffix] = _turn("x", -(3.0 + 22.0 * arm_swing)) @ lower
        bend = 22.0 + 9.0 * arm_swing
        rotation["forearm" + suffix] = lower.T @ _turn("x", -bend) @ lower
        rotation["hand" + suffix] = lower.T @ _turn("x", -8.0) @ lower
    return np.array([rotation[name] for name in BONES])


def _ground_height(rotations: np.ndarray, translations: np.ndarray) -> float:
    """Height of the lowest place of the soles, smooth where the weight goes from one foot to the other."""
    heights = []
    for suffix, side in (("_l", 1.0), ("_r", -1.0)):
        bone = BONES.index("foot" + suffix)
        heights.append((_SOLE_POINTS * [side, 1.0, 1.0]) @ rotations[bone].T + translations[bone])
    heights = np.concatenate(heights)[:, 1]
    softness = 0.008
    return float(-softness * np.log(np.exp(-heights / softness).sum()))


def walk_motions(frames: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Rigid motion of every bone in each frame of a walk that turns to the left.

    Returns:
        ``frames`` pairs of rotations (B, 3, 3) and translations (B, 3), x -> R x + t on the rest pose; metres.
    """
    motions = []
    at = np.zeros(3)
    for frame in range(frames):
        heading = TURN * (frame - (frames - 1) / 2.0)
        direction = np.radians(heading)
        if frame > 0:
            at = at + SPEED * np.array([np.sin(direction), 0.0, np.cos(direction)])
        local = _local_rotations(360.0 * frame / CYCLE_FRAMES + 20.0, heading)
        root = at + [0.0, BONE_JOINTS[0][1], 0.0]
        rotations, translations = chain_motions(PARENTS, BONE_JOINTS, local, root)
        # The feet stand on the ground, which makes the pelvis bob.
        translations[:, 1] -= _ground_height(rotations, translations)
        motions.append((rotations, translations))
    return motions
