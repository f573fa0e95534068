"""What the page takes of a message, in Node.js: what cannot be shown is refused,
what is too much is cut.
"""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

from support.patience import patience
from support.published_sensor import calibration
from tacshade_edge.wire import messages

NODE = shutil.which("node")
pytestmark = [pytest.mark.node, pytest.mark.skipif(NODE is None, reason="Node.js is not installed")]
STATIC = Path(__file__).parents[2] / "tacshade_edge" / "dashboard" / "static"

# Reads lines of [name of a check, arguments]; NaN and infinities are written as {"f": "NaN"}.
HARNESS = """
import * as bounds from %s;
import { readFileSync } from "node:fs";
const revived = (_, value) => value?.f !== undefined ? Number(value.f) : value;
for (const line of readFileSync(0, "utf8").trimEnd().split("\\n")) {
  const [name, ...given] = JSON.parse(line, revived);
  let answer;
  try {
    const bytes = (one) => one?.bytes === undefined ? one : new TextEncoder().encode(one.bytes);
    answer = { value: bounds[name](...given.map(bytes)) };
  } catch (error) { answer = { error: error.message }; }
  console.log(JSON.stringify(answer));
}
"""


def answers(*calls: tuple[Any, ...]) -> list[dict[str, Any]]:
    assert NODE is not None
    code = HARNESS % json.dumps((STATIC / "bounds.js").as_uri())
    done = subprocess.run(
        (NODE, "--input-type=module", "-e", code),
        input="\n".join(map(json.dumps, calls)),
        capture_output=True,
        text=True,
        timeout=patience(30),
        check=False,
    )
    assert done.stderr == ""
    return [json.loads(line) for line in done.stdout.splitlines()]


def grid(**changed: Any) -> dict[str, Any]:
    return {
        "rows": 2,
        "cols": 2,
        "row0": 0,
        "col0": 0,
        "step_px": 4,
        "height_mm": [0, 1, 2, None],
    } | changed


def info(**changed: Any) -> dict[str, Any]:
    """As the daemon reports it, with another geometry."""
    reported = messages.encode_info(
        version="0",
        config_digest="0",
        profile="fast",
        calibration=calibration(),
        profiles=("fast",),
    )
    made: dict[str, Any] = json.loads(reported)
    made["geometry"].update(changed)
    return made


def finger(**changed: Any) -> dict[str, Any]:
    touched = {"shear_mm": [0.1, 0.2, 0], "depth_max_mm": 1, "area_mm2": 4, **changed}
    return {"fingers": {"thumb": {"state": "contact", "objects": [touched]}}}


def numbers(**values: Any) -> dict[str, Any]:
    return {
        "seq": 1,
        "touch": values,
        "touch_sigma": {name: None if v is None else 0.5 for name, v in values.items()},
    }


NAN, INFINITE = {"f": "NaN"}, {"f": "Infinity"}


def test_text_and_tables_are_cut_before_anything_is_drawn_of_them() -> None:
    long = {
        "reason": "x" * 200_000,
        **{f"k{k}": k for k in range(20_000)},
        "list": ["y" * 1000] * 500,
    }
    cut, nested, large, *others = answers(
        ("read", {"bytes": json.dumps(long)}),
        ("read", {"bytes": '{"a":' * 50 + "1" + "}" * 50}),
        ("read", {"bytes": json.dumps({"reason": "x" * (1 << 20)})}),
        *(("read", {"bytes": text}) for text in ("", "{", "null", "[]", "7", '"a"')),
    )
    assert cut["value"]["reason"] == "x" * 300 + " … (200000 characters)"
    assert len(cut["value"]) == 101
    assert cut["value"]["…"] == "19902 more"
    assert json.dumps(nested["value"]) == json.dumps({"a": {"a": {"a": {"a": {"a": {"a": "…"}}}}}})
    assert large == {"error": "the message is too large"}
    assert all(set(answer) == {"error"} for answer in others)


