"""One sensor's side of a serial line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from support.patience import wait_until
from tacshade_edge.pipeline.observer import Reply
from tacshade_edge.robot.port import SerialPort
from tacshade_edge.robot.robot import Robot, SharedLine
from tacshade_edge.types import QUANTITIES
from tacshade_edge.wire.requests import Request


class Side:
    """One sensor's side of the line, without camera and broker;
    without a link it follows another's.
    """

    def __init__(self, link: Path | None, shared: SharedLine | None = None) -> None:
        self.requests: list[tuple[Request, Reply]] = []
        self.reports: list[dict[str, Any]] = []
        self.robot = Robot(
            SerialPort(str(link), 115200) if link else None,
            lambda *request: self.requests.append(request),
            lambda: {"source": "streaming", "health": {"delivered_fps": 30.0}},
            lambda payload: self.reports.append(json.loads(payload)),
            lambda: None,
            lambda: QUANTITIES,
            shared,
        )

    def __enter__(self) -> Side:
        self.robot.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.robot.stop(10)

    def latest(self) -> dict[str, Any]:
        """``status/serial``."""
        self.robot.poll()
        return self.reports[-1] if self.reports else {}

    def until(self, what: str, **wanted: Any) -> dict[str, Any]:
        wait_until(lambda: wanted.items() <= self.latest().items(), 30, f"{what}: {wanted}")
        return self.reports[-1]
