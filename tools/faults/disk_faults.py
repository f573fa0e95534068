"""Faults of disks and of files with state."""

from __future__ import annotations

import shutil
import time
from pathlib import Path

from tacshade_edge.errors import DecodeError
from tacshade_edge.storage.atomic_files import FREE_FLOOR_BYTES
from tacshade_edge.storage.recording.recording import Recording
from tacshade_edge.storage.stitching.stitch_file import PRESSES, SESSION
from tools.faults.rig import Cell, Seen, pause, small_disk
from tools.testbed.mcap_bytes import CHUNK, flipped, record_starts

FLOOR_MB = FREE_FLOOR_BYTES >> 20


def _fill(disk: Path, leave_mb: int) -> Path:
    """Fill the disk except `leave_mb`; return the file."""
    filler = disk / "filler"
    with filler.open("wb") as stream:
        for _ in range((shutil.disk_usage(disk).free >> 20) - leave_mb):
            stream.write(bytes(1 << 20))
    return filler


def full_while_recording(cell: Cell) -> Seen:
    """The disk of the recordings fills up."""
    disk = cell.enter(small_disk(cell.folder / "recs", FLOOR_MB + 40))
    cell.serve()
    cell.start()
    assert cell.ask("record", action="start", seconds=600, name="r")["ok"]
    cell.until(lambda: cell.last("status/recorder").get("frames", 0) > 20, 20, "a recording")
    since_s = cell.mark()
    filler = _fill(disk, FLOOR_MB - 5)
    cell.until(lambda: cell.last("status/recorder").get("state") == "stopped", 30, "the recording's end")
    detected_s = time.monotonic() - since_s
    status = cell.last("status/recorder")
    assert status["ending_code"] == "disk_full", status
    read = 0
    recording = Recording(disk / "r")
    while recording.read() is not None:
        read += 1
    assert read == status["frames"]
    cell.maps_again(time.monotonic())
    filler.unlink()
    since_s = time.monotonic()
    assert cell.ask("record", action="start", seconds=1, name="r2")["ok"]
    recovered_s = time.monotonic() - since_s
    lost = f"{status['dropped']} frames, counted; all {read} before are there"
    return Seen(detected_s, recovered_s, lost, "`status/recorder`, log")


def read_while_recording(cell: Cell) -> Seen:
    """Both kinds of recordings are read repeatedly from the beginning while the daemon writes them."""
    cell.serve()
    cell.start()
    reads = 0
    for name, more in (("r", {}), ("m", {"format": "mcap"})):
        assert cell.ask("record", action="start", seconds=600, name=name, **more)["ok"]
        cell.until(lambda: cell.last("status/recorder").get("frames", 0) > 30, 20, "a recording")
        path, most = cell.folder / "recs" / name, 0
        for _ in range(12):
            read, said = _frames_of(path / "000.mcap.part" if more else path)
            assert not said, said
            assert read >= most, (read, most)
            most, reads = read, reads + 1
            pause(0.2)
        assert most > 30, most
        assert cell.ask("record", action="stop")["ok"]
        cell.until(lambda: cell.last("status/recorder").get("state") != "recording", 20, "its end")
        status = cell.last("status/recorder")
        read, said = _frames_of(path / "000.mcap" if more else path)
        assert (read, said) == (status["frames"], []), (read, said, status)
        assert status["dropped"] == 0, status
        cell.mark()
    return Seen(None, None, f"nothing in {reads} readings; each has what was written until then", "")


def full_at_begin(cell: Cell) -> Seen:
    """The disk has no room for a session, then it has room for one with the same name."""
    disk = cell.enter(small_disk(cell.folder / "maps", FLOOR_MB + 20))
    cell.serve()
    cell.start()
    filler = _fill(disk, FLOOR_MB - 5)
    since_s = cell.mark()
    answer = cell.ask("stitch", action="begin", name="one")
    detected_s = time.monotonic() - since_s
    assert not answer["ok"], answer
    assert answer["reason_code"] == "disk_full", answer
    filler.unlink()
    since_s = time.monotonic()
    answer = cell.ask("stitch", action="begin", name="one")
    assert answer["ok"], answer
    return Seen(detected_s, time.monotonic() - since_s, "nothing", "the answer to BEGIN")


def full_in_a_session(cell: Cell) -> Seen:
    """The disk has no room for more presses, then it has room again."""
    disk = cell.enter(small_disk(cell.folder / "maps", FLOOR_MB + 20))
    cell.serve()
    cell.start()
    cell.session("one")
    filler = _fill(disk, FLOOR_MB - 5)
    since_s = cell.mark()
    detected_s = cell.told("did not add a settled contact", since_s)
    status = cell.ask("stitch", action="status")["result"]
    filler.unlink()
    since_s = time.monotonic()
    cell.until(lambda: cell.last("status/stitching").get("presses", 0) > status["presses"], 20, "one press more")
    recovered_s = time.monotonic() - since_s
    missed = cell.last("status/stitching")["missed"]
    return Seen(detected_s, recovered_s, f"{missed} presses, each refused", "log, `status/stitching.missed`")