@pytest.mark.parametrize(
    ("check", "sound", "hostile"),
    [
        (
            "checkDecoded",
            [
                (grid(), "height_mm"),
                ({"points_mm": [1, 2, 3]}, "points_mm"),
                ({"points_mm": []}, "points_mm"),
            ],
            [
                *((grid(rows=value), "height_mm") for value in (0, 4097, NAN)),
                *((grid(step_px=value), "height_mm") for value in (0, 1e-30, NAN, INFINITE)),
                *((grid(col0=value), "height_mm") for value in (1e30, NAN)),
                (grid(height_mm=[0, 1e30]), "height_mm"),
                (grid(), "sigma_mm"),
                ({"points_mm": [NAN, 0, 0]}, "points_mm"),
            ],
        ),
        (
            "checkInfo",
            [
                (info(),),
                (info(camera_distance_mm=None, f_px=None),),
                ({"geometry": None},),
                ({},),
                (info(image_width_px=8192, image_height_px=2048, radius_px=4096),),
                (
                    info(
                        skin="pad",
                        visible_radius_mm=15,
                        skin_radius_mm=None,
                        visible_half_angle_deg=None,
                    ),
                ),
            ],
            [
                *((info(radius_px=value),) for value in (0, 1e308, "x", None)),
                *((info(skin_radius_mm=value),) for value in (0, 1e308, None)),
                *((info(skin="pad", visible_radius_mm=value),) for value in (0, None, "x")),
                (info(image_height_px=1e9),),
                (info(f_px=0),),
                ({"profiles": 5},),
                ({"profile": {}},),
                ({**info(), "hand_T_sensor": [1, 2, "x"]},),
                ({"geometry": 5},),
            ],
        ),
        (
            "checkContact",
            [({"contact": 1, "depth_max_mm": 1.5, "x_mm": None},), ({},)],
            [({"depth_max_mm": "a"},), ({"x_mm": {}},), ({"slip": []},)],
        ),
        (
            "checkTouch",
            [
                ({"seq": 1, "touch": None, "touch_sigma": None},),
                ({"seq": 1, "touch": {}, "touch_sigma": {}, "reason": "x"},),
                (numbers(depth_mm=1.5, tilt_x_deg=None),),
            ],
            [
                ({},),
                ({"seq": 1, "touch": 5, "touch_sigma": {}},),
                ({"seq": 1, "touch": {}, "touch_sigma": {}, "reason": {}},),
                ({"seq": 1, "touch": {"depth_mm": 1}, "touch_sigma": {}},),
                ({"seq": 1, "touch": {"depth_mm": 1}, "touch_sigma": {"depth_mm": -1}},),
                *((numbers(depth_mm=value),) for value in ("x", 1e7, NAN, INFINITE)),
                (numbers(**{"<b>": 1}),),
                (numbers(**{f"q{k}": 0 for k in range(33)}),),
            ],
        ),
        (
            "checkPart",
            [({"state": "streaming", "reason": "", "device": "x"},)],
            [
                ({},),
                ({"state": {}},),
                ({"state": "x", "reason": {}},),
                ({"state": "playing", "position_s": "x"},),
            ],
        ),
        (
            "checkHand",
            [(finger(),), (finger(shear_mm=None),), ({"fingers": {}},)],
            [
                (finger(shear_mm=5),),
                (finger(depth_max_mm="x"),),
                ({"fingers": {"../x#": {"state": "free", "objects": []}}},),
                ({"fingers": {f"f{k}": {"state": "free", "objects": []} for k in range(17)}},),
                ({"fingers": {"a": {"state": "free", "objects": 5}}},),
                (
                    {
                        "fingers": {
                            "a": {
                                "state": "contact",
                                "objects": [{"depth_max_mm": 1, "area_mm2": 1}] * 65,
                            }
                        }
                    },
                ),
            ],
        ),
    ],
)
def test_what_cannot_be_drawn_is_refused(check: str, sound: list[Any], hostile: list[Any]) -> None:
    given = answers(*((check, *one) for one in [*sound, *hostile]))
    assert [answer for answer in given[: len(sound)] if "error" in answer] == []
    assert [
        one
        for one, answer in zip(hostile, given[len(sound) :], strict=True)
        if "error" not in answer
    ] == []


def test_of_ten_thousand_objects_the_first_are_named() -> None:
    none, few, many = answers(
        ("objectsIn", []),
        ("objectsIn", [2, 1, 2, 10]),
        ("objectsIn", list(range(10_000, 0, -1))),
    )
    assert none["value"] == {"shown": [], "more": 0}
    assert few["value"] == {"shown": [1, 2, 10], "more": 0}
    assert many["value"] == {"shown": list(range(1, 65)), "more": 9936}
