"""Frames of a Raspberry Pi's own (CSI, ribbon cable) camera:
the program ``rpicam-vid`` writes them into a pipe.

It writes each frame as raw YUV 4:2:0, whose first plane is the grey image, and after each frame a
metadata record into a second pipe (rpicam-apps, output/output.cpp): the sensor's time stamp,
exposure and gain. The next record reveals a stream that is out of step. The program does not report
the line length, which equals the width if that is a multiple of 64. White balance is fixed, since
it precedes the grey image.
"""

from __future__ import annotations

import contextlib
import fcntl
import logging
import os
import select
import signal
import subprocess
import time

import numpy as np

from tacshade_edge.camera.csi_camera import PROGRAM
from tacshade_edge.camera.frame_source import Camera, FrameGaps, unix_ns
from tacshade_edge.camera.v4l2_node import Control, Lock
from tacshade_edge.errors import ConfigError, DeviceError
from tacshade_edge.reasons import ReasonCode
from tacshade_edge.types import U8, Frame

_log = logging.getLogger(__name__)

_STALL_S = 2.0
_START_S = 5.0  # a cold board loads libcamera and tunes the sensor
# Between SIGINT and SIGKILL; libcamera stops the sensor meanwhile.
_END_S = 1.0
# As of V4L2: another clock than CLOCK_MONOTONIC is off by far more.
_STAMP_AGE_MAX_NS = 1_000_000_000
_SETTLING = 30  # number of first frames that may not yet have the requested exposure
_EXPOSURE_OFF = 0.05  # relative deviation: a sensor exposes whole lines
_PIPE_BYTES = 1 << 20  # the most that a user may request; a frame of 640x480 has 460 800
_SAID_BYTES = 4096


def _command(
    camera: int,
    shape: tuple[int, int],
    fps: float,
    exposure_us: int,
    gain: float,
    lens_position: float | None,
    sensor_mode: str | None,
) -> tuple[str, ...]:
    height_px, width_px = shape
    command = [PROGRAM, "--camera", str(camera)]
    command += ["--width", str(width_px), "--height", str(height_px), "--framerate", f"{fps:g}"]
    # White balance at gains of 1: it precedes the luma, so an automatic one would change grey
    # levels.
    command += ["--shutter", str(exposure_us), "--gain", f"{gain:g}", "--awbgains", "1,1"]
    place = "default" if lens_position is None else f"{lens_position:g}"
    command += ["--autofocus-mode", "manual", "--lens-position", place]
    if sensor_mode:
        command += ["--mode", sensor_mode]
    # Colour is thrown away, so its denoiser would only cost time; a time-out of 0 is none.
    command += ["--denoise", "cdn_off", "--codec", "yuv420", "--timeout", "0"]
    # Flushed after every frame: the pipe would otherwise hold one back.
    command += ["--nopreview", "--verbose", "0", "--flush", "--output", "-"]
    command += ["--metadata-format", "txt", "--metadata"]
    return tuple(command)


