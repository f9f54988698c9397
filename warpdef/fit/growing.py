"""The template of all frames, where one shows but a side of the body: one camera, before which the body turns.

How far it turns is measured first, by rigid motions from frame to frame: what counts is the camera's direction as the
body sees it. Where that stays, all frames show the same side, and the template is the keyframe's, as ever. Where it
goes round, the template grows outwards from the keyframe, a frame to either side in turn: the surface known so far
is bent onto the frame (``surfels``), the frame's points are pulled back to the keyframe, and what lies beyond becomes
surface. What came of all frames is averaged across the surface, by trust: how squarely a point was seen, how near
to surface that was known, how few frames from the keyframe. One Poisson over that is the template; where no frame
shows anything it is closed by the smallest surface, as Poisson's own balloons.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from warpdef.config import Config
from warpdef.errors import InputError
from warpdef.fit.embedded import Pose
from warpdef.fit.surfels import SeenFrame, Surfels, nearest_facing, pulled_to
from warpdef.geometry.coverage import area_of_discs
from warpdef.geometry.sampling import spread_evenly
from warpdef.geometry.triangles import unique_edges, vertex_normals
from warpdef.mesh import TriMesh
from warpdef.template.build import build, depth_by_spacing
from warpdef.template.choose import ChosenTemplate
from warpdef.template.keyframe import rank_keyframes
from warpdef.template.quality import judge
from warpdef.template.support import Support
from warpdef.template.trim import find_trimming
