"""Which messages of a frame the page puts together, in Node.js, beyond 32 bits of its number."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

from support.patience import patience
from support.published_sensor import bump
from tacshade_edge.wire import binary, messages

NODE = shutil.which("node")
pytestmark = [pytest.mark.node, pytest.mark.skipif(NODE is None, reason="Node.js is not installed")]
STATIC = Path(__file__).parents[2] / "tacshade_edge" / "dashboard" / "static"

# Reads pairs of a frame whose map is shown, and of one whose cloud and numbers come next: [height,
# cloud, contact], bytes as hex; prints whether the cloud waits, and whether numbers are shown.
HARNESS = """
import { keepContact, contactOfMap, partOfMap } from %s;
import { decode } from %s;
import { readFileSync } from "node:fs";
const bytes = (hex) => Uint8Array.from(Buffer.from(hex, "hex"));
const found = JSON.parse(readFileSync(0, "utf8")).map(([[height, , text], [, cloud]]) => {
  const view = { contacts: new Map(), with_map: {}, map: null, contact: null, shown_ms: 0 };
  keepContact(view, JSON.parse(text));
  view.map = decode(bytes(height));
  view.cloud = bytes(cloud);
  partOfMap(view, "cloud", decode);
  return [view.cloud !== null, contactOfMap(view)?.depth_max_mm ?? null];
});
console.log(JSON.stringify(found));
"""


def sent(seq: int) -> tuple[str, str, str]:
    result = bump(seq, 2.0, 236.0, 328.0, step_px=8)
    return (
        binary.encode_height(result, calibration_crc32=1).hex(),
        binary.encode_cloud(result, calibration_crc32=1).hex(),
        messages.encode_contact(result, fps=60.0).decode(),
    )


def shown(*pairs: tuple[int, int]) -> Any:
    assert NODE is not None
    modules = (json.dumps((STATIC / name).as_uri()) for name in ("newest.js", "wire.js"))
    done = subprocess.run(
        (NODE, "--input-type=module", "-e", HARNESS % tuple(modules)),
        input=json.dumps([[sent(seq) for seq in pair] for pair in pairs]),
        capture_output=True,
        text=True,
        timeout=patience(30),
        check=False,
    )
    assert done.stderr == ""
    return json.loads(done.stdout)


def test_numbers_are_those_of_the_shown_map_and_a_later_cloud_waits_for_its_own() -> None:
    found = shown((7, 8), (7, 6), (2**32 + 5, 2**32 + 6), (2**32 - 1, 2**32), (2**32, 2**32 - 1))
    assert found == [[True, 2.0], [False, 2.0], [True, 2.0], [True, 2.0], [False, 2.0]]