class RpicamSource(Camera):
    """A camera on ``rpicam-vid``; frames are grey, the luma of YUV 4:2:0 in full range.

    `camera`: number of the camera in ``rpicam-vid --list-cameras``. `width_px`, `height_px`: the
    width is a multiple of 64. `exposure_us`: locked exposure time. `gain`: locked gain of the
    sensor. `lens_position`: locked focus in dioptres, if the lens moves; by default the camera's
    own resting place. `sensor_mode`: ``WIDTH:HEIGHT`` of the sensor's mode; by default rpicam-vid
    chooses, for small images often a cropped one.
    """

    def __init__(
        self,
        camera: int,
        width_px: int,
        height_px: int,
        fps: float,
        exposure_us: int,
        gain: float,
        lens_position: float | None = None,
        sensor_mode: str | None = None,
    ) -> None:
        super().__init__(name := f"camera {camera} of {PROGRAM}", name)
        self._shape = (height_px, width_px)
        self._exposure_us, self._gain = exposure_us, gain
        self._command = _command(
            camera, self._shape, fps, exposure_us, gain, lens_position, sensor_mode
        )
        self._settings = {"width_px": width_px, "height_px": height_px, "fps_asked": fps}
        self._stream: _Stream | None = None
        # Passed-over frames go here: they must be read, and nobody keeps them.
        self._unseen: U8 = np.empty(height_px * width_px * 3 // 2, np.uint8)

    def open(self) -> None:
        """Start the program and read until a frame has the requested exposure;
        the next `read` returns it.

        Raises DeviceError (the program or camera is absent, the camera is in use, or it delivers no
        frame), ConfigError (the camera rejects the exposure or the gain; or its lines are longer
        than the image is wide).
        """
        self.close()
        self._gaps = FrameGaps()
        self._stream = _Stream(self._name, self._command, self._shape)
        try:
            self._pending = self._first(self._stream)
        except DeviceError as error:
            self.close()
            if error.code is ReasonCode.NOT_OFFERED and not self._proven:
                raise ConfigError(str(error), code=error.code) from None
            raise
        self._proven = True
        _log.info(
            "%s: %s", self._name, ", ".join(f"{name} {got}" for name, got in self._settings.items())
        )

    def _next(self) -> Frame:
        if self._stream is None:
            raise self._not_open()
        return self._framed(*self._stream.next(_STALL_S))

    def _pass_over(self) -> None:
        if self._stream is None:
            raise self._not_open()
        self._date(_stamp_ns(self._stream.next(_STALL_S, self._unseen)[1]), time.monotonic_ns())

    def close(self) -> None:
        """End the program; safe to call twice."""
        self._pending = None
        if self._stream is not None:
            self._stream.close()
            self._stream = None

    def _first(self, stream: _Stream) -> Frame:
        """Return the first frame that has the requested exposure and no excess bytes."""
        image, record = self._settled(stream)
        period_us = _number(record, "FrameDuration")
        age_ns = time.monotonic_ns() - _number(record, "SensorTimestamp")
        # A sensor's clock may be another than ours, so only an age that a frame can have shows
        # that it is CLOCK_MONOTONIC.
        self._has_stamps = -1000 * period_us <= age_ns < _STAMP_AGE_MAX_NS
        self._settings |= self._found(record, period_us)
        return self._framed(image, record)

    def _settled(self, stream: _Stream) -> tuple[U8, dict[str, str]]:
        """Pass over frames until one has the requested exposure and is in step; return it."""
        in_step, was_in_step, exposure_us, gain = True, True, float("nan"), float("nan")
        for _ in range(_SETTLING):
            image, record = stream.next(_START_S)
            exposure_us, gain = _number(record, "ExposureTime"), _number(record, "AnalogueGain")
            was_in_step, in_step = in_step, stream.in_step()
            # Twice: if nine shorter frames fill eight of ours,
            # the ninth is reported too late to be noticed.
            is_asked = _is_near(exposure_us, self._exposure_us) and _is_near(gain, self._gain)
            if is_asked and in_step and was_in_step:
                return image, record
        if not (in_step and was_in_step):
            raise stream.other_size()
        asked = f"requested an exposure of {self._exposure_us} us and a gain of {self._gain:g}"
        text = f"{self._name}: {asked}, but got {exposure_us:g} us and {gain:g}"
        raise DeviceError(text, code=ReasonCode.NOT_OFFERED)

    def _found(self, record: dict[str, str], period_us: float) -> dict[str, str | int | float]:
        """What the camera does, from its first record."""
        exposure_us = _number(record, "ExposureTime")
        exposure, white_balance = Control(Lock.LOCKED, exposure_us), Control(Lock.LOCKED)
        found: dict[str, str | int | float] = {
            "format": "YUV420",
            "fps_stated": round(1e6 / period_us, 2) if period_us > 0 else 0.0,
            "exposure": f"{exposure} us",
            "exposure_lock": exposure.lock,
            "exposure_value": exposure_us,
            "gain": round(_number(record, "AnalogueGain"), 3),
            "white_balance": str(white_balance),
            "white_balance_lock": white_balance.lock,
        }
        if "LensPosition" in record:  # only a lens that moves has one
            focus = Control(Lock.LOCKED, _number(record, "LensPosition"))
            found |= {"focus": f"{focus} dioptres", "focus_lock": focus.lock}
        return found | {
            "time_stamps": "sensor" if self._has_stamps else "on arrival",
            "drops": "inferred from time stamps" if self._has_stamps else "not known",
        }

    def _framed(self, image: U8, record: dict[str, str]) -> Frame:
        t_ns = self._date(_stamp_ns(record), time.monotonic_ns())
        return Frame(self._seq, t_ns, unix_ns(t_ns), image)


class _Stream:
    """The running program, a stream of pairs of an image and its record."""

    def __init__(self, name: str, command: tuple[str, ...], shape: tuple[int, int]) -> None:
        self._name = name
        self._shape = shape
        self._bytes = shape[0] * shape[1] * 3 // 2
        self._unread, self._said = b"", b""  # records not yet used; the end of its standard error
        records, write_end = os.pipe()
        try:
            self._process = subprocess.Popen(
                (*command, f"/dev/fd/{write_end}"),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                bufsize=0,
                pass_fds=(write_end,),
                process_group=0,  # a terminal's Ctrl-C must reach only us
            )
        except OSError as error:
            os.close(records)
            code, why = ReasonCode.PERMISSION, error.strerror
            if isinstance(error, FileNotFoundError):
                code, why = (
                    ReasonCode.ABSENT,
                    "no such program, expected that of Debian's package rpicam-apps-lite",
                )
            raise DeviceError(f"{name}: {why}", code=code) from None
        finally:
            # Ours, too: as long as any copy is open, reading would not find the end.
            os.close(write_end)
        assert self._process.stdout
        assert self._process.stderr
        self._frames, self._errors = self._process.stdout.fileno(), self._process.stderr.fileno()
        self._records = records
        with contextlib.suppress(OSError):  # above the user's limit: the pipe stays smaller
            fcntl.fcntl(self._frames, fcntl.F_SETPIPE_SZ, _PIPE_BYTES)
        self._others = [self._records, self._errors]

    def next(self, limit_s: float, space: U8 | None = None) -> tuple[U8, dict[str, str]]:
        """Return the next image, uint8 (H, W), in `space` if given, and its record.

        Raises DeviceError.
        """
        content = np.empty(self._bytes, np.uint8) if space is None else space
        view, have = content.data, 0
        while have < self._bytes or b"\n\n" not in self._unread:
            whole = have == self._bytes
            awaited = self._others if whole else [*self._others, self._frames]
            # Both pipes at once: a program that waits to write to one of them sends nothing into
            # the other.
            ready = select.select(awaited, [], [], limit_s)[0]
            if not ready:
                # A frame is there, its record is not, and more bytes wait: the stream is out of
                # step.
                if whole and _is_readable(self._frames):
                    raise self.other_size()
                text = f"{self._name}: the camera has stalled and is sending no frames"
                raise DeviceError(text, code=ReasonCode.STALLED)
            if self._errors in ready:
                self._hear()
            if self._records in ready:
                if not (words := os.read(self._records, 1 << 16)):
                    raise self._ended()
                self._unread += words
            if self._frames in ready:
                if not (count := os.readv(self._frames, [view[have:]])):
                    raise self._ended()
                have += count
            elif not whole and b"\n\n" in self._unread and not _is_readable(self._frames):
                raise self.other_size()  # a record follows its whole frame
        lines, _, self._unread = self._unread.partition(b"\n\n")
        pairs = (line.partition("=") for line in lines.decode("ascii", "replace").splitlines())
        image = content[: self._shape[0] * self._shape[1]].reshape(self._shape)
        return image, {key: value for key, _, value in pairs}

    def in_step(self) -> bool:
        """Whether no bytes remain of the frame and its record;
        also False if the next have already arrived.
        """
        return (
            b"\n\n" not in self._unread
            and not _is_readable(self._frames)
            and not _is_readable(self._records)
        )

    def close(self) -> None:
        """End the program: with its pipes closed it cannot block,
        and on SIGINT it stops the camera.
        """
        process = self._process
        assert process.stdout
        assert process.stderr
        # Before the signal: a program that is blocked writing a frame does not see it.
        process.stdout.close()
        process.stderr.close()
        os.close(self._records)
        process.send_signal(signal.SIGINT)
        try:
            process.wait(_END_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()

    def _hear(self) -> None:
        """Read what the program wrote to standard error, until it closes it."""
        words = os.read(self._errors, _SAID_BYTES)
        self._said = (self._said + words)[-_SAID_BYTES:]
        if not words:
            self._others.remove(self._errors)

    def _ended(self) -> DeviceError:
        """Return the error for a program that closed its pipes, with its own last message."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            # Its last words come with its end; without waiting, its status is not known.
            self._process.wait(_END_S)
        while self._errors in self._others and _is_readable(self._errors):
            self._hear()
        lines = [
            line.strip()
            for line in self._said.decode("utf-8", "replace").splitlines()
            if line.strip()
        ]
        why = next(
            (line for line in reversed(lines) if line.startswith("ERROR")),
            lines[-1] if lines else "no output",
        )
        why = why.removeprefix("ERROR:").strip(" *")
        # Words of libcamera ("failed to acquire camera", "no cameras available").
        codes = {"acquire": ReasonCode.IN_USE, "available": ReasonCode.ABSENT}
        code = next((code for word, code in codes.items() if word in why), ReasonCode.LOST)
        status = self._process.returncode
        return DeviceError(
            f"{self._name}: the program exited with status {status}: {why!r}", code=code
        )

    def other_size(self) -> DeviceError:
        """Return the error for frames of the wrong size."""
        height_px, width_px = self._shape
        expected = f"expected frames of {self._bytes} bytes ({width_px}x{height_px} YUV)"
        return DeviceError(
            f"{self._name}: found frames of another size, {expected}", code=ReasonCode.NOT_OFFERED
        )


def _is_readable(fd: int) -> bool:
    return bool(select.select([fd], [], [], 0.0)[0])


def _is_near(got: float, asked: float) -> bool:
    """Whether a value is nearly as requested; one that is missing counts as right."""
    return bool(np.isnan(got) or abs(got - asked) <= _EXPOSURE_OFF * asked)


def _number(record: dict[str, str], key: str) -> float:
    """Return a value of a record; NaN if it is missing or not a number."""
    try:
        return float(record.get(key, "nan"))
    except ValueError:
        return float("nan")


def _stamp_ns(record: dict[str, str]) -> int | None:
    stamp_ns = _number(record, "SensorTimestamp")
    return None if np.isnan(stamp_ns) else int(stamp_ns)
