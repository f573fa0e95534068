"""The simulated sensor as a frame source: a scripted hand that presses objects,
at a steady pace.
"""

from __future__ import annotations

import time
from typing import Protocol

from tacshade_edge.camera.frame_source import unix_ns
from tacshade_edge.errors import DecodeError
from tacshade_edge.lab.simulator.press import Press
from tacshade_edge.lab.simulator.script import demonstration
from tacshade_edge.lab.simulator.sensor_model import SensorModel
from tacshade_edge.lab.simulator.truth import SimulatedSensor
from tacshade_edge.types import U8, Frame


class ScriptedHand(Protocol):
    """The presses over time: `lab.simulator.script.Script`, or those read from a file."""

    def at(self, index: int) -> tuple[Press, ...]:
        """Return the presses of a frame."""
        ...


class SimulatedSource:
    """A `FrameSource` that never ends.

    Frame `seq` is due at a whole number of periods after `open`, and `t_ns` is that time, as with a
    camera. A frame that fell due before the reader requested it is dropped and counted. Each frame
    is drawn when it is read, which takes 10 to 40 ms, or 60 to 170 ms at each of the few places of
    a dragged object.

    `script`: the presses of each frame; by default every object in turn.
    """

    def __init__(
        self, *, fps: float, model: SensorModel | None = None, script: ScriptedHand | None = None
    ) -> None:
        self._fps, self._period_ns = fps, round(1e9 / fps)
        self._script: ScriptedHand = script or demonstration()
        self._sensor = SimulatedSensor(model)
        self._next_seq = 0
        self._zero_ns = 0  # when frame 0 was due, or would have been before a reopening
        self._dropped = 0

    @property
    def dropped(self) -> int:
        """Number of frames that fell due and were not read."""
        return self._dropped

    def open(self) -> None:
        """Start the clock."""
        # After a reopening the numbers go on, as those of a camera do.
        self._zero_ns = time.monotonic_ns() - self._next_seq * self._period_ns

    def read(self) -> Frame:
        """Wait until the next frame is due, and return it.

        Raises DecodeError when its presses cannot be drawn.
        """
        seq = self._next()
        # Drawn before it is due, so that the time that drawing takes does not make it late.
        image = self._draw(seq)
        t_ns = self._wait(seq)
        # The wall clock may jump; its time of this frame follows from the clock that does not.
        return Frame(seq=seq, t_ns=t_ns, wall_ns=unix_ns(t_ns), image=image)

    def skip(self) -> bool:
        """Wait until the next frame is due, and do not draw it."""
        self._wait(self._next())
        return True

    def close(self) -> None:
        """Nothing to release."""

    def _next(self) -> int:
        """Return the number of the next frame that is due now or later."""
        missed = (time.monotonic_ns() - self._zero_ns) // self._period_ns - self._next_seq
        if missed > 0:
            self._dropped += missed
            self._next_seq += missed
        seq = self._next_seq
        self._next_seq += 1
        return seq

    def _wait(self, seq: int) -> int:
        """Wait until a frame is due; return its time stamp in ns."""
        t_ns = self._zero_ns + seq * self._period_ns
        if (ahead_ns := t_ns - time.monotonic_ns()) > 0:
            time.sleep(ahead_ns / 1e9)
        return t_ns

    def describe(self) -> dict[str, str | int | float]:
        """Return the size and the rate."""
        model = self._sensor.model
        return {
            "device": "simulated",
            "width_px": model.image_width_px,
            "height_px": model.image_height_px,
            "fps": self._fps,
        }

    def _draw(self, index: int) -> U8:
        presses = self._script.at(index)
        try:
            return self._sensor.frame(presses, noise_seed=index).image
        except ValueError as error:
            raise DecodeError(f"cannot press the simulated sensor this way: {error}") from None
