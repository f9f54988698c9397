"""What is measured of one frame."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class FrameQuality:
    """One frame. Lengths in input units; shares between 0 and 1; None where there are no points, or no such thing.

    frame:        its number in the input
    points:       how many were looked at
    spacing:      median distance of a point to its nearest neighbour, were they spread evenly
    noise:        standard deviation of the points across the surface; never far below a third of the spacing
    residual_mean, residual_p95: exact distances of the points to the surface
    residual_mean_percent, residual_p95_percent: the same in percent of the shape's longest side
    blur:         noise that the surface bears out, over the thickness of the shape's thin parts (lower quartile); None
                  where it is open
    misfit:       mean residual over the larger of spacing and noise
    uncovered:    share of the points that the surface does not reach
    astray:       how far off the surface some points together are, in the larger of spacing and noise; 0 if none are
    far:          share of the surface far from every point; on a partial scan that is no fault
    unseen:       share of the surface that the frame does not show, far or not
    doubled:      share of the surface that is near points of another part, and was apart from it in the shape
    layered:      share of it that is so and faces the same way as that part: a second layer on it
    shared:       the same, asked only where one camera saw all clouds: it shows the nearer of two parts alone
    exposed:      share of the surface that stands where the one camera that saw all clouds saw nothing
    spanning:     share of it that spans a gap between points through which that camera saw
    swollen:      by which share of it the limb that has grown most is larger than in the shape, a growth of all taken
                  off; asked only where one camera saw all clouds
    merged:       share of the points that lie in two layers, of which the surface makes one
    inner:        share of the surface that is far from every point and enclosed by them: a wall between what has parted
    torn:         share of the surface that is far from every point and stretched at that
    overhang:     share of the surface that lies far beyond points whose own surface closes
    surplus:      share of the surface that is far from every point, though these show as much as in the keyframe
    outgrown:     share of the keyframe's surface that lies beyond the border of the points, and has grown since
    stretch_p95, stretch_max: of |log l / l_shape| over the edges
    stretched:    share of the edges that are longer or shorter than in the shape by half, a growth of all taken off
    drawn:        share of the surface whose patches have been drawn out, a growth of all taken off
    folded:       share of neighbouring faces folded by more than 90 degrees, that were not so in the shape
    thickness:    median distance of opposite vertices over that in the shape
    thinned:      share of them whose distance has changed by half, a growth of all taken off
    volume:       over that of the shape; None where it is open
    flicker:      mean second difference of the vertex normals, degrees
    acceleration: mean second difference of the vertices, input units a frame squared
    """

    frame: int
    points: int
    spacing: float | None
    noise: float | None
    residual_mean: float | None
    residual_p95: float | None
    residual_mean_percent: float | None
    residual_p95_percent: float | None
    blur: float | None
    misfit: float | None
    uncovered: float | None
    astray: float | None
    far: float | None
    unseen: float | None
    doubled: float | None
    layered: float | None
    shared: float | None
    exposed: float | None
    spanning: float | None
    swollen: float | None
    merged: float | None
    inner: float | None
    torn: float | None
    overhang: float | None
    surplus: float | None
    outgrown: float | None
    stretch_p95: float
    stretch_max: float
    stretched: float
    drawn: float
    folded: float
    thickness: float | None
    thinned: float | None
    volume: float | None
    flicker: float | None
    acceleration: float | None
