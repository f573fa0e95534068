"""Camera frames through OpenCV's V4L2 backend.

OpenCV reports a device as open although it delivers no frames, silently accepts another format than
the requested one, and provides no sequence numbers. So this module checks a node before opening it,
reads every setting back, and takes only a frame that was read as proof of a camera. OpenCV hides
the kernel's error flag of a buffer; only its length or the JPEG decoder reveals a damaged frame.

A driver may stamp a frame up to a period ahead of the clock (USB cameras by a little). Such a stamp
still identifies the clock and reveals gaps, but a frame is never dated after its arrival.
"""

from __future__ import annotations

import logging
import os
import time

import cv2
import numpy as np

from tacshade_edge.camera import v4l2_node
from tacshade_edge.camera.frame_source import Camera, FrameGaps, unix_ns
from tacshade_edge.errors import ConfigError, DecodeError, DeviceError, TacshadeError
from tacshade_edge.files.image_bytes import decode_image
from tacshade_edge.reasons import ReasonCode
from tacshade_edge.types import U8, Frame

_log = logging.getLogger(__name__)

FOURCCS = ("MJPG", "YUYV", "NV12", "GREY")
_STALL_S = 2  # OpenCV's own limit is 10 s per read
# As the kernel would give. More would only age: the grab thread takes every frame at once.
_BUFFERS = 4
# Another clock than CLOCK_MONOTONIC, such as the time of day, is off by far more than this.
_STAMP_AGE_MAX_NS = 1_000_000_000
_UNDECODABLE_MAX = 30  # in a row: about a second at 30 fps


