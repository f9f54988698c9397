"""Sets of true moving meshes as they are distributed: find what a folder holds, and read it.

    folder -> find_sequences -> TrueSequence.load -> MeshSequence

``find`` walks the folder; ``mesh_folders``, ``anime`` and ``registrations`` read a format each; ``truth`` reads a path
whatever it is; ``check`` says what is in a set and what is wrong with it.
"""

from warpdef.datasets.find import find_sequences
from warpdef.datasets.sequences import TrueSequence

__all__ = ["TrueSequence", "find_sequences"]
