"""The daemon in this process chooses its profile."""

from __future__ import annotations

import json
import logging
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import Any

import pytest
from support.running_app import (
    BASE,
    Running,
    ask,
    assert_accounted,
    document,
    last,
    paced,
    states,
)

from tacshade_edge.core.profiles import LADDER, PROFILES
from tacshade_edge.daemon import profiles as profile_chooser
from tacshade_edge.protocol import wire
from tacshade_edge.types import Calibration
from tools.testbed.mqtt_rig import MOSQUITTO, Broker, Subscriber
from tools.testbed.patience import wait_until

pytestmark = [pytest.mark.broker, pytest.mark.skipif(MOSQUITTO is None, reason="mosquitto is not installed")]


class Late:
    """A source whose frames are so many ms old when they come, as those of a machine that has other work."""

    def __init__(self, source: Any) -> None:
        self._source = source
        self.ms = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._source, name)

    def read(self) -> Any:
        frame = self._source.read()
        return frame and replace(frame, t_ns=frame.t_ns - self.ms * 1_000_000)


def test_auto_steps_down_under_a_load_and_up_after_it_and_says_so(
    tmp_path: Path,
    broker: Broker,
    seen: Subscriber,
    calibration: Calibration,
    pictures: Any,
    scripted: Any,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level(logging.INFO)
    monkeypatch.setattr(profile_chooser, "PATIENCE_S", 0.2)
    budget_ms = 1000  # of a test's machine, which has other work too
    settings = document(tmp_path, broker.port, f"profile: auto\nlatency_budget_ms: {budget_ms}\n")
    source = Late(scripted(paced(pictures.touched)))
    app = Running(settings, source, calibration)
    ladder = list(LADDER)

    def told_profiles() -> list[str]:
        return [json.loads(payload)["profile"] for payload in seen.of(f"{BASE}/info")]

    def budget() -> Any:
        return last(seen, "health").get("budget") or {}

    try:
        wait_until(lambda: budget().get("kept"), 20, "the budget is kept")
        info = last(seen, "info")
        assert (info["choice"], info["profile"], info["profiles"]) == ("auto", ladder[0], [*PROFILES, "auto"])
        assert budget()["p90_ms"] <= budget_ms == budget()["latency_budget_ms"]

        source.ms = 5 * budget_ms
        wait_until(lambda: told_profiles()[-1] == ladder[-1], 20, "stepped down")
        wait_until(lambda: budget().get("kept") is False, 20, "health says that it is not kept")
        assert (budget()["profile"], budget()["steps_down"], budget()["steps_up"]) == (ladder[-1], len(ladder) - 1, 0)
        assert budget()["p90_ms"] > budget_ms

        source.ms = 0
        wait_until(lambda: told_profiles()[-1] == ladder[0], 30, "stepped up")
        wait_until(lambda: budget().get("kept"), 20, "kept again")
        assert budget()["steps_up"] == len(ladder) - 1
        told = [profile for profile, _ in groupby(told_profiles())]
        assert told == ladder + ladder[-2::-1]
        assert all(json.loads(payload)["choice"] == "auto" for payload in seen.of(f"{BASE}/info"))

        assert ask(seen, "profile", profile="fast")["result"] == {"profile": "fast"}
        wait_until(lambda: last(seen, "info")["choice"] == "fast", 10, "auto is over")
        wait_until(lambda: last(seen, "health")["budget"] is None, 10, "and no budget told")
        assert ask(seen, "profile", profile="auto")["result"] == {"profile": ladder[0]}
        wait_until(lambda: last(seen, "info")["choice"] == "auto", 10, "auto again")
    finally:
        app.end()
    wait_until(lambda: states(seen)[-1:] == ["stopped"], 5, "stopped")
    assert_accounted(last(seen, "health")["frames"])
    heights = [wire.decode(payload).seq for payload in seen.of(f"{BASE}/height")]
    assert heights == sorted(set(heights))
    steps = [record for record in caplog.records if record.getMessage().startswith("profile auto: stepped from ")]
    assert len(steps) == 2 * (len(ladder) - 1)
    assert all(record.levelno == logging.INFO for record in steps)
