from __future__ import annotations

import subprocess
import sys

import pytest

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


@pytest.mark.parametrize(("first", "more"), [("share_free_memory()", False), ("", True)], ids=["shared", "by itself"])
def test_threads_allocate_from_one_heap(first: str, more: bool) -> None:
    words = (sys.executable, "-c", SCRIPT.format(first=first))
    done = subprocess.run(words, capture_output=True, text=True, check=True, timeout=60)
    assert (int(done.stdout) > 0) is more
