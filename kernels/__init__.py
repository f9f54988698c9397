"""Warp kernels of the method, each with its hand-written adjoint. Imports only Warp and NumPy.

A room a file: `levels` (node layout), `trilinear` (sampling), `cayley` (rigid motion), `motion` (moving points and
vertices), `neighbours` (exact nearest neighbours), `chamfer`, `isometry`, `confidence`, `graphs` and `cg` and `cosine`
(Sobolev solves), `adam`, and `launching` (how a launch runs or is recorded).
"""
