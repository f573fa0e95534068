"""The wheels and sdists of the client and of the LeRobot camera."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import tarfile
import zipfile
from email import message_from_bytes
from email.message import Message
from importlib.util import find_spec
from pathlib import Path

import pytest
import tacshade_client
import tacshade_client.rigid

import tacshade_edge.rigid
from support.client_wheel import built, command, unpacked
from support.mqtt_rig import Broker, Subscriber
from support.patience import patience, wait_until
from support.published_sensor import CRC, bump
from tacshade_edge.wire import binary
from tools.release.version import version

ROOT = Path(__file__).parents[2]
BYTES_MAX = 60_000
HEIGHT = binary.encode_height(bump(7, 2.0, 236.0, 328.0, step_px=8), calibration_crc32=CRC)
# Decodes a file, lists the names that came with the client, then listens if a broker is named.
PROGRAM = """
import json, sys
import tacshade_client as tc
from tacshade_client.rigid import shift
message = tc.decode_message("tacshade/left/height", open(sys.argv[1], "rb").read())
print(json.dumps({
    "seq": message.value.seq,
    "names": tc.__all__,
    "loaded": sorted({name.partition(".")[0] for name in sys.modules}),
    "missing": [name for name in tc.__all__ if not hasattr(tc, name)],
}), flush=True)
if sys.argv[2:]:
    with tc.listen(sys.argv[2], "left") as messages:
        print(next(messages).value.seq)
"""
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(find_spec("hatchling") is None, reason="hatchling is not installed"),
]


def contents(wheel: Path) -> tuple[set[str], Message]:
    """The names in a wheel, and what it says of itself."""
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        about = next(name for name in names if name.endswith("/METADATA"))
        return set(names), message_from_bytes(archive.read(about))


@pytest.fixture(scope="module")
def wheels(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """One wheel from the checkout, and one from an sdist that stands alone."""
    folder = tmp_path_factory.mktemp("client")
    sdist = built(ROOT / "client", folder / "sdist", "sdist")
    with tarfile.open(sdist) as archive:
        assert not [each.name for each in archive if each.islnk() or each.issym()]
        archive.extractall(folder / "alone", filter="data")
    (alone,) = (folder / "alone").iterdir()
    return {
        "checkout": built(ROOT / "client", folder / "one"),
        "sdist": built(alone, folder / "other"),
    }


def test_no_file_of_the_repository_is_a_link() -> None:
    """Windows and archives of a repository make text files of them."""
    if shutil.which("git") is None or not (ROOT / ".git").exists():
        pytest.skip("no repository")
    words = ("git", "ls-files", "--stage")
    listed = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    assert [line for line in listed.splitlines() if line.startswith("120000")] == []


@pytest.mark.parametrize("source", ["checkout", "sdist"])
def test_it_is_small_and_owns_no_file_of_the_daemons_wheel(
    wheels: dict[str, Path], source: str
) -> None:
    wheel = wheels[source]
    names, about = contents(wheel)
    print(f"{wheel.name}: {wheel.stat().st_size} bytes")
    assert wheel.stat().st_size < BYTES_MAX
    assert {name.partition("/")[0].partition("-")[0] for name in names} == {"tacshade_client"}
    assert {"tacshade_client/py.typed", "tacshade_client/wire/wire_format.py"} <= names
    assert (about["Version"], about["License-Expression"]) == (version(), "MIT")
    needs = [re.split("[<>]", need)[0] for need in about.get_all("Requires-Dist", [])]
    assert needs == ["msgspec", "numpy", "paho-mqtt"]


def test_both_wheels_are_the_same_files_of_tacshade_edge(wheels: dict[str, Path]) -> None:
    with zipfile.ZipFile(wheels["checkout"]) as one, zipfile.ZipFile(wheels["sdist"]) as other:
        modules = [name for name in one.namelist() if name.endswith(".py")]
        assert len(modules) > 2
        for name in modules:
            found = one.read(name)
            assert found == other.read(name)
            file = name.removeprefix("tacshade_client/").replace("__init__", "thin_client")
            assert found == (ROOT / "tacshade_edge" / file).read_bytes()


@pytest.mark.parametrize("source", ["checkout", "sdist"])
def test_it_needs_nothing_of_the_daemon_and_offers_what_a_checkout_does(
    wheels: dict[str, Path], source: str, tmp_path: Path
) -> None:
    program, payload = written(tmp_path)
    client = unpacked(wheels[source], tmp_path / "client")
    done = subprocess.run(
        command(client, program, str(payload)), capture_output=True, text=True, check=True
    )
    found = json.loads(done.stdout)
    assert (found["seq"], found["missing"]) == (7, [])
    assert found["names"] == tacshade_client.__all__
    assert {"msgspec", "numpy", "paho", "tacshade_client"} <= set(found["loaded"])
    assert not {"tacshade_edge", "cv2", "scipy", "yaml", "onnxruntime", "serial"} & set(
        found["loaded"]
    )
    assert tacshade_client.rigid.shift is tacshade_edge.rigid.shift


@pytest.mark.broker
@pytest.mark.parametrize("source", ["checkout", "sdist"])
def test_it_listens_without_the_daemons_wheel(
    wheels: dict[str, Path], source: str, tmp_path: Path
) -> None:
    program, payload = written(tmp_path)
    client, printed = unpacked(wheels[source], tmp_path / "client"), tmp_path / "printed"
    with (
        Broker(tmp_path) as broker,
        Subscriber(broker.port, "none") as sender,
        printed.open("w") as out,
    ):
        words = command(client, program, str(payload), f"127.0.0.1:{broker.port}")
        listener = subprocess.Popen(words, stdout=out)

        def has_ended() -> bool:
            sender.publish("tacshade/left/height", HEIGHT)
            return listener.poll() is not None

        try:
            wait_until(has_ended, 20, "the listener prints a message")
        finally:
            listener.kill()
            listener.wait(patience(10))
    assert printed.read_text().splitlines()[1:] == ["7"]


def written(folder: Path) -> tuple[Path, Path]:
    """A program and a payload as files."""
    program, payload = folder / "program.py", folder / "payload"
    program.write_text(PROGRAM)
    payload.write_bytes(HEIGHT)
    return program, payload


def test_the_camera_for_lerobot_has_the_name_that_lerobot_looks_for(tmp_path: Path) -> None:
    names, about = contents(built(ROOT / "client_lerobot", tmp_path / "made"))
    assert (about["Name"], about["License-Expression"]) == ("lerobot_camera_tacshade", "MIT")
    assert about.get_all("Requires-Dist") == ["tacshade-client"]
    assert {name.partition("/")[0].partition("-")[0] for name in names} == {
        "lerobot_camera_tacshade"
    }


@pytest.mark.parametrize("project", ["client", "client_lerobot"])
def test_each_distribution_has_the_licence(project: str) -> None:
    assert (ROOT / project / "LICENSE").read_bytes() == (ROOT / "LICENSE").read_bytes()
