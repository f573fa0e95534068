"""Publishes a sensor in MuJoCo over MQTT, as a daemon publishes a real one."""

from __future__ import annotations

import os
import time
import zlib
from types import TracebackType
from typing import Final, Self

import msgspec
import numpy as np

from tacshade_edge.errors import DeviceError
from tacshade_edge.lab.mjcf.export import Parameters
from tacshade_edge.lab.mjcf.mujoco_sensor import PROFILE, MujocoSensor
from tacshade_edge.library.result import Result, result_of
from tacshade_edge.mqtt.link import MqttLink
from tacshade_edge.mqtt.publishing import ContactEvents, Publisher
from tacshade_edge.mqtt.subscription import address_of
from tacshade_edge.pipeline.observer import FrameResult
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.types import Calibration, Frame, Need
from tacshade_edge.version import installed_version
from tacshade_edge.wire import messages, requests
from tacshade_edge.wire.requests import Request

CONNECT_S: Final = 5.0
STOP_S: Final = 2.0
_RATE_SPAN_S = 1.0
_REFUSAL: Final = Reason(ReasonCode.UNAVAILABLE, "a sensor in MuJoCo does not accept this request")


class MujocoStream:
    """A sensor in MuJoCo on a broker; close it with ``with`` or `close`.

    A thread sends; `send` never waits for it.
    """

    def __init__(
        self,
        sensor: MujocoSensor,
        broker: str,
        sensor_id: str,
        *,
        username: str | None = None,
        password: str | None = None,
        ca_file: str | os.PathLike[str] | None = None,
    ) -> None:
        """Connect, as `tacshade_edge.listen` does.

        Raises
        ------
        ConfigError
            The arguments can never work.
        DeviceError
            No broker answers within 5 s, or it rejects the connection.
        """
        address = address_of(broker, username, password, ca_file)
        self._sensor = sensor
        self._calibration = _calibration(sensor.parameters)
        self._link = MqttLink(
            address,
            base_topic=f"tacshade/{sensor_id}",
            client_id=f"tacshade-{sensor_id}",
            on_request=self._refuse,
            on_outcome=lambda *_: None,
        )
        self._publisher = Publisher(
            self._link.offer, self._link.publish_event, lambda *_: None, self._link.has_listener
        )
        self._events = ContactEvents(self._link.publish_event)
        self._sent, self._since_s = 0, time.monotonic()
        info = messages.encode_info(
            version=installed_version(),
            config_digest=PROFILE,
            profile=PROFILE,
            calibration=self._calibration,
        )
        self._link.set_retained("info", info)
        self._link.set_retained("status/camera", messages.encode_status("streaming"))
        self._link.start()
        self._link.wait_until_settled(CONNECT_S)
        if not self._link.connected:
            reason = self._link.reason or Reason(ReasonCode.NO_ANSWER, "no answer")
            self.close()
            raise DeviceError(str(reason), code=reason.code)

    def send(self) -> Result:
        """Publish the sensor's present state to whoever listens, and return it.

        Returns
        -------
        Result
            Without shear if nobody listens to it.
        """
        need = self._publisher.need()
        made = self._sensor.reconstruct(shear=Need.ONLY_SHEAR in need)
        pose = self._sensor.pose()
        frame = Frame(made.seq, made.t_ns, made.wall_ns, np.zeros((1, 1), np.uint8), pose)
        seen = FrameResult(frame, self._calibration, made)
        self._count()
        self._publisher.see(seen)
        self._events.see(seen)
        return result_of(made, self._sensor.geometry, pose, None)

    def close(self) -> None:
        """Publish that the sensor has stopped, and disconnect, within 2 s."""
        self._link.stop(STOP_S)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _count(self) -> None:
        self._sent += 1
        if (span_s := time.monotonic() - self._since_s) >= _RATE_SPAN_S:
            self._publisher.fps = self._sent / span_s
            self._sent, self._since_s = 0, time.monotonic()

    def _refuse(self, request: Request) -> None:
        self._link.reply(request, requests.encode_error(request.transaction, _REFUSAL))


def _calibration(parameters: Parameters) -> Calibration:
    """The geometry as messages state it, in a calibration that no picture was taken for."""
    model = parameters.model
    nothing = np.zeros((model.image_height_px, model.image_width_px), np.uint8)
    return Calibration(
        geometry=model.geometry,
        polarity="bright",
        binarisation="otsu",
        image_height_px=model.image_height_px,
        image_width_px=model.image_width_px,
        pitch_px=model.pitch_mm / model.geometry.mm_per_px,
        reference_white=nothing,
        reference_grey=nothing,
        noise_grey=0.0,
        alpha=15.0,
        flange_T_sensor=parameters.flange_T_sensor,
        crc32=zlib.crc32(msgspec.json.encode(parameters)),
    )