class V4l2Source(Camera):
    """A V4L2 camera; frames are grey, the luma that the camera sent,
    never rescaled from the video range.

    Exposure and white balance are locked if the driver has the controls. `fps`: requested rate; the
    driver may choose another. `fourcc`: one of `FOURCCS`. `exposure`: in the driver's unit (100 µs
    for USB cameras); None keeps its value. Raises ConfigError (the arguments suit no camera).
    """

    def __init__(
        self,
        device: str,
        width_px: int,
        height_px: int,
        fps: float,
        fourcc: str,
        exposure: int | None = None,
    ) -> None:
        if fourcc not in FOURCCS:
            raise ConfigError(
                f"camera {device}: found format {fourcc!r}, expected one of {', '.join(FOURCCS)}"
            )
        if min(width_px, height_px) < 1 or not fps > 0:
            found = f"found {width_px}x{height_px} at {fps:g} fps"
            raise ConfigError(f"camera {device}: {found}, expected positive numbers")
        super().__init__(f"camera {device}", device)
        self._shape = (height_px, width_px)
        self._fps = fps
        self._fourcc = fourcc
        self._exposure = exposure
        self._capture: cv2.VideoCapture | None = None

    def open(self) -> None:
        """Check the node, negotiate, lock the controls,
        and read one frame for the next `read` to return.

        Raises DeviceError (the device is absent, does not capture, is busy, or delivers no frame),
        ConfigError (the path is no video device, or the device chose another format, size or
        exposure; DeviceError if this configuration has worked before).
        """
        self.close()
        try:
            card = v4l2_node.check_node(self._device)
        except ConfigError as error:
            if self._proven:
                raise DeviceError(str(error), code=error.code) from None
            raise
        # OpenCV reads this when it first waits; its warnings would repeat our log line.
        os.environ.setdefault("OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT", str(_STALL_S))
        cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_ERROR)
        capture = cv2.VideoCapture(self._device, cv2.CAP_V4L2)
        try:
            if not capture.isOpened():
                if v4l2_node.is_busy(self._device):
                    raise DeviceError(
                        f"{self._name}: in use by another program", code=ReasonCode.IN_USE
                    )
                raise DeviceError(f"{self._name}: cannot set up the camera for capture")
            self._settings = {"card": card, **self._negotiate(capture)}
            self._gaps = FrameGaps()
            self._check_stamps(capture)
            self._pending = self._decoded(capture, grabbed=True)
        except TacshadeError:
            capture.release()
            raise
        self._capture = capture
        self._proven = True
        _log.info(
            "%s: %s", self._name, ", ".join(f"{name} {got}" for name, got in self._settings.items())
        )

    def _next(self) -> Frame:
        if self._capture is None:
            raise self._not_open()
        return self._decoded(self._capture)

    def _pass_over(self) -> None:
        """Return the next frame's buffer to the driver undecoded."""
        if self._capture is None:
            raise self._not_open()
        self._grab(self._capture)
        self._date(_kernel_stamp_ns(self._capture), time.monotonic_ns())

    def close(self) -> None:
        """Release the device; safe to call twice."""
        self._pending = None
        if self._capture is not None:
            self._capture.release()
            self._capture = None

    def _negotiate(self, capture: cv2.VideoCapture) -> dict[str, str | int | float]:
        """Set everything in the order that drivers need, and read everything back."""
        height_px, width_px = self._shape
        # The format first: it decides which sizes there are, and the size which rates.
        capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*self._fourcc))
        capture.set(cv2.CAP_PROP_FRAME_WIDTH, width_px)
        capture.set(cv2.CAP_PROP_FRAME_HEIGHT, height_px)
        capture.set(cv2.CAP_PROP_FPS, self._fps)
        capture.set(cv2.CAP_PROP_BUFFERSIZE, _BUFFERS)
        capture.set(cv2.CAP_PROP_CONVERT_RGB, 0)
        fourcc = (
            int(capture.get(cv2.CAP_PROP_FOURCC))
            .to_bytes(4, "little")
            .decode("ascii", errors="replace")
        )
        width_got = int(capture.get(cv2.CAP_PROP_FRAME_WIDTH))
        height_got = int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT))
        # Read back, because OpenCV returns True for what the driver replaced.
        if (fourcc, width_got, height_got) != (self._fourcc, width_px, height_px):
            offered = set(v4l2_node.formats(self._device))
            usable = ", ".join(code for code in FOURCCS if code in offered) or "none of our formats"
            raise self._refused(
                f"requested {width_px}x{height_px} {self._fourcc}, but got "
                f"{width_got}x{height_got} {fourcc} (it offers {usable})"
            )
        exposure = v4l2_node.lock_exposure(capture, self._exposure)
        if self._exposure is not None and exposure.value != self._exposure:
            got = (
                "but the driver has no such control"
                if exposure.value is None
                else f"but got {exposure.value:g}"
            )
            raise self._refused(f"requested exposure {self._exposure}, {got}")
        # Only the luma is used, but gains of the colours change it too.
        white_balance = v4l2_node.lock_white_balance(capture)
        others = v4l2_node.lock_others(self._device)
        return {
            "format": fourcc,
            "width_px": width_got,
            "height_px": height_got,
            "fps_asked": self._fps,
            "fps_stated": round(capture.get(cv2.CAP_PROP_FPS), 2),
            "exposure": str(exposure),
            "exposure_lock": exposure.lock,
            **({} if exposure.value is None else {"exposure_value": exposure.value}),
            "white_balance": str(white_balance),
            "white_balance_lock": white_balance.lock,
            **{f"{name}_lock": control.lock for name, control in others.items()},
        }

    def _refused(self, what: str) -> TacshadeError:
        error = DeviceError if self._proven else ConfigError
        return error(f"{self._name}: {what}", code=ReasonCode.NOT_OFFERED)

    def _check_stamps(self, capture: cv2.VideoCapture) -> None:
        """Grab the first frame and decide whether the driver's time stamps are CLOCK_MONOTONIC."""
        self._grab(capture)
        age_ns = time.monotonic_ns() - _kernel_stamp_ns(capture)
        self._has_stamps = (
            # Up to a period ahead of the clock is still that clock (see above).
            -1e9 / max(float(self._settings["fps_stated"]), 1.0) <= age_ns < _STAMP_AGE_MAX_NS
        )
        self._settings["time_stamps"] = "kernel" if self._has_stamps else "on arrival"
        self._settings["drops"] = "inferred from time stamps" if self._has_stamps else "not known"

    def _grab(self, capture: cv2.VideoCapture) -> None:
        began_ns = time.monotonic_ns()
        if not capture.grab():
            waited_s = (time.monotonic_ns() - began_ns) / 1e9
            # Reading a device that is gone fails at once, although OpenCV still reports it as open.
            # Nothing but the waiting time tells the two apart: OpenCV passes no error of the
            # kernel's on.
            gone = waited_s < 0.5 * _STALL_S
            why = (
                "the device is gone, or its driver has stopped"
                if gone
                else "the camera has stalled"
            )
            code = ReasonCode.LOST if gone else ReasonCode.STALLED
            raise DeviceError(f"{self._name}: no frame within {waited_s:.1f} s: {why}", code=code)

    def _decoded(self, capture: cv2.VideoCapture, *, grabbed: bool = False) -> Frame:
        """Return the next frame that can be decoded; undecodable ones count as dropped."""
        size = 0
        for _ in range(_UNDECODABLE_MAX):
            if not grabbed:
                self._grab(capture)
            grabbed = False
            # Between grab and decoding: a JPEG takes milliseconds, which are not the age of the
            # frame.
            t_ns = self._date(_kernel_stamp_ns(capture), time.monotonic_ns())
            ok, raw = capture.retrieve()
            image = (
                decode(np.asarray(raw, np.uint8).reshape(-1), self._fourcc, *self._shape)
                if ok
                else None
            )
            if image is not None:
                return Frame(self._seq, t_ns, unix_ns(t_ns), image)
            size = raw.size if ok else 0
            self._dropped += 1
        asked = f"{self._shape[1]}x{self._shape[0]} {self._fourcc}"
        found = (
            f"found {_UNDECODABLE_MAX} frames in a row that were not {asked} (the last had {size} "
            "bytes)"
        )
        raise DeviceError(f"{self._name}: {found}", code=ReasonCode.DECODE)


