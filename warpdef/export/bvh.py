"""The bones of a moving mesh as .bvh (Biovision hierarchy), for programs that take motion capture.

Six channels a joint: its place in its parent's frame and its turn, so that bones which drift apart are kept. y is up,
as the format has it: data with z up is turned. Lengths are the data's; the format has no unit.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from warpdef.export.animation import Animation
from warpdef.rig.decompose import Rig
from warpdef.rig.skeleton import Skeleton, build_skeleton

_Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # from z up


def write_bvh(animation: Animation, path: Path, rig: Rig) -> None:
    """Write the rig's skeleton in its rest shape, and its motion."""
    from scipy.spatial.transform import Rotation

    skeleton = build_skeleton(rig)
    places, shifts, turns = skeleton.places.copy(), skeleton.translations.copy(), skeleton.rotations
    frames, number = turns.shape[:2]
    places += animation.origin
    shifts[:, 0] += animation.origin
    matrices = Rotation.from_quat(turns.reshape(-1, 4)).as_matrix()
    if animation.up == "z":
        places, shifts = places @ _Y_UP.T, shifts @ _Y_UP.T
        matrices = _Y_UP @ matrices @ _Y_UP.T
    # Intrinsic z, x, y: the order that the channels name.
    angles = Rotation.from_matrix(matrices).as_euler("ZXY").reshape(frames, number, 3)
    angles = np.degrees(np.unwrap(angles, axis=0))
    lines = ["HIERARCHY"]
    order: list[int] = []
    _joint(skeleton, places, 0, 0, lines, order)
    table = np.concatenate([shifts, angles], axis=2)[:, order].reshape(frames, -1)
    lines += ["MOTION", f"Frames: {frames}", f"Frame Time: {1.0 / animation.fps:.9g}"]
    row = " ".join(["%.9g"] * table.shape[1])
    lines += [row % tuple(values) for values in table.tolist()]
    path.write_text("\n".join([*lines, ""]), encoding="ascii", newline="\n")


def _joint(skeleton: Skeleton, places: np.ndarray, joint: int, depth: int, lines: list[str], order: list[int]) -> None:
    """A joint and all below it, depth first; ``order`` gets the joints as they come."""
    parent, pad = int(skeleton.parents[joint]), "\t" * depth
    offset = places[joint] - (places[parent] if parent >= 0 else 0.0)
    order.append(joint)
    lines += [f"{pad}{'ROOT' if parent < 0 else 'JOINT'} {skeleton.names[joint]}", pad + "{"]
    lines.append(pad + "\tOFFSET {:.9g} {:.9g} {:.9g}".format(*offset))
    lines.append(pad + "\tCHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation")
    children = np.flatnonzero(skeleton.parents == joint).tolist()
    for child in children:
        _joint(skeleton, places, child, depth + 1, lines, order)
    if not children:
        # Programs draw a leaf to its end: as long as the way to it, or they would make it a point.
        end = 0.5 * offset if parent >= 0 and offset.any() else np.array([0.0, 0.1, 0.0])
        lines += [pad + "\tEnd Site", pad + "\t{", pad + "\t\tOFFSET {:.9g} {:.9g} {:.9g}".format(*end), pad + "\t}"]
    lines.append(pad + "}")
