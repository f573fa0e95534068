from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tacshade_edge.doctor.disk import check_disk, check_wear, judge


@pytest.mark.parametrize(
    ("free_bytes", "read_only", "state", "said"),
    [
        (5_000_000_000, False, "ok", "5.0 GB free"),
        (400_000_000, False, "warning", "0.4 GB free; recordings will soon fill the disk"),
        (1_000_000, False, "fault", "too little"),
        (5_000_000_000, True, "fault", "read-only"),
    ],
)
def test_judged(free_bytes: int, read_only: bool, state: str, said: str) -> None:
    (finding,) = judge(Path("/var/lib/x"), free_bytes, read_only)
    assert finding.state == state
    assert "/var/lib/x" in finding.found
    assert said in finding.found


def test_a_folder_that_is_not_there_yet(machine: Any, tmp_path: Path) -> None:
    (finding, *_) = check_disk(tmp_path / "a/b/c", machine)
    assert finding.check == "disk"
    assert str(tmp_path / "a/b/c") in finding.found


@pytest.mark.skipif(not Path("/sys/kernel").is_dir(), reason="needs sysfs")
def test_a_file_system_without_room_is_a_fault(machine: Any) -> None:
    (finding, *_) = check_disk(Path("/sys/kernel"), machine)
    assert finding.state == "fault", "sysfs has no free byte; in a container it is read-only too"


def test_a_worn_card(machine: Any) -> None:
    machine.put("/sys/block/mmcblk0/device/life_time", "0x02 0x0a\n")
    machine.put("/sys/block/mmcblk1/device/life_time", "0x01 0x02\n")
    machine.put("/sys/block/mmcblk2/device/type", "SD\n")
    (finding,) = check_wear(machine)
    assert finding.state == "warning"
    assert finding.found == "mmcblk0 has used at least 90 % of its life"
