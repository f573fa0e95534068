from __future__ import annotations

import socket
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from tacshade_edge.camera.file_source import FilesSource, first_size_px
from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.types import Pose


def picture(level: int, height: int = 48, width: int = 64) -> np.ndarray:
    return np.full((height, width, 3), level, dtype=np.uint8)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for i in range(3):
        cv2.imwrite(str(tmp_path / f"{i}.png"), picture(40 * i))
    (tmp_path / "notes.txt").write_text("not an image")
    return tmp_path


def test_a_folder_gives_its_images_in_the_order_of_their_names_then_ends(folder: Path) -> None:
    source = FilesSource(path=folder, fps=240, loop=False)
    source.open()
    frames = [source.read() for _ in range(4)]
    assert [f and (f.seq, int(f.image[0, 0, 0])) for f in frames] == [
        (0, 0),
        (1, 40),
        (2, 80),
        None,
    ]
    assert source.read() is None
    assert source.describe() == {"path": str(folder), "fps": 240, "images": 3}
    source.close()
    source.close()


def test_a_table_gives_the_order_and_the_poses(folder: Path) -> None:
    table = folder / "frames.csv"
    table.write_text(
        "image,t_ns,x_mm,y_mm,z_mm,qw,qx,qy,qz,pose_error_us\n"
        "2.png,5,1,2,3,1,0,0,0,7\n"
        "0.png,6,,,,,,,,\n"
    )
    source = FilesSource(path=folder, fps=240, loop=False)
    source.open()
    first, second, end = (source.read() for _ in range(3))
    assert first is not None
    assert second is not None
    assert (int(first.image[0, 0, 0]), int(second.image[0, 0, 0]), end) == (80, 0, None)
    assert first.pose == Pose(first.t_ns, 1.0, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0)
    assert (first.pose_error_us, second.pose, second.pose_error_us) == (7, None, 0)
    cv2.imwrite(str(folder / "2.png"), picture(0, height=24))
    assert first_size_px(folder) == (64, 24)
    (folder / "2.png").write_bytes(b"torn")
    assert first_size_px(folder) is None
    table.write_text("image\n")
    with pytest.raises(ConfigError, match=r"frames\.csv:1: found the header image, expected"):
        first_size_px(folder)
    with pytest.raises(ConfigError, match=r"frames\.csv:1: found the header image, expected"):
        source.open()


def test_frames_come_no_faster_than_asked(folder: Path) -> None:
    source = FilesSource(path=folder, fps=200, loop=True)
    source.open()
    times = [frame.t_ns for _ in range(7) if (frame := source.read())]
    assert len(times) == 7
    assert times[-1] - times[0] >= 6 * 5_000_000 - 1_000_000  # sleep may wake a little early


def test_what_is_skipped_is_waited_for_and_not_decoded(folder: Path) -> None:
    (folder / "0.png").write_bytes(b"none")
    source = FilesSource(path=folder, fps=240, loop=False)
    source.open()
    began_ns = time.monotonic_ns()
    skipped = sum(iter(source.skip, False))
    assert time.monotonic_ns() - began_ns >= (skipped - 1) * 4_000_000
    source.close()
    source.open()
    assert source.skip()
    frame = source.read()
    assert frame is not None
    assert frame.seq == skipped + 1


def test_a_loop_and_a_reopening_keep_counting(folder: Path) -> None:
    source = FilesSource(path=folder / "1.png", fps=240, loop=True)
    source.open()
    assert [frame.seq for _ in range(3) if (frame := source.read())] == [0, 1, 2]
    source.close()
    assert source.read() is None
    source.open()
    again = source.read()
    assert again is not None
    assert again.seq == 3


def test_a_damaged_image_and_one_of_another_size_are_reported_and_passed_over(folder: Path) -> None:
    (folder / "0b.png").write_bytes((folder / "0.png").read_bytes()[:60])
    cv2.imwrite(str(folder / "1b.png"), picture(0, height=24))
    source = FilesSource(path=folder, fps=240, loop=False)
    source.open()
    seen: list[int] = []
    reported: list[str] = []
    for _ in range(5):
        try:
            frame = source.read()
        except DecodeError as error:
            reported.append(str(error))
        else:
            assert frame is not None
            seen.append(frame.seq)
    assert seen == [0, 2, 4]
    assert reported[0].endswith(
        "0b.png: found an image cut short after 60 bytes, expected a whole image"
    )
    assert reported[1].endswith(
        ": 1b.png: found 64x24 px, expected 64x48 px, the first image's size"
    )


@pytest.mark.parametrize("name", ["list.m3u8", "list.mp4", "list.avi"])
def test_a_list_of_videos_is_none(name: str, tmp_path: Path) -> None:
    """FFmpeg would take one, and open the files and addresses that it names."""
    writer = cv2.VideoWriter(
        str(tmp_path / "part.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 30, (64, 48)
    )
    writer.write(picture(40))
    writer.release()
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(0)
        for part in ("part.avi", f"http://127.0.0.1:{server.getsockname()[1]}/part.avi"):
            for text in (
                f"#EXTM3U\n#EXTINF:1,\n{part}\n#EXT-X-ENDLIST\n",
                f"ffconcat version 1.0\nfile {part}\n",
            ):
                (tmp_path / name).write_text(text)
                with pytest.raises(
                    ConfigError, match=r"found text that begins with .*, expected a video"
                ):
                    first_size_px(tmp_path / name)
        with pytest.raises(BlockingIOError):
            server.accept()
