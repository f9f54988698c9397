"""What the ``warpdef`` process tells its caller; one that a signal ended, 128 and its number (``signals``)."""

EXIT_OK = 0
EXIT_ERROR = 2
"""Bad input or usage; a sentence on standard error says which."""
EXIT_LOST = 3
"""``--strict``, and the mesh is lost in at least one frame; the result is written all the same."""