def session_deleted(cell: Cell) -> Seen:
    """A user deletes the open session's folder."""
    cell.serve()
    cell.start()
    cell.session("one")
    since_s = cell.mark()
    shutil.rmtree(cell.folder / "maps/one")
    detected_s = cell.told("the session's files are gone", since_s)
    since_s = time.monotonic()
    answer = cell.ask("stitch", action="begin", name="two")
    assert answer["ok"], answer
    return Seen(detected_s, time.monotonic() - since_s, "what was deleted", "log, answers")


def flipped_in_mcap(cell: Cell) -> Seen:
    """Two bits flip in a recording whose daemon was killed: in its first chunk, and in a later chunk's length."""
    cell.serve()
    cell.start()
    assert cell.ask("record", action="start", seconds=600, name="r", format="mcap")["ok"]
    cell.until(lambda: cell.last("status/recorder").get("frames", 0) > 100, 30, "a recording")
    cell.kill()
    path = cell.folder / "recs/r/000.mcap"
    left = path.with_name("000.mcap.part")
    content = left.read_bytes()
    whole, _ = _frames_of(left)
    chunks = [begin for begin in record_starts(content)[:-1] if content[begin] == CHUNK]
    content = flipped(content, chunks[0] + 900, 3)
    left.write_bytes(flipped(content, chunks[len(chunks) // 2] + 3, 2))
    began_s = cell.mark()
    cell.start()
    detected_s = cell.told(
        "repaired a recording that a daemon left unfinished when it died; "
        "the file now ends after its last whole record",
        began_s,
    )
    read, told = _frames_of(path)
    each = -(-whole // len(chunks))
    assert 2 <= len(told) <= 4, told  # a chunk may end inside a frame, which is reported, too
    assert whole - 2 * each - 2 <= read < whole, (read, whole, len(chunks))
    lost = f"{whole - read} frames of {whole}, in the two chunks of {len(chunks)}"
    return Seen(detected_s, None, lost, "log; `replay` names the bytes, exit code 1")


def _frames_of(path: Path) -> tuple[int, list[str]]:
    """Count the readable frames, and collect the reports."""
    recording, read = Recording(path), 0
    told: list[str] = []
    while True:
        try:
            if recording.read() is None:
                return read, told
            read += 1
        except DecodeError as error:
            told.append(str(error))


def _after_a_stop(cell: Cell) -> int:
    cell.serve()
    cell.start()
    count = cell.session("one", 4)
    cell.kill()
    cell.mark()
    return count


def flipped_bit(cell: Cell) -> Seen:
    """A bit is flipped in a session's first press while no daemon runs."""
    count = _after_a_stop(cell)
    path = cell.folder / "maps/one" / PRESSES
    data = bytearray(path.read_bytes())
    data[200] ^= 4
    path.write_bytes(data)
    began_s = time.monotonic()
    cell.start()
    detected_s = cell.told("are damaged or incomplete", began_s)
    found = cell.presses(1)
    assert found >= count - 1, (found, count)
    assert path.with_name(f"{PRESSES}.damaged-1").read_bytes() == data
    recovered_s = time.monotonic() - began_s
    return Seen(detected_s, recovered_s, f"1 press of {count}; the file is kept beside", "log")


def cut_description(cell: Cell) -> Seen:
    """A session's description is cut short while no daemon runs."""
    _after_a_stop(cell)
    path = cell.folder / "maps/one" / SESSION
    path.write_bytes(path.read_bytes()[:40])
    began_s = time.monotonic()
    cell.start()
    detected_s = cell.told("skipping a session", began_s)
    assert cell.ask("stitch", action="begin", name="two")["ok"]
    assert (cell.folder / "maps/one" / PRESSES).stat().st_size > 0
    return Seen(detected_s, time.monotonic() - began_s, "the session is not resumed; its presses stay", "log")


FAULTS = {
    "disk full while recording": full_while_recording,
    "recordings read while they are written": read_while_recording,
    "disk full at BEGIN": full_at_begin,
    "disk full in a session": full_in_a_session,
    "an open session's folder deleted": session_deleted,
    "a bit flipped in a session's presses": flipped_bit,
    "two bits flipped in a recording as MCAP": flipped_in_mcap,
    "a session's description cut": cut_description,
}
