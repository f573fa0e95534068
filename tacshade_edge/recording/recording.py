"""Reads a recording (images, a video or an MCAP file with time stamps) frame by frame
and drops none.
"""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple

from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.files.images import SUFFIXES, images_in, read_image
from tacshade_edge.quoting import counted, encodable, shown
from tacshade_edge.recording.frame_table import (
    T_NS_MAX,
    FrameTable,
    TableRow,
    read_table,
    table_in,
)
from tacshade_edge.recording.mcap import how_to_convert, is_mcap, mcap_frames
from tacshade_edge.recording.recording_content import wall_minus_t_ns
from tacshade_edge.recording.video import DEFAULT_FPS, Video
from tacshade_edge.regular_files import named_file
from tacshade_edge.types import U8, Frame

# With it, the latest time of a table or a file still fits in the 64 bits of the wire format.
_SHIFT_MAX_NS: Final = 2**64 - 1 - 2 * T_NS_MAX

Picture = Callable[[], U8]
"""Reads an image when its turn comes. Raises DecodeError."""


@dataclass(frozen=True, slots=True, eq=False)
class RecordedFrame:
    """A frame with the name of its image (or its number in a video or an MCAP file) and the Unix
    time of the capture (or `t_ns`, if unknown); the frame's own `wall_ns` is 0, so that equal
    recordings give equal bytes.
    """

    name: str
    frame: Frame
    wall_ns: int = 0


class Entry(NamedTuple):
    """A frame whose picture has not been read yet."""

    seq: int
    row: TableRow
    picture: Picture
    wall_ns: int


