"""How many files one more of each kind takes: each is added to a copy of the program, where it must
work, and where the tests that look after its kind must pass. Who uses a setting or a number is not
counted: that is what it is for.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from support.painted_sensor import painted_calibration
from support.patience import patience
from tacshade_edge.calibration.files.calibration_file import packed
from tacshade_edge.robot.line import seal
from tools.ci.house import names_twice, strangers

ROOT = Path(__file__).parents[2]
ADDITIONS = Path(__file__).parent / "additions"
COPIED = ("client", "config", "docs", "support", "tacshade_edge", "tests", "tools")
"""Folders with what a program, or a test that looks after a kind, reads."""
PYTEST = (sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-m", "not slow and not node")


@dataclass(frozen=True)
class Addition:
    """One more of a kind: the text that is added before a text of a file, by file, new files with
    the file that they are, and the tests that look after the kind.
    """

    before: dict[str, tuple[tuple[str, str], ...]]
    tests: tuple[str, ...]
    new: dict[str, str] = field(default_factory=dict)
    then: dict[str, Callable[[str], str]] = field(default_factory=dict)


def help_line(text: str) -> str:
    """The page with the answer to ``help`` that names one verb more."""
    (old,) = re.findall(r"^< (OK - HELLO .*)\*", text, re.MULTILINE)
    new = seal(old.replace(" HELP;", " HELP RATE;")).decode().strip()
    return re.sub(r"^< OK - HELLO .*$", f"< {new}", text, flags=re.MULTILINE)


TOPIC = Addition(
    before={
        "tacshade_edge/wire/sensor_topics.py": (
            (
                "OF_JSON: Final",
                "@dataclass(frozen=True, slots=True, kw_only=True)\nclass Strength:\n"
                '    """``strength``: the greatest depth of a frame in contact."""\n\n'
                "    seq: Count\n    strength: Rate\n\n\n",
            ),
            ('    "contact": Contact,', '    "strength": Strength,\n'),
            ('"contact", "touch", "map/revision"}', '"strength", '),
        ),
        "tacshade_edge/mqtt/publishing.py": (
            ("\nfrom tacshade_edge.wire.stamped_jpeg", ", Strength"),
            ('    "cloud": Need.DEPTH,', '    "strength": Need.DEPTH,\n'),
            (
                "        touch_ended = (",
                '        if result.contact and self.has_listener("strength"):\n'
                "            strength = Strength(seq=result.seq, strength=result.depth_max_mm)\n"
                '            payloads.append(("strength", encode_json(strength)))\n',
            ),
        ),
        "docs/reference/mqtt.md": (
            ("| [`touch`]", "| `strength` | flat JSON: the greatest depth | 0 or 1, no |\n"),
        ),
    },
    tests=("tests/docs/test_mqtt_doc.py", "tests/wire/test_topics.py"),
)
CAMERA = Addition(
    before={
        "tacshade_edge/camera/sources.py": (
            (
                "from tacshade_edge.camera.usb_camera",
                "from tacshade_edge.camera.still_camera import Still\n",
            ),
            ("V4l2 | Rpicam | Files", "Still | "),
        )
    },
    new={"tacshade_edge/camera/still_camera.py": "still_camera.py"},
    tests=("tests/settings/test_load.py",),
)
VERB = Addition(
    before={
        "tacshade_edge/robot/verbs.py": (
            (
                "@dataclass(frozen=True, slots=True)\nclass SerialVerb",
                "class FrameRate(CommandResult, frozen=True):\n"
                '    """Result of ``RATE``."""\n\n    rate: float\n\n\n'
                "def _rate(command: Command, desk: Desk, _: LinkCounts) -> CommandResult:\n"
                '    hz = desk.sensor_state()["health"]["delivered_fps"]\n'
                '    return FrameRate(hz if command.args[0] == "HZ" else round(1e3 / hz, 3))\n\n\n',
            ),
            (
                "}\nUSAGE: Final",
                '    "RATE": SerialVerb("HZ|MS", 1, 1, words=("HZ", "MS"), start=_rate, '
                "needs_calibration=False),\n",
            ),
        ),
        "docs/reference/serial.md": (
            ("\nWithout a [calibration]", "| `RATE HZ\\|MS` | returns the camera's `rate` |\n"),
        ),
    },
    then={"docs/reference/serial.md": help_line},
    tests=(
        "tests/docs/test_serial_doc.py::test_every_verb_and_every_counter_has_its_row",
        "tests/docs/test_serial_doc.py::test_what_is_typed_by_hand_is_answered_so",
        "tests/robot/test_verbs.py",
        "tests/robot/test_serial_link.py::test_a_person_types",
    ),
)
SETTING = Addition(
    before={
        "tacshade_edge/settings/model.py": (
            (
                "    hand_id: (",
                "    touch_log: (\n        Annotated[\n            str,\n            Meta("
                'min_length=1, description="a table of touches", extra=PATH | RESTART),\n'
                "        ]\n        | None\n    ) = None\n",
            ),
            (
                "        budget_ms = self",
                '        if self.touch_log and not self.touch_log.endswith(".csv"):\n'
                '            text = f"found {self.touch_log}, expected a name that ends in .csv"\n'
                '            return ("touch_log",), text\n',
            ),
        ),
        "config/default.yaml": (
            ("# Only if several sensors", "# A table of touches.\ntouch_log: null\n\n"),
        ),
    },
    tests=("tests/settings/test_load.py",),
)
NUMBER = Addition(
    before={
        "tacshade_edge/types/calibration.py": (
            (
                "    fit: Fit | None = None",
                "    # Mean of the references.\n"
                "    skin_grey: Annotated[float, Meta(ge=0, le=255)] = 0.0\n",
            ),
        ),
        "tacshade_edge/calibration/calibrate.py": (
            ("        alpha=sensor.alpha,", "        skin_grey=float(mean.mean()),\n"),
        ),
    },
    tests=("tests/calibration/files/test_calibration_file.py",),
)


ADDED = {"topic": TOPIC, "camera": CAMERA, "verb": VERB, "setting": SETTING, "number": NUMBER}


def put(tree: Path, addition: Addition) -> None:
    for name, additions in addition.before.items():
        text = (tree / name).read_text()
        for place, added in additions:
            assert text.count(place) == 1, (name, place)
            text = text.replace(place, added + place)
        (tree / name).write_text(addition.then.get(name, str)(text))
    for name, source in addition.new.items():
        shutil.copy(ADDITIONS / source, tree / name)


def touched(tree: Path) -> set[str]:
    """The files of the copy that are not as they were."""
    files = [path.relative_to(tree) for path in tree.rglob("*") if path.is_file()]
    return {
        path.as_posix()
        for path in files
        if not (ROOT / path).exists() or (ROOT / path).read_bytes() != (tree / path).read_bytes()
    }


@pytest.mark.parametrize(
    ("kind", "places"),
    [("topic", 3), ("camera", 2), ("verb", 2), ("setting", 2), ("number", 2)],
)
def test_one_more_takes_so_many_files(kind: str, places: int, tmp_path: Path) -> None:
    addition = ADDED[kind]
    for name in (*addition.before, *addition.new):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        if name in addition.before:
            shutil.copy(ROOT / name, tmp_path / name)
    put(tmp_path, addition)
    assert len(touched(tmp_path)) == places


@pytest.mark.slow
def test_one_more_of_each_works_in_no_more_files(tmp_path: Path) -> None:
    ignored = shutil.ignore_patterns("__pycache__", "results", "golden")
    for name in COPIED:
        shutil.copytree(ROOT / name, tmp_path / name, ignore=ignored)
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    for addition in ADDED.values():
        put(tmp_path, addition)
    assert touched(tmp_path) == {
        name for addition in ADDED.values() for name in (*addition.before, *addition.new)
    }
    assert strangers(tmp_path) == names_twice(tmp_path) == []
    older = painted_calibration()
    (tmp_path / "tests" / f"older-{older.crc32:08x}.npz").write_bytes(packed(older))
    checks = [f"tests/tools/additions/check_{kind}.py" for kind in ADDED]
    consistency = {test for addition in ADDED.values() for test in addition.tests}
    done = subprocess.run(
        [*PYTEST, *checks, *sorted(consistency)],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=patience(300),
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
