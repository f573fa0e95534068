"""Checks the settings file: one finding on what `run` would reject at its start."""

from __future__ import annotations

import sys
from pathlib import Path

from tacshade_edge.doctor.finding import Finding, fault, ok
from tacshade_edge.errors import ConfigError
from tacshade_edge.factories import links
from tacshade_edge.regular_files import open_regular
from tacshade_edge.settings import Document, load

SETTINGS = "settings"
AS_SERVICE = "sudo -u tacshade-edge /opt/tacshade-edge/bin/tacshade-edge doctor"
_UNTIL = "until then, doctor does not check {}"


def check_settings(config: Path, sensor_id: str | None = None) -> tuple[Finding, Document | None, bool]:
    """Read the settings, those of one sensor if the file has several.

    Returns
    -------
    finding : Finding
    document : Document or None
        None if the settings are unusable.
    broker : bool
        Whether the broker's settings are usable, including its password and certificate files.
    """
    try:
        document = load(config, sensor_id)
    except ConfigError as error:
        until = _UNTIL.format("the configured camera, the calibration or the broker")
        more = f" (and {len(error.others)} more: tacshade-edge check-config {config})" if error.others else ""
        return fault(SETTINGS, f"{error}{more}", f"{_fix(config)}; {until}"), None, False
    try:
        links.check_broker_files(document)
        links.make_link(document, on_request=lambda _: None, on_outcome=lambda *_: None)
    except ConfigError as error:
        return fault(SETTINGS, str(error), f"fix that line; {_UNTIL.format('the broker')}"), document, False
    return ok(SETTINGS, f"{config}, sensor {document.settings.sensor_id}"), document, True


def _fix(config: Path) -> str:
    try:
        open_regular(config, sys.maxsize).close()
    except PermissionError:
        return f"run doctor with sudo, or as the service's user: {AS_SERVICE}"
    except OSError:
        by_capture = "tacshade-edge capture DIR writes settings for this camera; pass them as --config DIR/config.yaml"
        return f"{by_capture}, or copy config/default.yaml to {config}"
    return "fix that line (config/default.yaml explains every key)"
