"""The ``preview`` message: a small picture of what the camera sees."""

from __future__ import annotations

import cv2
import numpy as np

from tacshade_edge.daemon.pipeline.observer import FrameObserver, FrameResult
from tacshade_edge.devices.mqtt.link import MqttLink
from tacshade_edge.types import Frame

WIDTH_PX = 320


class Preview(FrameObserver):
    """Publishes the newest frame, and no frame twice."""

    def __init__(self, link: MqttLink) -> None:
        self._link = link
        self._latest: Frame | None = None
        self._published: Frame | None = None

    def see(self, seen: FrameResult) -> None:
        """Keep the newest frame."""
        self._latest = seen.frame

    def publish(self) -> None:
        """Publish the newest frame if somebody listens."""
        frame = self._latest
        if frame is None or frame is self._published or not self._link.connected:
            return
        if not self._link.has_listener("preview"):
            return
        self._published = frame
        size = (WIDTH_PX, round(WIDTH_PX * frame.image.shape[0] / frame.image.shape[1]))
        _, jpeg = cv2.imencode(".jpg", cv2.resize(np.asarray(frame.image), size, interpolation=cv2.INTER_AREA))
        self._link.offer("preview", jpeg.tobytes(), frame.seq)
