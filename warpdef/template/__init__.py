"""The template: keyframe, normals, screened Poisson, and the gate that judges the mesh."""
