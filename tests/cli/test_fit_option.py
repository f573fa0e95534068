"""A fit's steps stay until its result is on the disk, whatever becomes of the command."""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from tacshade_edge.cli.shared.fit_option import kept_until_written
from tacshade_edge.errors import DeviceError
from tacshade_edge.files.atomic_files import write_whole

STEPS = {"fit-0-frames-0.npz": b"frames", "fit-0-fast.npz": b"weights"}
pytestmark = [
    pytest.mark.fit,
    pytest.mark.skipif(
        find_spec("torch") is None, reason="PyTorch (the extra fit) is not installed"
    ),
]


@pytest.fixture
def out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A result whose fit writes two steps, says that it is done, and removes them."""

    def fit(_: object, __: object, say: Callable[[str], None], *given: Any, **___: object) -> str:
        folder: Path = given[1]
        folder.mkdir(exist_ok=True)
        (folder / "fit-0-damaged.npz").write_bytes(b"")
        say("fit: simulating")
        (folder / "fit-0-damaged.npz").unlink()
        for name, data in STEPS.items():
            write_whole(folder / name, data)
        say("fit: training, 100 % done")
        for name in STEPS:
            (folder / name).unlink()
        return "fitted"

    monkeypatch.setattr("tacshade_edge.lab.fitting.fit.fit", fit)
    return tmp_path / "cal.npz"


def run(kept: Any) -> None:
    known: Any = SimpleNamespace(calibration=None, presses=(), print_mm={})
    assert kept.run(known, known, ()) == "fitted"


def run_and_raise(out: Path, error: BaseException) -> None:
    with kept_until_written(out) as kept:
        run(kept)
        raise error


def steps(out: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in out.with_name("cal.npz.fit").iterdir()}


def test_steps_are_removed_once_the_result_is_written(out: Path) -> None:
    with kept_until_written(out) as kept:
        run(kept)
        out.touch()
    assert list(out.parent.iterdir()) == [out]


def test_a_result_that_cannot_be_written_leaves_the_steps(out: Path) -> None:
    again = "no space; the trained networks are kept; to write them, run the same command again"
    with pytest.raises(DeviceError, match=again):
        run_and_raise(out, DeviceError("no space"))
    assert steps(out) == STEPS
    with pytest.raises(KeyboardInterrupt):
        run_and_raise(out, KeyboardInterrupt())
    assert steps(out) == STEPS


def test_a_command_that_is_killed_before_it_writes_leaves_the_steps(out: Path) -> None:
    killed = kept_until_written(out)
    run(killed.__enter__())
    with kept_until_written(out) as kept:
        assert steps(out) == STEPS
        run(kept)
    assert not list(out.parent.iterdir())
    del killed


def test_a_fit_that_fails_keeps_what_is_its_own(out: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fit(_: object, __: object, say: Callable[[str], None], *given: Any, **___: object) -> str:
        given[1].mkdir()
        for name, data in STEPS.items():
            (given[1] / name).write_bytes(data)
        say("fit: simulating")
        (given[1] / "fit-0-fast.npz").unlink()  # damaged
        raise DeviceError("the system killed a worker process")

    monkeypatch.setattr("tacshade_edge.lab.fitting.fit.fit", fit)
    with (
        pytest.raises(DeviceError, match=r"^the system killed a worker process$"),
        kept_until_written(out) as kept,
    ):
        run(kept)
    assert steps(out) == {"fit-0-frames-0.npz": b"frames"}


def test_without_a_second_name_a_fit_still_ends(out: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def link(*_: object) -> None:
        raise PermissionError

    monkeypatch.setattr("os.link", link)
    with kept_until_written(out) as kept:
        run(kept)
    assert not list(out.parent.iterdir())