def decode(raw: U8, fourcc: str, height_px: int, width_px: int) -> U8 | None:
    """Decode one buffer (N,) of a camera into a grey image (height_px, width_px); None if it is not
    one whole image of that size. Damage between a JPEG's markers can go unnoticed, as the decoder
    paints over it.
    """
    if fourcc == "MJPG":
        return _decode_jpeg(raw, height_px, width_px)
    luma_px = height_px * width_px
    if fourcc == "NV12":  # all luma, then half as many bytes of chroma
        return raw[:luma_px].reshape(height_px, width_px) if 2 * raw.size == 3 * luma_px else None
    channels = 2 if fourcc == "YUYV" else 1
    if raw.size != luma_px * channels:
        return None
    # YUYV interleaves: every other byte is luma.
    return np.ascontiguousarray(raw.reshape(height_px, width_px, channels)[:, :, 0])


def _decode_jpeg(raw: U8, height_px: int, width_px: int) -> U8 | None:
    data = raw.tobytes()
    # Without this test OpenCV would also decode a PNG or a TIFF, which no camera sends.
    if not data.startswith(b"\xff\xd8"):
        return None
    try:
        # From the last end marker on it is padding, which cameras append in any length.
        whole = data[: data.rfind(b"\xff\xd9") + 2]
        image = decode_image(whole, cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION)
    except DecodeError:
        return None
    return image if image.shape == (height_px, width_px) else None


def _kernel_stamp_ns(capture: cv2.VideoCapture) -> int:
    return (
        # OpenCV makes milliseconds of them as a float; the kernel counts whole microseconds.
        round(capture.get(cv2.CAP_PROP_POS_MSEC) * 1000) * 1000
    )
