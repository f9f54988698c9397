"""What a frame hides is put as the frames around it show it, and goes with the part of the body that it hangs on."""

import numpy as np
import synthetic

from warpdef.fit.embedded import Pose
from warpdef.fit.hidden import as_others_show, bent_as_shown
from warpdef.fit.surfels import SeenFrame, Surfels

EYE = np.array([0.0, 0.0, 1.0])
ELBOW, ARM = 0.2, 0.35
BENT = (0.0, 0.3, 0.6, 0.9)
"""Angle of the arm in each frame."""


def limb(angle: float, swing: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """A flat tube along x from -0.8 to 0.8, bent in the picture from ``ELBOW`` on, all of it turned by ``swing``."""
    x, around = np.meshgrid(np.linspace(-0.8, 0.8, 81), np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False))
    x, around = x.ravel(), around.ravel()
    sides = np.column_stack([np.zeros_like(x), np.cos(around), np.sin(around)])
    points, normals = np.column_stack([x, 0.12 * sides[:, 1], 0.12 * sides[:, 2]]), sides
    joint, turn = np.array([ELBOW, 0.0, 0.0]), synthetic.turn_about([0.0, 0.0, 1.0], angle)
    beyond = (x > ELBOW)[:, None]
    points = np.where(beyond, (points - joint) @ turn.T + joint, points)
    normals = np.where(beyond, normals @ turn.T, normals)
    whole = synthetic.turn_about([0.0, 0.0, 1.0], swing)
    return points @ whole.T, normals @ whole.T


def seen(angle: float, swing: float = 0.0, hidden: bool = False) -> SeenFrame:
    points, normals = limb(angle, swing)
    shown = normals @ EYE > 0.1
    if hidden:
        shown &= limb(0.0)[0][:, 0] < ELBOW
    return SeenFrame(points[shown], normals[shown], EYE)


def true_pose(surfels: Surfels, angle: float, swing: float = 0.0) -> Pose:
    node = surfels.graph.node
    whole = synthetic.turn_about([0.0, 0.0, 1.0], swing)
    bent = synthetic.turn_about([0.0, 0.0, 1.0], swing + angle)
    rest = surfels.points[node]
    rotation = np.where((rest[:, 0] > ELBOW)[:, None, None], bent, whole)
    return Pose(rotation, limb(angle, swing)[0][node] - rest)


def off(surfels: Surfels, pose: Pose, angle: float, swing: float = 0.0) -> float:
    """Median distance of the far end of the arm from where it is in truth."""
    end = limb(0.0)[0][:, 0] > ARM
    return float(np.median(np.linalg.norm(surfels.place(pose)[0] - limb(angle, swing)[0], axis=1)[end]))


def put(hidden: int, expected: float) -> tuple[float, float]:
    """How far the arm of a frame that hides it is off an angle, straight as at rest and as the other frames show it."""
    swings = (0.0, 0.1, 0.2, 0.3)
    surfels = Surfels(*limb(0.0), 0.02)
    frames = {t: seen(angle, swings[t], hidden=t == hidden) for t, angle in enumerate(BENT)}
    poses = {t: true_pose(surfels, 0.0 if t == hidden else angle, swings[t]) for t, angle in enumerate(BENT)}
    found = bent_as_shown(surfels, frames, poses, 0)
    assert found[0] is poses[0]
    before, after = (off(surfels, p[hidden], expected, swings[hidden]) for p in (poses, found))
    return before, after


def test_a_hidden_arm_is_put_between_the_frames_that_show_it_and_goes_with_the_body():
    before, after = put(2, expected=BENT[2])
    assert before > 0.2 and after < 0.5 * before


def test_a_hidden_arm_at_the_end_stays_bent_as_it_was_seen_last():
    before, after = put(3, expected=BENT[2])
    assert before > 0.2 and after < 0.5 * before


def test_what_others_show_is_between_in_time_keeps_its_length_and_never_itself():
    vectors = np.zeros((4, 3, 3))
    vectors[:, 0] = [[1.0, 0.0, 0.0], [9.0, 9.0, 9.0], [0.0, 2.0, 0.0], [0.0, 0.0, 3.0]]
    vectors[:, 1] = np.arange(12.0).reshape(4, 3)
    vectors[:, 2] = [[5.0, 0.0, 0.0]] * 4
    known = np.array([[1, 0, 0], [0, 0, 0], [1, 0, 1], [0, 0, 0]], dtype=bool)
    told = as_others_show(vectors, known, np.array([0, 1, 4, 5]))
    np.testing.assert_allclose(told[0, 0], [0.0, 2.0, 0.0])  # from the other alone
    straight = np.array([0.75, 0.5, 0.0])
    np.testing.assert_allclose(told[1, 0], 1.25 * straight / np.linalg.norm(straight))
    np.testing.assert_allclose(told[2, 0], [1.0, 0.0, 0.0])
    np.testing.assert_allclose(told[3, 0], [0.0, 2.0, 0.0])
    np.testing.assert_allclose(told[:, 1], vectors[:, 1])  # nobody knows
    np.testing.assert_allclose(told[:, 2], vectors[:, 2])
