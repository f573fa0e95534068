"""Faults of disks and of files with state."""

from __future__ import annotations

import shutil
import struct
import time
from pathlib import Path

from tacshade_edge.storage.atomic_files import FREE_FLOOR_BYTES
from tacshade_edge.storage.stitching.stitch_file import PRESSES, SESSION
from tools.faults.rig import Cell, Seen, fault, frames_of, pause, small_disk

FLOOR_MB = FREE_FLOOR_BYTES >> 20
MCAP_MAGIC_BYTES, MCAP_CHUNK = 8, 6


def _fill(disk: Path) -> Path:
    """Fill the disk to below the daemon's floor; return the file that does."""
    filler = disk / "filler"
    with filler.open("wb") as stream:
        for _ in range((shutil.disk_usage(disk).free >> 20) - FLOOR_MB + 5):
            stream.write(bytes(1 << 20))
    return filler


def _begun(cell: Cell, name: str) -> float:
    """Begin a session; return the seconds that this took."""
    since_s = time.monotonic()
    answer = cell.ask("stitch", action="begin", name=name)
    assert answer["ok"], answer
    return time.monotonic() - since_s


@fault("disk full while recording")
def full_while_recording(cell: Cell) -> Seen:
    disk = cell.enter(small_disk(cell.folder / "recs", FLOOR_MB + 40))
    cell.start()
    cell.record(frames=20)
    since_s = cell.mark()
    filler = _fill(disk)
    cell.until(lambda: cell.last("status/recorder").get("state") == "stopped", 30, "the recording's end")
    detected_s = time.monotonic() - since_s
    status = cell.last("status/recorder")
    assert status["ending_code"] == "disk_full", status
    read = len(frames_of(disk / "r")[0])
    assert read == status["frames"]
    cell.maps_again()
    filler.unlink()
    since_s = time.monotonic()
    assert cell.ask("record", action="start", seconds=1, name="r2")["ok"]
    lost = f"{status['dropped']} frames, counted; all {read} before are there"
    return Seen(lost, "`status/recorder`, log", detected_s, time.monotonic() - since_s)


@fault("recordings read while they are written")
def read_while_recording(cell: Cell) -> Seen:
    """Both kinds are read repeatedly from the beginning."""
    cell.start()
    reads = 0
    for name, kind in (("r", "folder"), ("m", "mcap")):
        cell.record(name, format=kind)
        path, most = cell.folder / "recs" / name, 0
        for _ in range(12):
            stamps_ns, told = frames_of(path / "000.mcap.part" if kind == "mcap" else path)
            assert not told, told
            assert len(stamps_ns) >= most, (len(stamps_ns), most)
            most, reads = len(stamps_ns), reads + 1
            pause(0.2)
        assert most > 30, most
        assert cell.ask("record", action="stop")["ok"]
        cell.until(lambda: cell.last("status/recorder").get("state") != "recording", 20, "its end")
        status = cell.last("status/recorder")
        stamps_ns, told = frames_of(path / "000.mcap" if kind == "mcap" else path)
        assert (len(stamps_ns), told, status["dropped"]) == (status["frames"], [], 0), (told, status)
        cell.mark()
    return Seen(f"nothing in {reads} readings; each has what was written until then", "")


@fault("disk full at BEGIN")
def full_at_begin(cell: Cell) -> Seen:
    disk = cell.enter(small_disk(cell.folder / "maps", FLOOR_MB + 20))
    cell.start()
    filler = _fill(disk)
    since_s = cell.mark()
    answer = cell.ask("stitch", action="begin", name="one")
    detected_s = time.monotonic() - since_s
    assert answer.get("reason_code") == "disk_full", answer
    filler.unlink()
    return Seen("nothing", "the answer to BEGIN", detected_s, _begun(cell, "one"))


@fault("disk full in a session")
def full_in_a_session(cell: Cell) -> Seen:
    disk = cell.enter(small_disk(cell.folder / "maps", FLOOR_MB + 20))
    cell.start()
    cell.session()
    filler = _fill(disk)
    detected_s = cell.told("did not add a settled contact", cell.mark())
    presses = cell.ask("stitch", action="status")["result"]["presses"]
    filler.unlink()
    since_s = time.monotonic()
    cell.presses(presses + 1)
    missed = cell.last("status/stitching")["missed"]
    told = "log, `status/stitching.missed`"
    return Seen(f"{missed} presses, each refused", told, detected_s, time.monotonic() - since_s)


@fault("a bit flipped in a session's presses")
def flipped_bit(cell: Cell) -> Seen:
    """The bit is in the first press; no daemon runs meanwhile."""
    cell.start()
    count = cell.session(count=4)
    cell.kill()
    path = cell.folder / "maps/one" / PRESSES
    content = bytearray(path.read_bytes())
    content[200] ^= 4
    path.write_bytes(content)
    cell.mark()
    began_s = cell.start()
    detected_s = cell.told("are damaged or incomplete", began_s)
    found = cell.presses(1)
    assert found >= count - 1, (found, count)
    assert path.with_name(f"{PRESSES}.damaged-1").read_bytes() == content
    return Seen(f"1 press of {count}; the file is kept beside", "log", detected_s, time.monotonic() - began_s)


@fault("two bits flipped in a recording as MCAP")
def flipped_in_mcap(cell: Cell) -> Seen:
    """The bits are in the first chunk and in a later chunk's length; the daemon was killed before."""
    cell.start()
    cell.record(frames=100, format="mcap")
    cell.kill()
    path = cell.folder / "recs/r/000.mcap"
    left = path.with_name("000.mcap.part")
    content = bytearray(left.read_bytes())
    whole = len(frames_of(left)[0])
    chunks, at = list[int](), MCAP_MAGIC_BYTES
    while at + 9 <= len(content):
        kind, size = struct.unpack_from("<BQ", content, at)
        if kind == MCAP_CHUNK and at + 9 + size < len(content):
            chunks.append(at)
        at += 9 + size
    content[chunks[0] + 900] ^= 8
    content[chunks[len(chunks) // 2] + 3] ^= 4
    left.write_bytes(content)
    cell.mark()
    detected_s = cell.told("repaired a recording that a daemon left unfinished when it died", cell.start())
    stamps_ns, told = frames_of(path)
    read, each = len(stamps_ns), -(-whole // len(chunks))
    assert 2 <= len(told) <= 4, told  # a chunk may end inside a frame, which is reported, too
    assert whole - 2 * each - 2 <= read < whole, (read, whole, len(chunks))
    lost = f"{whole - read} frames of {whole}, in the two chunks of {len(chunks)}"
    return Seen(lost, "log; `replay` names the bytes, exit code 1", detected_s)


@fault("a session's description cut")
def cut_description(cell: Cell) -> Seen:
    """No daemon runs meanwhile."""
    cell.start()
    cell.session(count=4)
    cell.kill()
    path = cell.folder / "maps/one" / SESSION
    path.write_bytes(path.read_bytes()[:40])
    cell.mark()
    began_s = cell.start()
    detected_s = cell.told("skipping a session", began_s)
    _begun(cell, "two")
    assert (cell.folder / "maps/one" / PRESSES).stat().st_size > 0
    lost = "the session is not resumed; its presses stay"
    return Seen(lost, "log", detected_s, time.monotonic() - began_s)
