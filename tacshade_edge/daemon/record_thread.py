"""The thread `record`: encodes the frames that `grab` gives it, keeps the pre-roll, and writes the
recording that goes on, so that no frame waits for the disk.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Final, Literal

import numpy as np

from tacshade_edge.calibration.files.calibration_file import packed
from tacshade_edge.daemon.byte_queue import ByteQueue
from tacshade_edge.daemon.ongoing_recording import OngoingRecording
from tacshade_edge.daemon.pre_roll import PreRoll, Shot, frames_among
from tacshade_edge.errors import DeviceError
from tacshade_edge.files.atomic_files import FREE_FLOOR_BYTES
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.recording.recorder import png_of
from tacshade_edge.recording.recording_content import Event
from tacshade_edge.types import Frame

# 54 grey frames of 640x480: almost a second at 60 per second.
# Part of the 150 MB that the service may use.
QUEUE_BYTES: Final = 16 * 2**20
SYNC_S: Final = 1.0
# Replaces the pixels of a frame that is kept as PNG; kept raw, a pre-roll would be 40 % shorter.
_NO_PIXELS = np.zeros((0, 0), np.uint8)


class RecordThread:
    """Takes what `queue` holds; `written`, and `posed`, which may wait for a frame's pose, are
    called in this thread.
    """

    def __init__(
        self, written: Callable[[], None], posed: Callable[[Frame], Frame], pre_roll_ns: int
    ) -> None:
        self.queue: ByteQueue[Frame | Event | OngoingRecording | Literal["end"]] = ByteQueue(
            QUEUE_BYTES
        )
        self.pre_roll = PreRoll(pre_roll_ns)
        self._written = written
        self._posed = posed
        # A daemon thread: a disk that hangs must not keep the process.
        self._thread = threading.Thread(target=self._run, name="record", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self, timeout_s: float) -> None:
        """Let the thread finish what waits, and wait for it."""
        self.queue.close()
        self._thread.join(timeout_s)

    def _run(self) -> None:
        """Take one in and write one out, so that what is kept never grows,
        and is written while nothing comes.
        """
        # What was kept before comes first: a recording begins with the pre-roll, whose frames were
        # encoded as they came. So the queue alone absorbs a slow disk.
        kept, recording, synced_s = self.pre_roll.kept, None, 0.0
        while True:
            writing = recording is not None and bool(kept)
            item = self.queue.take(0 if writing else SYNC_S)
            if item is None and not writing and self.queue.drained:
                return
            now_ns = time.monotonic_ns()
            try:
                if isinstance(item, OngoingRecording):
                    recording = item
                    item.recorder.begin(item.settings_yaml, packed(item.calibration))
                elif isinstance(item, Frame):
                    # This may wait 120 ms for the next pose; the queue holds what comes meanwhile.
                    frame = self._posed(item)
                    kept.append(Shot(replace(frame, image=_NO_PIXELS), png_of(frame.image)))
                    now_ns = item.t_ns  # by the frames: a backlog must not shorten the pre-roll
                elif item is not None and (recording is not None or isinstance(item, Event)):
                    kept.append(item)
                if recording is None:
                    self.pre_roll.bound(now_ns)
                elif kept and self._write(recording):
                    recording = None
                elif time.monotonic() - synced_s >= SYNC_S:
                    recording.recorder.sync()
                    synced_s = time.monotonic()
            except DeviceError as error:
                # The daemon goes on without a disk; the next recording may find one.
                assert recording is not None
                self._fail(recording, error.reason)
                recording = None

    def _write(self, recording: OngoingRecording) -> bool:
        """Write the oldest of what is kept; return whether it was the end."""
        item, recorder = self.pre_roll.kept[0], recording.recorder
        if isinstance(item, str):
            self._finish(recording)
        elif isinstance(item, Event):
            recorder.event(item.t_ns, item.kind, item.data)
        elif not recorder.add(item.frame, item.png):
            found = f"less than {FREE_FLOOR_BYTES // 2**20} MiB free on the disk"
            raise DeviceError(found, code=ReasonCode.DISK_FULL)
        else:
            recording.first = recording.first or (item.frame.t_ns, item.frame.wall_ns)
        # Only now: a frame whose writing failed counts as lost, like the others that are kept.
        self.pre_roll.kept.popleft()
        return isinstance(item, str)

    def _fail(self, recording: OngoingRecording, reason: Reason) -> None:
        """End a recording that cannot be written further; what waits for it is lost."""
        # "end" may be among what waits, and is dropped with it: the recording is finished here.
        recording.ending = recording.ending or reason
        waiting = [self.queue.take(0) for _ in range(len(self.queue))]
        recording.lost += frames_among((*waiting, *self.pre_roll.kept))
        self.pre_roll.kept.clear()
        self._finish(recording)

    def _finish(self, recording: OngoingRecording) -> None:
        now = recording.now()
        times = dict(
            zip(("first_t_ns", "first_wall_ns"), recording.first or (None, None), strict=True)
        )
        try:
            recording.recorder.finish({**now.as_dict(), **times, **recording.about})
        except DeviceError as error:
            if not now.failed:
                recording.ending = error.reason
            recording.recorder.close()
        # In this order: `written` wakes the main thread, whose `poll` looks at `done`.
        recording.done = True
        self._written()
