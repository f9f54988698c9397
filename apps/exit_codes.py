"""What the ``warpdef`` process tells its caller; one that a signal ended, 128 and its number (``signals``)."""

EXIT_OK = 0
EXIT_ERROR = 2
"""Bad input or usage; a sentence on standard error says which."""