class Recording:
    """A folder of images (table ``frames.csv``), one image, a video ``NAME.mp4`` (table
    ``NAME.csv``, if `video_table`) or MCAP.

    Raises ConfigError if there is nothing to replay, or the table is wrong.

    `fps` is the frame rate of the time stamps without a table, instead of a video's own; the
    attribute is None where the recording has its own times. Time stamps and numbers keep growing in
    `times` passes (0 repeats endlessly). `topic` chooses among those of an MCAP file. `cut_off`:
    the writer crashed; everything it wrote before is included. `damage` is of everything but
    images, for a person, and `lost` the number of images whose lines it took. `images` is the
    number of frames of one pass and `frames` that of all; 0 or None if unknown before the end.
    """

    def __init__(
        self,
        path: Path,
        *,
        fps: float | None = None,
        times: int = 1,
        video_table: bool = True,
        topic: str | None = None,
    ) -> None:
        self._path = path
        self._mcap = mcap_frames(path, topic) if is_mcap(path) else None
        if topic is not None and self._mcap is None:
            raise ConfigError(f"--topic: found {shown(topic)}, expected none: {path} is not MCAP")
        self._table = None if self._mcap else _table_beside(path, video_table=video_table)
        self._rows: FrameTable | None = None
        self._video: Video | None = None
        self.cut_off, self.damage, self.images, self.lost = False, "", 0, 0
        if fps is not None and (stated := path if self._mcap else self._table) is not None:
            raise ConfigError(
                f"--fps: found {fps:g}, expected no value, "
                f"because {stated} contains the time stamps"
            )
        if self._mcap is not None:
            self.cut_off, self.damage = self._mcap.cut_off, self._mcap.damage
        elif self._table is not None:
            self.cut_off = self._table.suffix == ".part"
            self._rows = read_table(self._table, cut_off=self.cut_off)
            self.damage, self.images = self._rows.damage, len(self._rows)
            if self._rows.damaged or self._rows.zero_bytes:
                self._count_lost(self._table, self._rows)
        else:
            images, video = _look_at(path)
            self.images = len(images)
            self._video = video
        has_times = self._mcap or self._table or (self._video and fps is None)
        self.fps = None if has_times else fps or DEFAULT_FPS
        self._period_ns = 1e9 / (self.fps or (self._video.fps if self._video else DEFAULT_FPS))
        # Only our own folders state it; a video's frames have no Unix time.
        self._wall_minus_t_ns = wall_minus_t_ns(path) if path.is_dir() else 0
        self.frames = self.images * times or None
        self._shift_ns = 0
        passes = itertools.count() if times == 0 else range(times)
        entries = enumerate(entry for _ in passes for entry in self._one_pass())
        self._entries: Iterator[Entry] = (Entry(seq, *entry) for seq, entry in entries)

    def _count_lost(self, table: Path, rows: FrameTable) -> None:
        """Count the images of a damaged table that no line names any more."""
        named = {row.image for row in rows}
        images = images_in([self._path]) if self._path.is_dir() else []
        self.lost = sum(image.name not in named for image in images)
        if self.lost:
            text = f"no line names {self.lost} of {counted(len(images), 'image')}, which are lost"
            self.damage = f"{self.damage}; {text}" if self.damage else f"{table}: {text}"

    def read(self) -> RecordedFrame | None:
        """The next frame; None after the last.

        Raises DecodeError if this image is unusable, after which the next call continues with the
        next one, and ConfigError if a video's table does not have one row per frame.
        """
        if (entry := self.next_entry()) is None:
            return None
        row = entry.row
        frame = Frame(entry.seq, row.t_ns, 0, entry.picture(), row.pose, row.pose_error_us)
        return RecordedFrame(encodable(row.image), frame, entry.wall_ns)

    def next_entry(self) -> Entry | None:
        """The next frame without its picture; None after the last."""
        return next(self._entries, None)

    @property
    def length_ns(self) -> int:
        """The time from a pass's first frame to its last;
        0 if unknown, as for a video or truncated MCAP file.
        """
        if self._mcap is not None:
            return self._mcap.length_ns
        if self._rows is not None:
            return self._rows[-1].t_ns - self._rows[0].t_ns if len(self._rows) else 0
        return round(max(self.images - 1, 0) * self._period_ns)

    def skip_to(self, t_ns: int, *, frames: int = 0) -> None:
        """Skip the frames before this time except the last `frames` of them;
        in a folder their images are not read.
        """
        before: deque[Entry] = deque(maxlen=frames)
        for entry in self._entries:
            if entry.row.t_ns >= t_ns:
                self._entries = itertools.chain((entry,), self._entries)
                break
            before.append(entry)
        self._entries = itertools.chain(before, self._entries)

    def _one_pass(self) -> Iterator[tuple[TableRow, Picture, int]]:
        first_ns = last_ns = count = 0
        for row, picture, wall_ns in self._items():
            first_ns = row.t_ns if count == 0 else first_ns
            last_ns = row.t_ns
            count += 1
            t_ns = row.t_ns + self._shift_ns
            pose = None if row.pose is None else replace(row.pose, t_ns=t_ns)
            yield replace(row, t_ns=t_ns, pose=pose), picture, wall_ns + self._shift_ns
        # The next pass begins a mean period after this one's last frame.
        length_ns = last_ns - first_ns
        self._shift_ns += length_ns + round(
            length_ns / (count - 1) if count > 1 else self._period_ns
        )
        if self._shift_ns > _SHIFT_MAX_NS:
            found = f"found a length of {length_ns} ns, expected one that can be repeated"
            raise ConfigError(f"{shown(self._path)}: {found} within 64 bits")

    def _items(self) -> Iterator[tuple[TableRow, Picture, int]]:
        if self._mcap is not None:
            yield from self._mcap
            return
        for row, picture in self._files():
            # Times that somebody has rewritten no longer go with the stored clocks; no Unix time
            # has a sign.
            yield row, picture, max(0, row.t_ns + self._wall_minus_t_ns)

    def _files(self) -> Iterator[tuple[TableRow, Picture]]:
        if self._rows is not None and self._path.is_dir():
            yield from (
                (row, partial(read_image, named_file(self._path, row.image))) for row in self._rows
            )
            return
        images, video = _look_at(self._path)
        for index, path in enumerate(images):
            row = TableRow(path.name, round(index * self._period_ns), None)
            yield row, partial(read_image, path)
        if video is None:
            return
        index = t_ns = 0
        frames = iter(video)
        # The end of a cut file comes as a picture that cannot be read, as does damage elsewhere.
        while (frame := _next_of(frames)) is not None:
            if isinstance(frame, DecodeError):
                yield TableRow(str(index), t_ns, None), partial(_raised, frame)
                return
            t_ns, image = frame
            row = self._video_row(index, t_ns)
            t_ns = row.t_ns
            yield row, partial(_same, image)
            index += 1
        if self._rows is not None and index < len(self._rows):
            raise ConfigError(
                f"{self._table}: found {len(self._rows)} rows, expected {index}, "
                "one per video frame"
            )

    def _video_row(self, index: int, own_ns: int) -> TableRow:
        if self._rows is None:
            t_ns = own_ns if self.fps is None else round(index * self._period_ns)
            return TableRow(str(index), t_ns, None)
        row: TableRow | None = self._rows[index] if index < len(self._rows) else None
        if row is None or row.image != str(index):
            found = f"row {index + 1} is not that of frame {index}"
            raise ConfigError(
                f"{self._table}: {found}, expected one row per video frame, "
                "with frames numbered from 0"
            )
        return row


def _look_at(path: Path) -> tuple[list[Path], Video | None]:
    """The paths of a folder's images or of one image, or the opened video. Raises ConfigError."""
    if convert := how_to_convert(path):
        raise ConfigError(f"{path}: {convert}")
    if path.is_dir():
        return images_in([path]), None
    if not path.is_file():
        raise ConfigError(
            f"{path}: found nothing, expected a folder of images, an image or a video file"
        )
    if path.suffix.lower() in SUFFIXES:
        return [path], None
    return [], Video(path)


def _next_of(frames: Iterator[tuple[int, U8]]) -> tuple[int, U8] | DecodeError | None:
    try:
        return next(frames, None)
    except DecodeError as error:
        return error


def _same(image: U8) -> U8:
    return image


def _raised(error: DecodeError) -> U8:
    raise error


def _table_beside(path: Path, *, video_table: bool) -> Path | None:
    if path.is_dir():
        return table_in(path)
    is_video = path.is_file() and path.suffix.lower() not in SUFFIXES
    table = path.with_suffix(".csv")
    return table if video_table and is_video and table != path and table.exists() else None
