"""A sensor without a daemon: publishes the daemon's messages, of any size and at any rate,
from the caller's shapes.
"""

from __future__ import annotations

import time
from dataclasses import replace
from types import TracebackType

import numpy as np
from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion

from tacshade_edge.mqtt.publishing import HealthReport
from tacshade_edge.pipeline.ledger import FrameLedger, Timings
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.types import (
    Calibration,
    Disc,
    Geometry,
    HeightMap,
    ObjectCloud,
    Reconstruction,
    Slip,
    TouchedObject,
)
from tacshade_edge.wire import binary, codec, messages

ROWS, COLS = 480, 640
DISC = Disc(236.0, 328.0, 205.0)
CRC = 0x1234ABCD


def calibration() -> Calibration:
    """A calibration for a 640x480 camera; only the part that `info` reports is of use."""
    image = np.zeros((ROWS, COLS), np.uint8)
    geometry = Geometry(20.0, 30.0, 55.0, DISC)
    return Calibration(
        geometry=geometry,
        polarity="bright",
        binarisation="adaptive",
        image_height_px=ROWS,
        image_width_px=COLS,
        pitch_px=20.0,
        reference_white=image,
        reference_grey=image,
        noise_grey=1.0,
        alpha=15.0,
        crc32=CRC,
    )


def bump(
    seq: int, depth_mm: float, row: float, col: float, step_px: int = 1, width_px: float = 60.0
) -> Reconstruction:
    """A result: a bell of `depth_mm` at an image pixel, exactly 0 without depth."""
    rows, cols = np.mgrid[0:ROWS:step_px, 0:COLS:step_px]
    away2 = (rows - row) ** 2 + (cols - col) ** 2
    height = (depth_mm * np.exp(-away2 / (2 * width_px**2))).astype(np.float32)
    height[np.hypot(rows - DISC.row_c, cols - DISC.col_c) > DISC.radius_px] = np.nan
    touched = np.argwhere(height[::4, ::4] > 0.3 * depth_mm) if depth_mm else np.empty((0, 2))
    points = np.zeros((len(touched), 3), np.float32)
    points[:, :2] = (touched[:, ::-1] * 4 * step_px - (DISC.col_c, DISC.row_c)) * 0.08
    points[:, 2] = np.sqrt(np.maximum((20 - depth_mm) ** 2 - (points[:, :2] ** 2).sum(axis=1), 0))
    cloud = ObjectCloud(points, np.ones(len(points), np.uint16))
    objects = (
        (TouchedObject(1, (0.5, -1.5, 17.0), (4.0, 4.0, 1.0), depth_mm, 50.0),) if depth_mm else ()
    )
    grid = HeightMap(height, height > 0.3 * depth_mm, 0.0, 0.0, float(step_px))
    contact = depth_mm > 0
    return Reconstruction(
        seq=seq,
        t_ns=time.monotonic_ns(),
        wall_ns=time.time_ns(),
        profile="fast",
        valid=True,
        reason=None,
        contact=contact,
        saturated=False,
        degraded=None,
        height=grid,
        cloud=cloud,
        objects=objects,
        volume_mm3=60.0,
    )


def unmeasured(seq: int, step_px: int = 4) -> Reconstruction:
    """A result in which something touches, but its depth is unknown."""
    reason = Reason(ReasonCode.TOUCH_UNMEASURED, "something touches, but its depth is unknown")
    return replace(bump(seq, 0.0, 0, 0, step_px), touched=True, degraded=reason)


def dragged(
    result: Reconstruction, x_mm: float, y_mm: float, slip: Slip = Slip.STICK
) -> Reconstruction:
    """The same contact, whose skin went along with it:
    as far as it is deep, by this at the deepest.
    """
    height = result.height.height_mm
    part = height / np.nanmax(height) if result.contact else height
    shear = np.stack((x_mm * part, y_mm * part), axis=-1).astype(np.float32)
    objects = tuple(
        replace(o, shear_mm=(x_mm, y_mm), twist_deg=0.0, slip=slip, slip_mm_s=9.0)
        for o in result.objects
    )
    return replace(result, shear_mm=shear, objects=objects)


def uncertain(result: Reconstruction, sigma_mm: float) -> Reconstruction:
    """The same result with one standard deviation for the whole contact."""
    sigma = np.where(result.height.contact, np.float32(sigma_mm), np.float32(np.nan)).astype(
        np.float32
    )
    return replace(result, sigma_mm=sigma)


class PublishedSensor:
    """Publishes its retained topics when it is entered, and its results on request."""

    def __init__(
        self,
        port: int,
        sensor_id: str = "drawn",
        username: str | None = None,
        password: str | None = None,
    ) -> None:
        self.base = f"tacshade/{sensor_id}"
        self._port = port
        self.client = Client(CallbackAPIVersion.VERSION2)
        if username is not None:
            self.client.username_pw_set(username, password)

    def __enter__(self) -> PublishedSensor:
        self.client.connect("127.0.0.1", self._port)
        self.client.loop_start()
        self.publish_info("fast", profiles=("fast", "paper"))
        self.publish("state", b"online", retain=True)
        self.publish(
            "status/camera",
            messages.encode_status("streaming", None, {"device": "drawn"}),
            retain=True,
        )
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.client.disconnect()
        self.client.loop_stop()

    def publish_info(
        self,
        profile: str,
        *,
        profiles: tuple[str, ...],
        choice: str | None = None,
        missing: Reason | None = None,
        hand_id: str | None = None,
        hand_T_sensor: tuple[float, ...] | None = None,
    ) -> None:
        """Publish the retained `info`."""
        info = messages.encode_info(
            version="0",
            config_digest="0",
            profile=profile,
            calibration=missing or calibration(),
            profiles=profiles,
            choice=choice,
            hand_id=hand_id,
            hand_T_sensor=hand_T_sensor,
        )
        self.publish("info", info, retain=True)

    def publish(self, topic: str, payload: bytes, *, retain: bool = False) -> None:
        self.client.publish(f"{self.base}/{topic}", payload, 1 if retain else 0, retain)

    def show(self, result: Reconstruction) -> None:
        """Publish a result as the daemon does."""
        self.publish("height", binary.encode_height(result, calibration_crc32=CRC))
        self.publish("cloud", binary.encode_cloud(result, calibration_crc32=CRC))
        if result.shear_mm is not None:
            self.publish("shear", binary.encode_shear(result, calibration_crc32=CRC))
        if result.sigma_mm is not None:
            self.publish("sigma", binary.encode_sigma(result, calibration_crc32=CRC))
        if result.touch is not None or not result.contact:
            self.publish("touch", messages.encode_touch(result))
        self.publish("contact", messages.encode_contact(result, fps=30.0))


def health() -> bytes:
    """A `health` after three frames, one of them invalid."""
    ledger, timings = FrameLedger(), Timings()
    for seq in range(3):
        ledger.captured(seq)
    ledger.settle(0, "published")
    ledger.settle(1, "invalid")
    timings.add({"latency": 20.0, "solve": 5.0})
    reported = HealthReport(ledger, timings).snapshot(4, {"published": 9, "refused": 0})
    parts = {"recorder": {"written": 5, "waiting": 1}, "budget": None}
    return codec.encode_json(
        {**reported, **parts, "reference": {"state": "following"}, "invalid_reason_code": "torn"}
    )
