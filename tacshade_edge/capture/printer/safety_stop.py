"""The exceptions that stop a pressing machine."""

from __future__ import annotations

from tacshade_edge.errors import DeviceError


class SafetyStop(DeviceError):
    """Something is not as expected, so nothing may move any further."""


class Stopped(Exception):
    """A person or a signal stopped the machine."""
