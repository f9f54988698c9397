"""warpdef: from a sequence of raw point clouds to one mesh that moves."""

__version__ = "0.1.0"
