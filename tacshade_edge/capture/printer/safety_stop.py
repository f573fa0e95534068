"""Why a machine that presses is stopped."""

from __future__ import annotations

from tacshade_edge.errors import DeviceError


class SafetyStop(DeviceError):
    """Something is not as it should be, so nothing may go on moving."""


class Stopped(Exception):
    """The person at the terminal stopped it."""
