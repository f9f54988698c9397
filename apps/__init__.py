"""The programs: everything here is used through the ``warpdef`` command."""
