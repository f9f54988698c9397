"""What the ``warpdef`` process tells its caller."""

EXIT_OK = 0
EXIT_ERROR = 2
"""Bad input or usage; a sentence on standard error says which."""
EXIT_LOST = 3
"""``--strict``, and the mesh is lost in at least one frame; the result is written all the same."""
EXIT_INTERRUPTED = 130
"""Ended by Ctrl-C."""
