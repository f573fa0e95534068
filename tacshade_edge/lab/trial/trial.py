"""A trial of settings: the daemon itself, on pictures in memory at the wanted rate, through a
broker to a subscriber that decodes.
"""

from __future__ import annotations

import secrets
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import yaml

from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.doctor.tail import measure_tail
from tacshade_edge.errors import DeviceError
from tacshade_edge.lab.demo.child import Child, broker_command, free_port, wait_for_port
from tacshade_edge.lab.studies.tradeoff.measure import Promise
from tacshade_edge.lab.trial.forgetting import forget
from tacshade_edge.lab.trial.hearing import SETTLED_NS, Heard, HearingProcess, Listening
from tacshade_edge.mqtt import links
from tacshade_edge.mqtt.client import BrokerAddress, broker_at
from tacshade_edge.settings import Document
from tacshade_edge.types import U8, Calibration

_OF: Final = "tradeoff"
_BROKER_S: Final = 10.0
SECONDS: Final = 10.0
LEAST_FRAMES: Final = 200
"""A slow camera is heard longer: the p99 of fewer is their greatest."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Wanted:
    """What to try: a profile at a rate for each of some fingers, and the topics of a subscriber."""

    profile: str
    calibration: Calibration
    images: Sequence[U8]
    fps: float
    fingers: int
    outputs: Sequence[str]


class TrialBroker:
    """The broker of trials: the one that settings name, or a private one for as long as this is
    open. Raises DeviceError if there is neither, or it does not answer.
    """

    def __init__(self, document: Document | None) -> None:
        self._open = ExitStack()
        if document is not None:
            self.address: BrokerAddress = links.broker_address(document)
            self.mqtt = _mqtt(document)
            self.name = f"{self.address['host']}:{self.address['port']}"
            return
        port = free_port()
        self.address, self.name = broker_at("127.0.0.1", port), ""
        self.mqtt = {"host": "127.0.0.1", "port": port}
        with self._open:
            folder = Path(self._open.enter_context(tempfile.TemporaryDirectory()))
            broker = Child("broker", broker_command(folder, port), folder, of=_OF)
            self._open.callback(broker.stop)
            wait_for_port(broker, port, _BROKER_S)
            self._open = self._open.pop_all()

    @property
    def through(self) -> str:
        """The broker, for people."""
        return self.name or "a private broker"

    def __enter__(self) -> TrialBroker:
        return self

    def __exit__(self, *_: object) -> None:
        self._open.close()


def try_daemon(wanted: Wanted, broker: TrialBroker, frame_ms: float) -> Promise:
    """Run the daemon for some seconds; `frame_ms` is the control's work.

    Raises DeviceError if the daemon ends, or nothing of it is heard.
    """
    heard = _run(wanted, broker)
    control = measure_tail(frame_ms, wanted.fps, SECONDS / 2)
    captured, lost = heard.frames()
    return Promise(
        p50_ms=heard.percentile_ms(0.5),
        p99_ms=heard.percentile_ms(0.99),
        frames=captured,
        lost=lost,
        through=broker.through,
        control_ms=control.processor_p50_ms,
        control_p99_ms=control.p99_ms,
    )


def _run(wanted: Wanted, broker: TrialBroker) -> Heard:
    """What a subscriber hears of the daemon."""
    # Names that no sensor has: on this broker, others may publish.
    unique = secrets.token_hex(4)
    names = [f"{_OF}-{unique}-{k}" for k in range(wanted.fingers)]
    listening = Listening(broker=broker.address, sensors=names, decoded=wanted.outputs)
    with tempfile.TemporaryDirectory() as made, ExitStack() as stack:
        folder = Path(made)
        _write(folder, wanted, names, broker.mqtt)
        listener = HearingProcess(listening)
        stack.callback(listener.stop)
        if broker.name:
            stack.callback(forget, broker.address, names)
        program = [sys.executable, "-m", "tacshade_edge.lab.trial.ring_daemon"]
        words = [str(folder / "config.yaml"), str(wanted.fps)]
        words += [str(folder / f"{name}.npy") for name in names]
        daemon = Child("daemon", [*program, *words], folder, of=_OF)
        stack.callback(daemon.stop)
        all_heard = listener.wait_until_all_are_heard()
        daemon.check()
        if not all_heard:
            raise DeviceError(f"{broker.through}: heard nothing of a daemon that publishes there")
        seconds = max(SECONDS, LEAST_FRAMES / wanted.fps / wanted.fingers)
        time.sleep(seconds + SETTLED_NS / 1e9)
        daemon.check()
        daemon.stop()
        return listener.heard()


def _write(folder: Path, wanted: Wanted, names: Sequence[str], mqtt: dict[str, object]) -> None:
    """Write settings, a calibration and the pictures for each finger: each its own file, as a
    daemon of several sensors requires.
    """
    sensors = {}
    for name in names:
        calibration_file.save(folder / f"{name}.npz", wanted.calibration)
        np.save(folder / f"{name}.npy", np.stack(wanted.images))
        # The source is never opened: the pictures take its place.
        sensors[name] = {"calibration": f"{name}.npz", "source": {"kind": "simulated"}}
    own = {"sensor_id": names[0], **sensors[names[0]]} if len(names) == 1 else {"sensors": sensors}
    kept = {"recorder": {"folder": "recordings"}, "stitching": {"folder": "sessions"}}
    settings = {"profile": wanted.profile, "mqtt": mqtt, **kept, **own}
    (folder / "config.yaml").write_text(yaml.safe_dump(settings), encoding="utf-8")


def _mqtt(document: Document) -> dict[str, object]:
    """The broker's section of the settings, for a file elsewhere."""
    mqtt = document.settings.mqtt
    found: dict[str, object] = {"host": mqtt.host, "port": mqtt.port}
    if mqtt.username is not None:
        found["username"] = mqtt.username
    for key in ("password_file", "ca_file"):
        if (path := getattr(mqtt, key)) is not None:
            found[key] = str(Path(path).absolute())
    return found
