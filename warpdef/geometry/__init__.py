"""Geometry that no stage owns: triangle meshes, distances to them, points drawn from them, normals of clouds."""
