from __future__ import annotations

import math
import os
import subprocess
import sys
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacshade_edge.quoting import counted, escaped, quoted, shown
from tacshade_edge.regular_files import named_file, read_regular
from tacshade_edge.rigid import from_seven, turn, turned_rad
from tacshade_edge.types import Need

SCRIPT = """
import ctypes, threading
from pathlib import Path
from tacshade_edge.free_memory import share_free_memory

libc = ctypes.CDLL(None)
libc.malloc.restype = ctypes.c_void_p

def heaps():  # of glibc's, each but the first reserves 64 MB
    sizes = []
    for line in Path("/proc/self/maps").read_text().splitlines():
        begin, end = (int(at, 16) for at in line.split()[0].split("-"))
        sizes.append((begin % (1 << 26) == 0, end - begin))
    return sum(aligned and size < 1 << 26 for aligned, size in sizes)

{first}
before, ends = heaps(), threading.Barrier(5)

def work():
    assert libc.malloc(1000)
    ends.wait()
    ends.wait()

threads = [threading.Thread(target=work) for _ in range(4)]
for thread in threads:
    thread.start()
ends.wait()
print(heaps() - before)
ends.wait()
for thread in threads:
    thread.join()
"""


@pytest.mark.parametrize(
    ("first", "more"), [("share_free_memory()", False), ("", True)], ids=["shared", "by itself"]
)
def test_threads_allocate_from_one_heap(first: str, more: bool) -> None:
    words = (sys.executable, "-c", SCRIPT.format(first=first))
    done = subprocess.run(words, capture_output=True, text=True, check=True, timeout=60)
    assert (int(done.stdout) > 0) is more


def test_every_bit_of_a_need_has_a_name() -> None:
    """Python 3.11.2 (Debian 12) drops bits without a name from a union:
    a subscriber to shear and sigma got neither.
    """
    named = {need.value for need in Need.__members__.values()}
    assert {1 << k for k in range(Need.ALL.value.bit_length())} <= named


def test_a_union_has_all_that_it_is_of() -> None:
    for one, other in combinations((Need.DEPTH, Need.SHEAR, Need.SIGMA, Need.TOUCH), 2):
        assert one in one | other
        assert other in one | other
        assert Need.DEPTH in one | other
    assert Need.SHEAR in Need.TOUCH
    assert Need.SIGMA not in Need.TOUCH


@given(st.text(max_size=60), st.integers(1, 50))
def test_it_is_one_printable_line_of_bounded_length(text: str, most: int) -> None:
    for line in (quoted(text, most), shown(text, most), escaped(text, most)):
        assert line.isprintable()
        assert len(line) <= 10 * most + 3  # \\U0001f600
    assert escaped(text, most) == text or not text.isprintable() or len(text) > most


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


numbers = st.floats(-1, 1)
poses = st.tuples(*[st.floats(-500, 500)] * 3, *[numbers] * 4).filter(
    lambda v: math.hypot(*v[3:]) > 0.1
)


@given(poses)
def test_seven_numbers_come_back(values: tuple[float, ...]) -> None:
    pose = from_seven(values)
    again = from_seven(pose.seven())
    np.testing.assert_allclose(again.rotation, pose.rotation, atol=1e-12)
    np.testing.assert_allclose(again.translation_mm, values[:3], atol=1e-12)
    assert math.hypot(*pose.seven()[3:]) == pytest.approx(1)
    assert pose.seven()[3] >= 0


@given(poses, poses)
def test_composition_applies_the_inner_one_first(
    a: tuple[float, ...], b: tuple[float, ...]
) -> None:
    outer, inner = from_seven(a), from_seven(b)
    points = np.array(((0.0, 0.0, 20.0), (3.0, -4.0, 5.0)))
    np.testing.assert_allclose(
        (outer @ inner).apply(points), outer.apply(inner.apply(points)), atol=1e-9
    )
    np.testing.assert_allclose(outer.inverse().apply(outer.apply(points)), points, atol=1e-9)


@given(st.tuples(numbers, numbers, numbers), st.floats(0, math.pi - 1e-3))
def test_a_turn_gives_its_vector_back(axis: tuple[float, float, float], angle: float) -> None:
    size = math.hypot(*axis)
    vector = np.array(axis) * (angle / size if size > 1e-3 else 0.0)
    np.testing.assert_allclose(turned_rad(turn(vector).rotation), vector, atol=1e-9)


def test_a_noun_agrees_with_its_number() -> None:
    assert [counted(k, "frame") for k in (0, 1, 2)] == ["0 frames", "1 frame", "2 frames"]
    assert [counted(k, "press") for k in (1, 2)] == ["1 press", "2 presses"]
    assert [counted(k, "touch") for k in (1, 2)] == ["1 touch", "2 touches"]
