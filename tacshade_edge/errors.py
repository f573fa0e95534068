"""Every exception that this package raises on purpose.

::

    TacshadeError
    ├── ConfigError   the user's settings, calibration or arguments are wrong: one line, exit 78
    ├── DeviceError   the outside failed (camera, broker, disk): back off and retry; exit 1 in a one-shot command
    └── DecodeError   bytes or a file could not be understood: count it, go on with the next

Anything else that is raised is a defect: it ends the process, and systemd restarts it.
"""


class TacshadeError(Exception):
    """Base of the three. Its text is one line: what, where, and what was expected."""


class ConfigError(TacshadeError):
    """Settings, calibration or arguments that cannot work as they are (exit 78)."""


class DeviceError(TacshadeError):
    """A camera, line, broker or disk that failed; it may come back."""


class DecodeError(TacshadeError):
    """Bytes or a file that do not follow their format."""
