"""One file for a person who helps: what the doctor found and saw, without secrets."""

from __future__ import annotations

import importlib.metadata
import io
import json
import re
import subprocess
import zipfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import msgspec

from tacshade_edge.calibration import loading
from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.doctor import Finding
from tacshade_edge.doctor.board import board_facts
from tacshade_edge.doctor.broker_check import DaemonState
from tacshade_edge.doctor.camera_check import Captured
from tacshade_edge.doctor.machine import Machine
from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.files.atomic_files import disk_errors, write_whole
from tacshade_edge.files.images import png
from tacshade_edge.mqtt import links
from tacshade_edge.settings import Document, to_yaml
from tacshade_edge.wire.codec import decode_object

# About a day of a daemon that reports something every minute; one that repeats itself is cut by
# bytes.
_LOG_LINES, _LOG_BYTES_MAX, _LOG_S = 2000, 4 << 20, 10.0
_UNIT = "tacshade-edge"
_LEFT_OUT = "(left out)"
_HOME = re.compile(r"(?<=/home/)[^/\s\"',]+")
# USER:PASSWORD of an address; the host stays, as it may be what is wrong.
_IN_URL = re.compile(r"(?<=://)[^/\s@\"']+(?=@)")


@dataclass(slots=True)
class Seen:
    document: Document | None = None
    daemon: DaemonState = field(default_factory=DaemonState)
    captured: Captured = field(default_factory=Captured)


def write_bundle(path: Path, findings: Sequence[Finding], seen: Seen, *, with_frame: bool) -> None:
    """Write the zip file whole, with the latest frame, which may be private, only if asked.

    Raises DeviceError.
    """
    installed = {each.name: each.version for each in importlib.metadata.distributions()}
    texts = {
        "findings.json": _json([asdict(finding) for finding in findings]),
        "versions.json": _json(
            {**board_facts(Machine()), "packages": dict(sorted(installed.items()))}
        ),
        # What is retained only: frames are large, and may be private.
        "published.json": _json(
            {topic: _payload(payload) for topic, payload in sorted(seen.daemon.published.items())}
        ),
        "log.txt": _log(),
    }
    secrets: tuple[str, ...] = ()
    if seen.document is not None:
        settings, mqtt = seen.document.settings, seen.document.settings.mqtt
        # Whether there is one matters, and stays visible.
        hidden = {name: getattr(mqtt, name) and _LEFT_OUT for name in ("username", "password_file")}
        shown = msgspec.structs.replace(settings, mqtt=msgspec.structs.replace(mqtt, **hidden))
        texts["settings.yaml"] = to_yaml(shown)
        texts["calibration.json"] = _json(_calibration(seen.document))
        secrets = _secrets(seen.document)
    # In memory, so that the file is whole or not there.
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as bundle:
        for name, text in texts.items():
            # Every text, also the log: a library may have logged an address with a password.
            bundle.writestr(name, without_secrets(text, secrets))
        if with_frame and seen.captured.images:
            bundle.writestr("frame.png", png(seen.captured.images[-1]))
    with disk_errors(path.parent):
        write_whole(path, packed.getvalue())


def without_secrets(text: str, secrets: Sequence[str]) -> str:
    """Return `text` without the secrets, user names in URLs and names of home folders."""
    # The longest first: a password may contain the user name, and a rest of it would remain.
    for secret in sorted(secrets, key=len, reverse=True):
        text = text.replace(secret, _LEFT_OUT)
    return _HOME.sub(_LEFT_OUT, _IN_URL.sub(_LEFT_OUT, text))


def _secrets(document: Document) -> tuple[str, ...]:
    """Return the words to remove from all texts; the user name stays if it is the sensor's,
    as in the shipped ACL.
    """
    settings = document.settings
    try:
        password = links.read_password(document)
    except ConfigError:
        password = None
    username = settings.mqtt.username
    words = (
        password,
        settings.mqtt.password_file,
        username if username != settings.sensor_id else None,
    )
    # Also as JSON writes it: with a quote or a backslash it looks different there.
    return tuple(form for word in words if word for form in (word, json.dumps(word)[1:-1]))


def _calibration(document: Document) -> dict[str, Any]:
    """Return the facts in the calibration file, or the reason why it has none."""
    try:
        found = loading.load(document.settings.calibration)
    except ConfigError as error:
        return {"reason": str(error)}
    fitted = {name: networks.error_mm for name, networks in found.fitted.items()}
    facts: dict[str, Any] = {
        "crc32": f"{found.crc32:08x}",
        "pitch_px": found.pitch_px,
        "factors": dict(found.factors),
    }
    facts |= {"fit": calibration_file.fit_figures(found.fit), "fitted_error_mm": fitted}
    return {"geometry": asdict(found.geometry), "noise_grey": found.noise_grey, **facts}


def _log() -> str:
    command = [
        "journalctl",
        "--unit",
        _UNIT,
        "--lines",
        str(_LOG_LINES),
        "--no-pager",
        "--output",
        "short-iso",
    ]
    try:
        done = subprocess.run(command, capture_output=True, timeout=_LOG_S, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        return f"journalctl: {error}\n"
    return (done.stdout or done.stderr)[-_LOG_BYTES_MAX:].decode(errors="replace")


def _payload(payload: bytes) -> Any:
    try:
        return decode_object("what a daemon publishes", payload)
    except DecodeError:
        return payload.decode(errors="replace")


def _json(value: object) -> str:
    return json.dumps(value, indent=2, default=str) + "\n"
