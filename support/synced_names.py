"""Which folders' names were changed and then synced; the real calls happen."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest

Calls = list[tuple[str, Path]]


def synced(monkeypatch: pytest.MonkeyPatch) -> Calls:
    """Note each ``os.replace`` with the folder of its target, and each ``os.fsync``."""
    calls: Calls = []
    replace, fsync = os.replace, os.fsync

    def replaced(source: Any, target: Any) -> None:
        replace(source, target)
        calls.append(("replace", Path(target).parent))

    def waited(descriptor: int) -> None:
        fsync(descriptor)
        calls.append(("fsync", Path(os.readlink(f"/proc/self/fd/{descriptor}"))))

    monkeypatch.setattr(os, "replace", replaced)
    monkeypatch.setattr(os, "fsync", waited)
    return calls


def unsynced(calls: Calls) -> list[Path]:
    """The folders with a name that was changed after their last sync."""
    latest = {folder: call for call, folder in calls}
    return [folder for folder, call in latest.items() if call == "replace"]
