from __future__ import annotations

import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from tacshade_edge.errors import DecodeError
from tacshade_edge.storage.images import BYTES_MAX, read_image

PICTURE = np.random.default_rng(5).integers(0, 256, (48, 64, 3), dtype=np.uint8)


@pytest.mark.parametrize("suffix", [".png", ".bmp", ".tiff", ".ppm"])
def test_a_lossless_image_is_read_as_written(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    assert cv2.imwrite(str(path), PICTURE)
    np.testing.assert_array_equal(read_image(path), PICTURE)


def test_a_grey_image_stays_grey_and_16_bits_become_8(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "grey.png"), PICTURE[:, :, 0])
    np.testing.assert_array_equal(read_image(tmp_path / "grey.png"), PICTURE[:, :, 0])
    cv2.imwrite(str(tmp_path / "deep.png"), PICTURE[:, :, 0].astype(np.uint16) * 256)
    np.testing.assert_array_equal(read_image(tmp_path / "deep.png"), PICTURE[:, :, 0])


@pytest.mark.parametrize("suffix", [".png", ".tiff", ".pgm"])
@pytest.mark.parametrize(("bits", "factor"), [(10, 64), (12, 16)])
def test_values_of_ten_or_twelve_bits_in_16_are_refused(tmp_path: Path, suffix: str, bits: int, factor: int) -> None:
    path = tmp_path / f"deep{suffix}"
    deep = PICTURE[:, :, 0].astype(np.uint16) << (bits - 8)
    cv2.imwrite(str(path), deep)
    expected = f"found values up to {deep.max()} in 16-bit pixels, .*multiply {bits}-bit values by {factor}$"
    with pytest.raises(DecodeError, match=expected):
        read_image(path)
    cv2.imwrite(str(path), deep * factor)
    np.testing.assert_array_equal(read_image(path), PICTURE[:, :, 0])
    cv2.imwrite(str(path), deep * 0)
    assert not read_image(path).any()


@pytest.mark.parametrize("kind", [np.float32, np.float64, np.int16])
@pytest.mark.parametrize("picture", [PICTURE, PICTURE[:, :, 0]])
def test_a_tiff_of_other_numbers_is_named(tmp_path: Path, kind: type, picture: np.ndarray) -> None:
    path = tmp_path / "a.tiff"
    cv2.imwrite(str(path), picture.astype(kind))
    with pytest.raises(DecodeError, match="found a TIFF of floating-point or signed values, expected whole numbers"):
        read_image(path)


def test_a_jpeg_padded_by_the_camera_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "padded.jpg"
    cv2.imwrite(str(path), PICTURE)
    path.write_bytes(path.read_bytes() + bytes(100))
    assert read_image(path).shape == PICTURE.shape


def test_what_is_no_image_is_refused(tmp_path: Path) -> None:
    (tmp_path / "empty.png").touch()
    (tmp_path / "text.png").write_text("hello")
    for name, said in {
        "empty.png": "found 0 bytes",
        "text.png": "found 5 bytes",
        "none.png": "No such file",
        "nul\0.png": "embedded null",
    }.items():
        with pytest.raises(DecodeError, match=said):
            read_image(tmp_path / name)


def test_only_a_regular_file_is_read(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.png")
    for path in (tmp_path / "pipe.png", Path("/dev/zero")):
        with pytest.raises(DecodeError, match=f"{path.name}: found no regular file, expected an image$"):
            read_image(path)


def test_a_file_of_more_than_64_mib_is_not_read(tmp_path: Path) -> None:
    with (tmp_path / "huge.png").open("wb") as stream:
        stream.truncate(BYTES_MAX + 1)
    with pytest.raises(DecodeError, match=r"huge\.png: found more than 67108864 bytes, expected an image$"):
        read_image(tmp_path / "huge.png")
