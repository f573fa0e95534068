"""Camera frames through OpenCV's V4L2 backend.

What OpenCV leaves to us: it reports a device as open that gives no frame, silently takes another format than the
one asked for, and knows no sequence numbers. So a node is checked before it is opened, everything asked is read
back, and only a frame that was read proves a camera.

Limits. OpenCV hides the kernel's error flag of a buffer; a damaged frame is noticed by its length or by the JPEG
decoder. OpenCV gives a raw buffer back to the driver just before it copies it: a reader that is late by all the
buffers at once can see the next frame's lines in it.

Time stamps. A driver may stamp a frame with the end that it computed for it, and so be up to a period ahead of the
clock (the kernel's test driver is, USB cameras by a little): such a stamp shows the clock and the gaps, but a frame
is never dated after its arrival.
"""

from __future__ import annotations

import logging
import os
import time

import cv2
import numpy as np

from tacshade_edge.core.image.image_bytes import decode_image
from tacshade_edge.devices.camera import v4l2_controls, v4l2_node
from tacshade_edge.devices.camera.frame_gaps import FrameGaps
from tacshade_edge.errors import ConfigError, DecodeError, DeviceError, TacshadeError
from tacshade_edge.reasons import ReasonCode
from tacshade_edge.types import U8, Frame

_log = logging.getLogger(__name__)

FOURCCS = ("MJPG", "YUYV", "NV12", "GREY")
_STALL_S = 2  # OpenCV's own limit is 10 s a read
_BUFFERS = 4
_STAMP_AGE_MAX_NS = 1_000_000_000
_UNDECODABLE_MAX = 30  # in a row: a second of them is not a camera


