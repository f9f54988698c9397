"""Warp kernels of the method, each with its hand-written adjoint. Imports only Warp and NumPy.

A room a file. Motion: `levels` (node layout), `trilinear` (sampling), `cayley` (rotations), `motion` (moving points and
vertices). Terms: `cells` and `neighbours` (exact nearest neighbours), `chamfer`, `isometry`. Descent: `graphs`, `cg`
and `cosine` (Sobolev solves), `adam`, `schedule` (what changes with the iteration). Vertex stage: `planes`, `rigidity`,
`block_cg`. And `launching`: how a launch runs or is recorded.
"""
