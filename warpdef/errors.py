"""The errors a user can cause and mend. Each message says what, where, expected, got, and what to do."""


class WarpdefError(Exception):
    """Base of every error that a user can mend; the command line prints it and exits with 2."""


class InputError(WarpdefError, ValueError):
    """Input data, a file or an argument is not usable as it is."""


class ConfigError(InputError):
    """A configuration key or value is not valid."""


class DeviceError(WarpdefError, RuntimeError):
    """The requested compute device is not there."""


class OutOfMemory(DeviceError):
    """Memory ran out during a run, on the device or beside it."""


class MissingPackageError(WarpdefError, ImportError):
    """An optional package or system library is needed for what was asked."""