class V4l2Source:
    """A `FrameSource` (devices.base) on a V4L2 camera; frames are grey, the luma that the camera sent.

    The luma of YUYV, NV12 and GREY is passed on as it is, never rescaled from the video range; MJPG is decoded to grey.
    Exposure and white balance are locked where the driver has the controls. All methods belong to one thread,
    except `dropped` and `describe`.

    Parameters
    ----------
    device : str
        Path of the node, best one under /dev/v4l/by-id: numbers change when cables do.
    width_px, height_px : int
    fps : float
        Asked of the driver, which may choose another; `describe` reports what was stated and what is measured.
    fourcc : str
        MJPG, YUYV, NV12 or GREY.
    exposure : int or None
        In the driver's unit (100 µs for USB cameras); None keeps the driver's value. Automatic is off either way.

    Raises
    ------
    ConfigError
        When the arguments can suit no camera.
    """

    def __init__(
        self, device: str, width_px: int, height_px: int, fps: float, fourcc: str, exposure: int | None = None
    ) -> None:
        if fourcc not in FOURCCS:
            raise ConfigError(f"camera {device}: found format {fourcc!r}, expected one of {', '.join(FOURCCS)}")
        if min(width_px, height_px) < 1 or not fps > 0:
            raise ConfigError(
                f"camera {device}: found {width_px}x{height_px} at {fps:g} fps, expected positive numbers"
            )
        self._device = device
        self._shape = (height_px, width_px)
        self._fps = fps
        self._fourcc = fourcc
        self._exposure = exposure
        self._capture: cv2.VideoCapture | None = None
        self._pending: Frame | None = None
        self._proven = False  # this configuration gave frames before
        self._kernel_stamps = False
        self._gaps = FrameGaps()
        self._seq = -1
        self._dropped = 0
        self._negotiated: dict[str, str | int | float] = {}

    @property
    def dropped(self) -> int:
        """Frames inferred from gaps between kernel time stamps, or that could not be decoded, since the first open."""
        return self._dropped

    def open(self) -> None:
        """Check the node, negotiate, lock the controls, and read one frame, which the next `read` returns.

        Raises
        ------
        DeviceError
            Absent, does not capture, busy, or it gives no frame.
        ConfigError
            The path is there and is no video device; or the device gives another format or size, or not the
            exposure: drivers choose these by what was asked alone, so asking again cannot help. Once the same
            configuration has worked it is a DeviceError: then it is the device that changed.
        """
        self.close()
        try:
            card = v4l2_node.check_node(self._device)
        except ConfigError as error:
            if self._proven:
                raise DeviceError(str(error), code=error.code) from None
            raise
        # OpenCV reads this when it first waits; its warnings would double our one line.
        os.environ.setdefault("OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT", str(_STALL_S))
        cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_ERROR)
        capture = cv2.VideoCapture(self._device, cv2.CAP_V4L2)
        try:
            if not capture.isOpened():
                if v4l2_node.is_busy(self._device):
                    raise DeviceError(f"camera {self._device}: in use by another program", code=ReasonCode.IN_USE)
                raise DeviceError(f"camera {self._device}: cannot set it up for capture")
            self._negotiated = {"card": card, **self._negotiate(capture)}
            self._gaps = FrameGaps()
            self._check_stamps(capture)
            self._pending = self._decoded(capture, grabbed=True)
        except TacshadeError:
            capture.release()
            raise
        self._capture = capture
        self._proven = True
        _log.info("camera %s: %s", self._device, ", ".join(f"{name} {got}" for name, got in self._negotiated.items()))

    def read(self) -> Frame | None:
        """Wait for the next frame, at most about two seconds. Raises DeviceError when the device is lost."""
        if self._capture is None:
            raise DeviceError(f"camera {self._device}: not open")
        frame, self._pending = self._pending, None
        return frame or self._decoded(self._capture)

    def skip(self) -> bool:
        """Give the next frame's buffer back to the driver as it is. Waits and raises as `read`."""
        if self._capture is None:
            raise DeviceError(f"camera {self._device}: not open")
        if self._pending is None:
            self._grab(self._capture)
            self._date(self._capture, time.monotonic_ns())
        self._pending = None
        return True

    def close(self) -> None:
        """Release the device; safe to call twice."""
        self._pending = None
        if self._capture is not None:
            self._capture.release()
            self._capture = None

    def describe(self) -> dict[str, str | int | float]:
        """What was negotiated; ``fps_measured`` is 0 until there are frames."""
        period_ns = self._gaps.period_ns
        measured = round(1e9 / period_ns, 2) if period_ns else 0.0
        return {"device": self._device, **self._negotiated, "fps_measured": measured}

    def _negotiate(self, capture: cv2.VideoCapture) -> dict[str, str | int | float]:
        """Set all in the order that drivers need, read all back."""
        height_px, width_px = self._shape
        capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*self._fourcc))
        capture.set(cv2.CAP_PROP_FRAME_WIDTH, width_px)
        capture.set(cv2.CAP_PROP_FRAME_HEIGHT, height_px)
        capture.set(cv2.CAP_PROP_FPS, self._fps)
        capture.set(cv2.CAP_PROP_BUFFERSIZE, _BUFFERS)
        capture.set(cv2.CAP_PROP_CONVERT_RGB, 0)
        fourcc = int(capture.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little").decode("ascii", errors="replace")
        width_got = int(capture.get(cv2.CAP_PROP_FRAME_WIDTH))
        height_got = int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT))
        if (fourcc, width_got, height_got) != (self._fourcc, width_px, height_px):
            offered = set(v4l2_node.formats(self._device))
            usable = ", ".join(code for code in FOURCCS if code in offered) or "none of our formats"
            raise self._refused(
                f"requested {width_px}x{height_px} {self._fourcc}, but got {width_got}x{height_got} {fourcc}"
                f" (it offers {usable})"
            )
        exposure, white_balance = self._lock_exposure(capture), v4l2_controls.lock_white_balance(capture)
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
        }

    def _lock_exposure(self, capture: cv2.VideoCapture) -> v4l2_controls.Control:
        control = v4l2_controls.lock_exposure(capture, self._exposure)
        if self._exposure is not None and control.value != self._exposure:
            got = "but the driver has no such control" if control.value is None else f"but got {control.value:g}"
            raise self._refused(f"requested exposure {self._exposure}, {got}")
        return control

    def _refused(self, what: str) -> TacshadeError:
        error = DeviceError if self._proven else ConfigError
        return error(f"camera {self._device}: {what}", code=ReasonCode.NOT_OFFERED)

    def _check_stamps(self, capture: cv2.VideoCapture) -> None:
        """Grab the first frame and decide whether the driver's time stamps are CLOCK_MONOTONIC."""
        self._grab(capture)
        age_ns = time.monotonic_ns() - _kernel_stamp_ns(capture)
        self._kernel_stamps = -self._period_stated_ns() <= age_ns < _STAMP_AGE_MAX_NS
        self._negotiated["time_stamps"] = "kernel" if self._kernel_stamps else "on arrival"
        self._negotiated["drops"] = "inferred from time stamps" if self._kernel_stamps else "not known"

    def _period_stated_ns(self) -> float:
        return 1e9 / max(float(self._negotiated["fps_stated"]), 1.0)

    def _grab(self, capture: cv2.VideoCapture) -> None:
        began_ns = time.monotonic_ns()
        if not capture.grab():
            waited_s = (time.monotonic_ns() - began_ns) / 1e9
            # A read of a device that is gone fails at once, though OpenCV goes on calling it open.
            gone = waited_s < 0.5 * _STALL_S
            why = "the device is gone, or its driver has stopped" if gone else "the camera has stalled"
            raise DeviceError(
                f"camera {self._device}: no frame within {waited_s:.1f} s: {why}",
                code=ReasonCode.LOST if gone else ReasonCode.STALLED,
            )

    def _decoded(self, capture: cv2.VideoCapture, grabbed: bool = False) -> Frame:
        """The next frame that can be decoded; those passed over count as dropped."""
        size = 0
        for _ in range(_UNDECODABLE_MAX):
            if not grabbed:
                self._grab(capture)
            grabbed = False
            now_ns, wall_ns = time.monotonic_ns(), time.time_ns()
            t_ns = self._date(capture, now_ns)
            ok, raw = capture.retrieve()
            image = decode(np.asarray(raw, np.uint8).reshape(-1), self._fourcc, *self._shape) if ok else None
            if image is not None:
                return Frame(self._seq, t_ns, wall_ns - (now_ns - t_ns), image)
            size = raw.size if ok else 0
            self._dropped += 1
        raise DeviceError(
            f"camera {self._device}: found {_UNDECODABLE_MAX} frames in a row that were not"
            f" {self._shape[1]}x{self._shape[0]} {self._fourcc} (the last had {size} bytes)",
            code=ReasonCode.DECODE,
        )

    def _date(self, capture: cv2.VideoCapture, now_ns: int) -> int:
        """Time stamp of the frame that was grabbed, which gets its number, and those that were lost before it too."""
        t_ns, lost = now_ns, 0
        if self._kernel_stamps:
            stamp_ns = _kernel_stamp_ns(capture)
            lost = self._gaps.add(stamp_ns)
            t_ns = min(stamp_ns, now_ns)
        else:
            self._gaps.add(now_ns)  # for the measured rate; arrival is too uneven to infer losses from
        self._seq += 1 + lost
        self._dropped += lost
        return t_ns


