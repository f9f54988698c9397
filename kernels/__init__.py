"""Warp kernels of the method, each with its hand-written adjoint. Imports only Warp and NumPy."""
