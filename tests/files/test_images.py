from __future__ import annotations

import io
import os
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.files.images import BYTES_MAX, by_number, images_in, read_image

PICTURE = np.random.default_rng(5).integers(0, 256, (48, 64, 3), dtype=np.uint8)


@pytest.mark.parametrize("suffix", [".png", ".bmp", ".tiff", ".ppm"])
def test_a_lossless_image_is_read_as_written(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    assert cv2.imwrite(str(path), PICTURE)
    np.testing.assert_array_equal(read_image(path), PICTURE)


@pytest.mark.parametrize(
    ("suffix", "bits", "factor"), [(".png", 10, 64), (".tiff", 12, 16), (".pgm", 10, 64)]
)
def test_values_of_ten_or_twelve_bits_in_16_are_refused(
    tmp_path: Path, suffix: str, bits: int, factor: int
) -> None:
    path = tmp_path / f"deep{suffix}"
    deep = PICTURE[:, :, 0].astype(np.uint16) << (bits - 8)
    cv2.imwrite(str(path), deep)
    expected = (
        f"found values up to {deep.max()} in 16-bit pixels, "
        f".*multiply {bits}-bit values by {factor}$"
    )
    with pytest.raises(DecodeError, match=expected):
        read_image(path)
    cv2.imwrite(str(path), deep * factor)
    np.testing.assert_array_equal(read_image(path), PICTURE[:, :, 0])
    cv2.imwrite(str(path), deep * 0)
    assert not read_image(path).any()


def test_values_of_fourteen_bits_in_16_are_refused_and_dark_pictures_are_not(
    tmp_path: Path,
) -> None:
    path = tmp_path / "deep.png"
    grey = PICTURE[:, :, 0].astype(np.uint16)
    fine = (grey << 6) + np.arange(64, dtype=np.uint16)
    cv2.imwrite(str(path), fine)
    with pytest.raises(
        DecodeError, match=r"found values up to 16\d+ .*multiply 14-bit values by 4$"
    ):
        read_image(path)
    cv2.imwrite(str(path), fine * 4)
    np.testing.assert_array_equal(read_image(path), grey)
    # Dark pictures of all 16 bits: 8 bits repeated, and 14 bits shifted.
    for dark, shown in ((grey // 4 * 257, grey // 4), (fine // 4 * 4, grey // 4)):
        cv2.imwrite(str(path), dark)
        np.testing.assert_array_equal(read_image(path), shown)


def tiff(picture: np.ndarray, thumbnail: np.ndarray | None = None, **more: Any) -> bytes:
    stream = io.BytesIO()
    with tifffile.TiffWriter(stream, byteorder=more.pop("byteorder", "<")) as writer:
        writer.write(picture, photometric="minisblack", **more)
        if thumbnail is not None:
            writer.write(thumbnail, photometric="minisblack", subfiletype=1)
    return stream.getvalue()


def pillow(kind: str, mode: str = "L", **more: Any) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(GREY).convert(mode).save(stream, kind, **more)
    return stream.getvalue()


def pgm(most: int, values: np.ndarray) -> bytes:
    return b"P5\n64 48\n%d\n" % most + values.tobytes()


GREY = PICTURE[:, :, 0]
TEN = GREY.astype(np.uint16) << 2
HOT = np.where(np.arange(TEN.size).reshape(TEN.shape) == 77, 65535, TEN).astype(np.uint16)
ASCII = b"P2\n64 48\n255\n" + " ".join(map(str, GREY.ravel().tolist())).encode()
ANIMATED = {"save_all": True, "append_images": [Image.fromarray(255 - GREY)]}
TURNED = b"Exif\0\0MM\0*\0\0\0\x08\0\1\1\x12\0\3\0\0\0\1\0\6\0\0\0\0\0\0"
DEEP, OTHER, SEVERAL, FEW = (
    "16-bit pixels",
    "floating-point or signed",
    "several pages",
    "1 bits per pixel",
)
OTHERS: dict[str, tuple[bytes, str]] = {
    **{
        f"{kind} in a tiff": (tiff(GREY.astype(kind)), OTHER)
        for kind in ("f2", "f4", "f8", "i1", "i2", "i4")
    },
    "floats in colour": (cv2.imencode(".tiff", PICTURE.astype(np.float32))[1].tobytes(), OTHER),
    "10 bits and a hot pixel": (cv2.imencode(".png", HOT)[1].tobytes(), DEEP),
    "10 bits, the other byte order": (tiff(TEN, byteorder=">"), DEEP),
    "a pgm of 10 bits": (
        pgm(1023, TEN.astype(">u2")),
        "found 1023 as the greatest value of a pixel, expected 255 or",
    ),
    "a pgm of 100 levels": (pgm(100, GREY // 3), "found 100 as the greatest value"),
    "a tiff of two pages": (tiff(np.stack((GREY, GREY))), SEVERAL),
    "a tiff with a thumbnail": (tiff(GREY, thumbnail=GREY[::4, ::4]), ""),
    "an animated png": (pillow("PNG", **ANIMATED), SEVERAL),
    "an animated webp": (pillow("WEBP", "RGB", lossless=True, **ANIMATED), SEVERAL),
    **{f"a {kind} of 1 bit": (pillow(kind, "1"), FEW) for kind in ("PNG", "TIFF", "BMP")},
    "a turned tiff": (tiff(GREY, extratags=[(274, "H", 1, 6, True)]), "orientation 6, expected 1"),
    "a turned jpeg": (pillow("JPEG", quality=100, exif=TURNED), ""),
    "a palette": (pillow("PNG", "P"), ""),
    "alpha": (pillow("PNG", "LA"), ""),
    "a jpeg padded by the camera": (pillow("JPEG", quality=100) + bytes(100), ""),
    "numbers as text": (ASCII, ""),
}


@pytest.mark.parametrize("name", OTHERS)
def test_other_kinds_of_pictures_are_read_right_or_named(tmp_path: Path, name: str) -> None:
    data, message = OTHERS[name]
    (tmp_path / "a").write_bytes(data)
    if message:
        with pytest.raises(DecodeError, match=f"a: found .*{message.removeprefix('found ')}"):
            read_image(tmp_path / "a")
    else:
        found = read_image(tmp_path / "a").astype(int)
        assert np.abs(found - (GREY if found.ndim == 2 else GREY[:, :, None])).max() < 5


def test_what_is_no_image_is_refused(tmp_path: Path) -> None:
    (tmp_path / "empty.png").touch()
    os.mkfifo(tmp_path / "pipe.png")
    with (tmp_path / "huge.png").open("wb") as stream:
        stream.truncate(BYTES_MAX + 1)
    for name, said in {
        "empty.png": "found 0 bytes",
        "none.png": "No such file",
        "nul\0.png": "embedded null",
        "pipe.png": "found no regular file, expected an image$",
        "huge.png": "found more than 67108864 bytes, expected an image$",
    }.items():
        with pytest.raises(DecodeError, match=said):
            read_image(tmp_path / name)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.integers(0, 10**20), unique=True, min_size=1, max_size=12), st.data())
def test_numbers_in_names_sort_as_numbers(numbers: list[int], data: st.DataObject) -> None:
    width = data.draw(st.integers(1, 6))
    before, after = data.draw(st.tuples(*2 * [st.sampled_from(["", "frame_", "a-b ", "2x_", "."])]))
    names = [Path(f"x{before}{number:0{width}d}{after}.png") for number in sorted(numbers)]
    assert sorted(data.draw(st.permutations(names)), key=by_number) == names


@given(st.lists(st.text(min_size=1, max_size=9), max_size=9))
def test_any_names_have_one_order(names: list[str]) -> None:
    paths = [Path("a" + name.replace("/", "")) for name in names]
    ordered = sorted(paths, key=by_number)
    paths.reverse()
    assert sorted(paths, key=by_number) == ordered


def test_a_folder_gives_its_images_without_the_files_of_systems(tmp_path: Path) -> None:
    for name in ("frame10.png", "frame2.PNG", "frame1.jpg"):
        (tmp_path / name).touch()
        (tmp_path / f"._{name}").touch()
    for name in (".DS_Store", "Thumbs.db", ".hidden.png", "desktop.ini", "notes.txt"):
        (tmp_path / name).touch()
    (tmp_path / "__MACOSX").mkdir()
    (tmp_path / "__MACOSX" / "._frame1.jpg").touch()
    found = [path.name for path in images_in([tmp_path])]
    assert found == ["frame1.jpg", "frame2.PNG", "frame10.png"]
    assert images_in([tmp_path / ".hidden.png"]) == [tmp_path / ".hidden.png"]  # named, so meant
    with pytest.raises(ConfigError, match="found no image, expected"):
        images_in([tmp_path / "__MACOSX"])