def decode(raw: U8, fourcc: str, height_px: int, width_px: int) -> U8 | None:
    """Grey image of one buffer of a camera.

    Parameters
    ----------
    raw : uint8 (N,)
        The bytes that the driver filled.
    fourcc : str
        MJPG, YUYV, NV12 or GREY.
    height_px, width_px : int

    Returns
    -------
    uint8 (height_px, width_px), or None
        None when the bytes are not one whole image of that size. A JPEG must reach its end marker; damage between
        the markers can pass, as the decoder paints over it.
    """
    if fourcc == "MJPG":
        return _decode_jpeg(raw, height_px, width_px)
    luma_px = height_px * width_px
    if fourcc == "NV12":  # all luma, then half as many bytes of chroma
        return raw[:luma_px].reshape(height_px, width_px) if 2 * raw.size == 3 * luma_px else None
    channels = 2 if fourcc == "YUYV" else 1
    if raw.size != luma_px * channels:
        return None
    return np.ascontiguousarray(raw.reshape(height_px, width_px, channels)[:, :, 0])


def _decode_jpeg(raw: U8, height_px: int, width_px: int) -> U8 | None:
    data = raw.tobytes()
    if not data.startswith(b"\xff\xd8"):
        return None
    try:
        whole = data[: data.rfind(b"\xff\xd9") + 2]  # cameras pad, by any amount
        image = decode_image(whole, cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION)
    except DecodeError:
        return None
    return image if image.shape == (height_px, width_px) else None


def _kernel_stamp_ns(capture: cv2.VideoCapture) -> int:
    return round(capture.get(cv2.CAP_PROP_POS_MSEC) * 1000) * 1000  # the kernel's are whole microseconds
