"""The camera that LeRobot creates from a `TacShadeCameraConfig`."""

from __future__ import annotations

import threading
import time
from pathlib import Path
from typing import Any, Final

import numpy as np
from lerobot.cameras.camera import Camera
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError
from tacshade_client import ConfigError, DeviceError, Info, Listener, listen

from .colours import F32, U8
from .config import SIZE_PX, TacShadeCameraConfig
from .pictures import TOPICS, Pictures

_CONNECT_S: Final = 5.0
_POLL_S: Final = 0.2
_FIND_S: Final = 1.0


class TacShadeCamera(Camera):
    """A sensor's height and shear as RGB pictures (`colours.to_rgb`),
    received in a separate thread.

    A sensor in contact gives a picture per frame. An untouched one publishes only ten times a
    second, and its picture does not change, so `async_read` does not wait for a new one.
    """

    def __init__(self, config: TacShadeCameraConfig) -> None:
        super().__init__(config)
        self.config = config
        self.use_depth = config.use_depth
        self._came = threading.Condition()
        self._listener: Listener | None = None
        self._thread: threading.Thread | None = None
        self._crash: Exception | None = None
        self._latest: U8 | None = None
        self._depth_m = self._tactile = np.zeros(0, np.float32)
        self._latest_s = 0.0
        self._fresh = self._touched = False

    def __str__(self) -> str:
        return f"TacShadeCamera({self.config.broker}, {self.config.sensor})"

    @property
    def is_connected(self) -> bool:
        """True from `connect` to `disconnect`, even while the broker is unreachable."""
        return self._listener is not None

    @staticmethod
    def find_cameras() -> list[dict[str, Any]]:
        """The sensors that publish to the broker on this machine."""
        found: list[dict[str, Any]] = []
        try:
            with listen("localhost", "+", ["info"]) as messages:
                end_s = time.monotonic() + _FIND_S
                while (message := messages.get(end_s - time.monotonic())) is not None:
                    if isinstance(message.value, Info):
                        size = {"width": SIZE_PX, "height": SIZE_PX}
                        found.append(
                            {"type": "tacshade", "id": message.name, "default_stream_profile": size}
                        )
        except DeviceError:
            pass
        return found

    def connect(self, warmup: bool = True) -> None:
        """Connect to the broker and, with `warmup`, wait for the first picture.

        Raises DeviceAlreadyConnectedError, and ConnectionError if the settings can never work, the
        broker is unreachable or rejects the connection, or no picture arrives within 5 s.
        """
        if self.is_connected:
            raise DeviceAlreadyConnectedError(f"{self} is connected already")
        config = self.config
        password = None
        try:
            if config.password_file is not None:
                password = Path(config.password_file).read_text(encoding="utf-8").partition("\n")[0]
            self._listener = listen(
                config.broker,
                config.sensor,
                TOPICS,
                username=config.username,
                password=password,
                ca_file=config.ca_file,
            )
        except (ConfigError, DeviceError, OSError, UnicodeDecodeError) as error:
            raise ConnectionError(f"{self}: {error}") from error
        self._latest, self._fresh, self._crash = None, False, None
        self._thread = threading.Thread(
            target=self._receive, args=(self._listener,), name="tacshade", daemon=True
        )
        self._thread.start()
        if warmup:
            try:
                self.async_read(timeout_ms=1000 * _CONNECT_S)
            except TimeoutError as error:
                self.disconnect()
                raise ConnectionError(
                    f"{error}; expected a calibrated sensor of that name"
                ) from None

    def read(self) -> U8:
        """Wait at most a second for the next picture.

        Raises TimeoutError, DeviceNotConnectedError.
        """
        return self.async_read(timeout_ms=1000)

    def async_read(self, timeout_ms: float = 200) -> U8:
        """Wait for a picture that has not been read yet;
        for an untouched sensor return the newest at once.

        RGB, uint8 (height, width, 3), read-only. Raises TimeoutError, DeviceNotConnectedError.
        """
        self._check()
        with self._came:
            self._came.wait_for(
                lambda: self._crash is not None or self._readable(), timeout_ms / 1000
            )
            self._check()
            if not self._readable() or self._latest is None:
                raise TimeoutError(f"{self}: no picture within {timeout_ms:.0f} ms")
            self._fresh = False
            return self._latest

    def read_latest(self, max_age_ms: int = 500) -> U8:
        """The newest picture, read or not.

        Raises TimeoutError if it is older than `max_age_ms`, RuntimeError before the first,
        DeviceNotConnectedError.
        """
        self._check()
        with self._came:
            if self._latest is None:
                raise RuntimeError(f"{self}: no picture has arrived yet")
            if (age_ms := 1000 * (time.monotonic() - self._latest_s)) > max_age_ms:
                raise TimeoutError(
                    f"{self}: the newest picture is {age_ms:.0f} ms old, more than {max_age_ms}"
                )
            return self._latest

    def read_latest_depth(self, max_age_ms: int = 500) -> F32:
        """The height map of the newest picture as LeRobot takes depth: float32 (height, width, 1)
        in metres, 0 outside the circle. Raises like `read_latest`.
        """
        self.read_latest(max_age_ms)
        return self._depth_m

    def read_latest_tactile(self, max_age_ms: int = 500) -> F32:
        """The numbers `TACTILE` of the newest picture, float32, NaN where unknown.

        Raises like `read_latest`.
        """
        self.read_latest(max_age_ms)
        return self._tactile

    def disconnect(self) -> None:
        """Disconnect from the broker. Raises DeviceNotConnectedError."""
        if not self.is_connected:
            raise DeviceNotConnectedError(f"{self} is not connected")
        listener, self._listener = self._listener, None
        if listener is not None:
            listener.close()
        if self._thread is not None:
            self._thread.join()

    def _check(self) -> None:
        if not self.is_connected:
            raise DeviceNotConnectedError(f"{self} is not connected")
        if self._crash is not None:
            raise ConnectionError(f"{self}: receiving ended: {self._crash!r}") from self._crash

    def _readable(self) -> bool:
        """Whether `async_read` can return a picture now; call it with the lock held."""
        recent = time.monotonic() - self._latest_s < 2 * _POLL_S
        return self._latest is not None and (self._fresh or (not self._touched and recent))

    def _receive(self, listener: Listener) -> None:
        try:
            self._show(listener)
        except Exception as error:  # noqa: BLE001 - `async_read` raises it in the reader's thread
            with self._came:
                self._crash = error
                self._came.notify_all()

    def _show(self, listener: Listener) -> None:
        pictures = Pictures(self.width or SIZE_PX)
        for message in listener:
            if (picture := pictures.add(message)) is not None:
                picture.setflags(write=False)
                depth_m = np.nan_to_num(pictures.height_mm[..., None] * np.float32(1e-3))
                with self._came:
                    self._depth_m, self._tactile = depth_m, pictures.tactile
                    self._latest, self._latest_s, self._fresh = picture, time.monotonic(), True
                    self._touched = bool(message.value.contact)
                    self._came.notify_all()
