from __future__ import annotations

from typing import Any

import pytest

from tacshade_edge.doctor.board import check_board

THROTTLED = "/sys/devices/platform/soc/soc:firmware/get_throttled"
CPU = "/sys/devices/system/cpu/cpu0/cpufreq"


def test_nothing_to_say_of_a_machine_that_tells_nothing(machine: Any) -> None:
    assert check_board(machine) == ()


@pytest.mark.parametrize(
    ("flags", "found"),
    [
        ("0", ["power and temperature have been fine since boot"]),
        (
            "50000",
            ["under-voltage at some time since boot, but not now", "slowed down at some time since boot, but not now"],
        ),
        (
            "50001",
            ["under-voltage now; frames will be late or lost", "slowed down at some time since boot, but not now"],
        ),
        ("80008", ["slowed down now; frames will be late or lost"]),
    ],
)
def test_a_raspberry_pis_power(machine: Any, flags: str, found: list[str]) -> None:
    machine.put(THROTTLED, f"{flags}\n")
    assert [finding.found for finding in check_board(machine)] == found


@pytest.mark.parametrize(
    ("governor", "driver", "warned"),
    [("powersave", "cpufreq-dt", 1), ("ondemand", "cpufreq-dt", 0), ("powersave", "intel_pstate", 0)],
)
def test_the_governor(machine: Any, governor: str, driver: str, warned: int) -> None:
    machine.put(f"{CPU}/scaling_governor", governor)
    machine.put(f"{CPU}/scaling_driver", driver)
    findings = check_board(machine)
    assert len(findings) == warned
    assert all("scaling_governor" in finding.fix for finding in findings)
