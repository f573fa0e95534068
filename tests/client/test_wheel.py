"""The wheel alone, beside NumPy, msgspec and paho-mqtt only, listens to a daemon on the simulated sensor."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import venv
import zipfile
from email import message_from_bytes
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from support.calibrated_sensor import FULL, calibrated

from tacshade_edge.storage.calibration import calibration_file
from tools.release.version import version
from tools.testbed.mqtt_rig import MOSQUITTO, Broker
from tools.testbed.patience import patience

ROOT = Path(__file__).parents[2]
BYTES_MAX = 60_000
LISTEN = """
import json, sys
import numpy as np
from tacshade_client import listen, skin_mm

geometry, found = None, {}
with listen(sys.argv[1], "left-index", ["info", "height", "shear", "contact", "touch", "health", "state"]) as messages:
    for message in messages:
        if message.part == "info":
            geometry = message.value.geometry
        elif message.part == "height" and message.value.contact and geometry is not None:
            points_mm = skin_mm(message.value, geometry)
            found["radius_mm"] = float(np.nanmax(np.linalg.norm(points_mm, axis=-1)))
        found.setdefault(message.part, 0)
        found[message.part] += 1
        if len(found) >= 8 and messages.refused == 0:
            break
print(json.dumps(found | {"modules": sorted({name.partition(".")[0] for name in sys.modules})}))
"""
pytestmark = [
    pytest.mark.slow,
    pytest.mark.broker,
    pytest.mark.skipif(MOSQUITTO is None, reason="mosquitto is not installed"),
    pytest.mark.skipif(find_spec("hatchling") is None, reason="hatchling is not installed"),
    pytest.mark.skipif(find_spec("pip") is None, reason="pip is not installed"),
]


def built(tree: Path, folder: Path) -> Path:
    words = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(words, cwd=tree, check=True, capture_output=True, timeout=patience(120))
    (made,) = folder.iterdir()
    return made


def test_it_is_small_and_owns_no_file_of_the_daemons_wheel(tmp_path: Path) -> None:
    wheel = built(ROOT / "client", tmp_path / "client")
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        about = message_from_bytes(archive.read(next(name for name in names if name.endswith("/METADATA"))))
        assert not any(b"tacshade_edge" in archive.read(name) for name in names if name.endswith(".py"))
    print(f"{wheel.name}: {wheel.stat().st_size} bytes")
    assert wheel.stat().st_size < BYTES_MAX
    assert {name.partition("/")[0].partition("-")[0] for name in names} == {"tacshade_client"}
    assert {"tacshade_client/py.typed", "tacshade_client/protocol/wire_format.py"} <= set(names)
    assert (about["Version"], about["License-Expression"]) == (version(), "MIT")
    needs = [re.split("[<>]", need)[0] for need in about.get_all("Requires-Dist", [])]
    assert needs == ["msgspec", "numpy", "paho-mqtt"]


def test_the_camera_for_lerobot_has_the_name_that_lerobot_looks_for(tmp_path: Path) -> None:
    wheel = built(ROOT / "client_lerobot", tmp_path / "made")
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        about = message_from_bytes(archive.read(next(name for name in names if name.endswith("/METADATA"))))
    assert (about["Name"], about["License-Expression"]) == ("lerobot_camera_tacshade", "MIT")
    assert about.get_all("Requires-Dist") == ["tacshade-client"]
    assert {name.partition("/")[0].partition("-")[0] for name in names} == {"lerobot_camera_tacshade"}


def test_alone_it_listens_to_a_daemon(tmp_path: Path) -> None:
    wheel = built(ROOT / "client", tmp_path / "client")
    python = environment(tmp_path / "environment", wheel)
    calibration_file.save(tmp_path / "cal.npz", calibrated(FULL, 0))
    with Broker(tmp_path) as broker:
        where = f"127.0.0.1:{broker.port}"
        settings = "calibration: cal.npz\nsource: {kind: simulated}\nsensor_id: left-index\n"
        (tmp_path / "run.yaml").write_text(f"{settings}mqtt: {{host: 127.0.0.1, port: {broker.port}}}\n")
        command = [sys.executable, "-m", "tacshade_edge", "run", "--config", str(tmp_path / "run.yaml")]
        daemon = subprocess.Popen(command, cwd=ROOT)
        try:
            reported = [str(python), "-c", LISTEN, where]
            done = subprocess.run(
                reported, capture_output=True, text=True, env=clean(), timeout=patience(60), check=False
            )
        finally:
            daemon.send_signal(signal.SIGTERM)
            daemon.wait(patience(10))
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["radius_mm"] == pytest.approx(FULL.skin_radius_mm, abs=0.2)
    assert {"numpy", "paho", "tacshade_client"} <= set(found["modules"])
    assert not {"tacshade_edge", "cv2", "yaml", "scipy"} & set(found["modules"])


def environment(folder: Path, wheel: Path) -> Path:
    """The wheel and what it needs, of this environment's files, so that nothing is downloaded."""
    venv.create(folder, symlinks=True)
    python = folder / "bin" / "python"
    reported = [python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"]
    packages = Path(subprocess.run(reported, check=True, capture_output=True, text=True).stdout.strip())
    for pattern in ("msgspec*", "numpy*", "paho*"):
        for found in Path(np.__file__).parents[1].glob(pattern):
            (packages / found.name).symlink_to(found)
    words = [
        "install",
        "--quiet",
        "--no-index",
        "--disable-pip-version-check",
        "--no-deps",
        "--target",
        packages,
        wheel,
    ]
    subprocess.run([sys.executable, "-m", "pip", *words], check=True, env=clean(), timeout=patience(120))
    return python


def clean() -> dict[str, str]:
    """Without what leads Python to a checkout."""
    return {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
