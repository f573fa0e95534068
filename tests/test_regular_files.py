from __future__ import annotations

import os
from pathlib import Path

import pytest

from tacshade_edge.regular_files import named_file, read_regular


def test_a_regular_file_is_read_up_to_its_limit(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"1234")
    (tmp_path / "link").symlink_to("a")
    assert read_regular(tmp_path / "a", 4) == read_regular(tmp_path / "link", 4) == b"1234"
    with pytest.raises(OSError, match="found more than 3 bytes"):
        read_regular(tmp_path / "a", 3)


def test_what_can_hang_or_never_ends_is_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    before = len(os.listdir("/proc/self/fd"))
    for path, said in {
        tmp_path / "pipe": "found no regular file",
        Path("/dev/zero"): "found no regular file",
        tmp_path: "Is a directory",
        tmp_path / "none": "No such file",
        tmp_path / "nul\0": "embedded null",
    }.items():
        with pytest.raises(OSError, match=said):
            read_regular(path, 100)
    assert len(os.listdir("/proc/self/fd")) == before


def test_a_file_is_named_as_on_any_system(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    (tmp_path / "odd\\name").touch()
    assert named_file(tmp_path, "a/b.png") == tmp_path / "a/b.png"
    assert named_file(tmp_path, r"a\b.png") == tmp_path / "a/b.png"
    assert named_file(tmp_path, r"odd\name") == tmp_path / r"odd\name"
    assert named_file(tmp_path, "~/a.npz") == tmp_path / "home/a.npz"
    assert named_file(tmp_path, "~") == tmp_path / "home"
    assert named_file(tmp_path, "/a/b.png") == Path("/a/b.png")
