"""Runs as root in the guest of tools/rig, with systemd's control groups: a container on a camera, prints JSON.

Only what was seen is printed; test_container.py judges. /out has the image's root and its configuration.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

from support.booted_service import process, sh
from support.vivid import FPS, NODE

from tools.testbed.mqtt_rig import Broker, Subscriber
from tools.testbed.patience import patience

FEEDER = Path(__file__).parents[2] / "tools/rig/feed_video.py"
SCRATCH = Path("/dev/shm")
BASE = "tacshade/tacshade"
PODMAN = ("podman", "--root", str(SCRATCH / "root"), "--runroot", str(SCRATCH / "run"), "--storage-driver", "vfs")
START_S = 30


def main(given: Path) -> None:
    image = json.loads((given / "image.json").read_text())
    frames = (sys.executable, str(FEEDER), "--rate", "5", str(given / "images.npy"))
    feeder = subprocess.Popen(frames, stdout=subprocess.PIPE, text=True)
    assert feeder.stdout is not None
    assert feeder.stdout.readline() == "playing\n"
    sh("udevadm", "settle")
    state = SCRATCH / "state"
    state.mkdir()
    shutil.copy(given / "calibration.npz", state)
    for path in (state, state / "calibration.npz"):
        shutil.chown(path, 10001, 10001)
    settings = SCRATCH / "config.yaml"
    with Broker(SCRATCH) as broker, Subscriber(broker.port) as seen:
        settings.write_text(
            "profile: fast\n"
            f"source: {{kind: v4l2, device: {NODE}, width_px: 640, height_px: 480, fps: {FPS}, fourcc: YUYV}}\n"
            f"mqtt: {{host: 127.0.0.1, port: {broker.port}}}\n"
        )
        # As docs/tutorials/install.md has it; what an image states besides is given here: the guest has only files.
        options = [
            *("--network", "host", "--device", NODE, "--group-add", str(Path(NODE).stat().st_gid), "--read-only"),
            *("--cap-drop", "all", "--security-opt", "no-new-privileges", "--memory", "150m"),
            *("--volume", f"{state}:/var/lib/tacshade-edge"),
            *("--volume", f"{settings}:/etc/tacshade-edge/config.yaml:ro"),
            *("--name", "hand", "--user", image["User"], *(word for env in image["Env"] for word in ("--env", env))),
        ]
        words = (*PODMAN, "run", *options, "--rootfs", str(given / "root"), *image["Entrypoint"], *image["Cmd"])
        child = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        try:
            seen.wait_for(f"{BASE}/height", 10, START_S)
            pid = sh(*PODMAN, "inspect", "--format", "{{.State.Pid}}", "hand")[1]
            group = Path("/sys/fs/cgroup", Path(f"/proc/{pid}/cgroup").read_text().strip().removeprefix("0::/"))
            found: dict[str, Any] = {"process": process(pid)}
            found["camera"] = json.loads(seen.of(f"{BASE}/status/camera")[-1])
            found["limit"] = int((group / "memory.max").read_text())
            stat = dict(line.split() for line in (group / "memory.stat").read_text().splitlines())
            found["own"] = int(stat["anon"])
            sh(*PODMAN, "stop", "--time", f"{patience(5):.0f}", "hand")
            found["code"] = child.wait(patience(10))
            found["state"] = seen.wait_for(f"{BASE}/state")[-1].decode()
        finally:
            child.kill()
            print(child.communicate()[0], file=sys.stderr)
            feeder.terminate()
    found["files"] = sorted(path.name for path in state.iterdir())
    Path("/out/seen.json").write_text(json.dumps(found))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
