from __future__ import annotations

import random
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from tacshade_edge.errors import ConfigError
from tacshade_edge.recording.frame_table import (
    HEADER,
    MORE,
    POSES_HEADER,
    TableRow,
    line_crc32,
    read_poses,
    read_table,
    table_in,
)
from tacshade_edge.types import Pose

PLAIN, ERRORS, CHECKED = (",".join((*HEADER, *MORE[:count])) + "\n" for count in range(3))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", r"frames\.csv: found no rows, expected one per frame"),
        (
            "image,t_ns\na.png,1\n",
            r"frames\.csv:1: found the header image,t_ns, expected image,t_ns,x_mm",
        ),
        (PLAIN + "a.png,1\n", r"frames\.csv:2: found 2 columns, expected 9"),
        (PLAIN + ",1,,,,,,,\n", ":2: image: found nothing, expected a file name"),
        (PLAIN + "a.png,-1,,,,,,,\n", ":2: t_ns: found '-1', expected a whole number from 0 to"),
        (
            PLAIN + f"a.png,{2**62 + 1},,,,,,,\n",
            ":2: t_ns: found '4611686018427387905', expected a whole number",
        ),
        (
            PLAIN + "a.png,5,,,,,,,\na.png,5,,,,,,,\n",
            ":3: t_ns: found 5, expected more than the previous row's 5",
        ),
        (
            PLAIN + "a.png,5,1,,,,,,\n",
            ":2: x_mm to qz: found 1 of the 7 values, expected all or none",
        ),
        (PLAIN + "a.png,5,1,2,x,1,0,0,0\n", ":2: z_mm: found 'x', expected a number"),
        (
            PLAIN + "a.png,5,1e300,2,3,1,0,0,0\n",
            r":2: x_mm: found '1e300', expected a number from -1e\+06 to 1e\+06",
        ),
        (
            PLAIN + "a.png,5,1,2,3,1,1,0,0\n",
            ":2: qw, qx, qy, qz: found a quaternion of length 1.414, expected",
        ),
        (ERRORS + "a.png,5,1,2,3,1,0,0,0", "found 9 columns, expected 10"),
        (
            ERRORS + f"a.png,5,1,2,3,1,0,0,0,{2**32}",
            "pose_error_us: found '4294967296', expected a whole number",
        ),
        (
            ERRORS + "a.png,5,,,,,,,,3",
            "pose_error_us: found '3', expected a whole number .* in a row with a pose",
        ),
        (ERRORS + "\udcff.png,5,,,,,,,,\n", "not a CSV file: 'utf-8' codec can't decode byte 0xff"),
        (PLAIN + '"a,5,,,,,,,\n', ":2: not a CSV file"),
        (PLAIN + "a" * 10**6, ":2: found 1 columns"),
    ],
)
def test_a_wrong_table_is_named_by_line_and_column(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "frames.csv").write_bytes(text.encode(errors="surrogateescape"))
    with pytest.raises(ConfigError, match=said) as refusal:
        read_table(tmp_path / "frames.csv")
    assert "\n" not in str(refusal.value)


def test_the_time_error_of_a_pose_is_a_column_that_older_tables_lack(tmp_path: Path) -> None:
    table = tmp_path / "frames.csv"
    table.write_text(
        ERRORS + f"a.png,5,1,2,3,1,0,0,0,{2**32 - 1}\nb.png,6,1,2,3,1,0,0,0,\n\nc.png,7,,,,,,,,\n"
    )
    found = [(row.pose is None, row.pose_error_us) for row in read_table(table)]
    assert found == [(False, 2**32 - 1), (False, 0), (True, 0)]


def test_the_table_of_a_writer_that_died_is_read_to_its_last_whole_line(tmp_path: Path) -> None:
    assert table_in(tmp_path) is None
    partial, table = tmp_path / "frames.csv.part", tmp_path / "frames.csv"
    partial.write_text(PLAIN + "a.png,5,,,,,,,\nb.png,61,,,,,,")
    assert table_in(tmp_path) == partial
    assert [row.image for row in read_table(partial, cut_off=True)] == ["a.png"]
    with pytest.raises(ConfigError, match="part:3: found 8 columns, expected 9"):
        read_table(partial)
    table.touch()
    assert table_in(tmp_path) == table


def test_a_row_takes_150_bytes_of_memory(tmp_path: Path) -> None:
    rows = "".join(
        f"frame_{i:06d}.png,{i},1.25,-12.123456,3.5,0.99999,0.0001,0.0001,0,7\n"
        for i in range(2_000)
    )
    (tmp_path / "frames.csv").write_text(ERRORS + rows)
    tracemalloc.start()
    table = read_table(tmp_path / "frames.csv")
    kept, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert kept < 170 * len(table) == 170 * 2_000
    assert most < kept + (1 << 20)
    pose = Pose(1_999, 1.25, -12.123456, 3.5, 0.99999, 0.0001, 0.0001, 0.0)
    assert table[-1] == table[1_999:][0] == TableRow("frame_001999.png", 1_999, pose, 7)


def checked_table(rows: int) -> bytes:
    lines = [
        f"{i:06d}.png,{81_200_000_000 + i * 33_333_333},120.5,-3,{i}.25,1,0,0,0,412"
        for i in range(rows)
    ]
    return (CHECKED + "".join(f"{line},{line_crc32(line)}\n" for line in lines)).encode()


def test_no_flipped_bit_goes_unnoticed(tmp_path: Path) -> None:
    """Rows before and after it are the ones that were written;
    those of the damaged line are left out and counted.
    """
    good, path, draw = checked_table(12), tmp_path / "frames.csv", random.Random(2)
    path.write_bytes(good)
    written = list(read_table(path))
    assert len(written) == 12
    for at in (*draw.sample(range(len(good)), 300), len(good) - 1):
        path.write_bytes(good[:at] + bytes([good[at] ^ 1 << draw.randrange(8)]) + good[at + 1 :])
        if at < len(CHECKED):
            with pytest.raises(ConfigError, match=r"frames\.csv:1: "):
                read_table(path)
            continue
        table = read_table(path)
        assert set(table) <= set(written)
        if at < len(good) - 1:  # without the last line's end it is still that line
            assert table.damaged in (1, 2)  # two where a line's end is hit
            assert len(table) >= 10
            assert f"{path}:" in table.damage


def test_where_and_how_many_lines_were_left_out(tmp_path: Path) -> None:
    path = tmp_path / "frames.csv"
    lines = checked_table(6).splitlines(keepends=True)
    lines[2] = lines[2].replace(b"120.5", b"121.5")
    lines[5] = b"\xff\x00" + lines[5]
    path.write_bytes(b"".join(lines))
    table = read_table(path)
    assert [row.image for row in table] == [f"{i:06d}.png" for i in (0, 2, 3, 5)]
    assert table.damage.startswith(f"{path}:3: left out 2 damaged lines and their frames")
    columns = lines[4].rpartition(b",")[0].replace(b"120.5", b"x").decode()
    lines[4] = f"{columns},{line_crc32(columns)}\n".encode()
    path.write_bytes(b"".join(lines))
    with pytest.raises(ConfigError, match=":5: x_mm: found 'x'"):
        read_table(path)
    path.write_bytes(lines[0] + lines[2])
    with pytest.raises(
        ConfigError, match=r"found no rows, expected one per frame \(.*:2: left out 1 damaged"
    ):
        read_table(path)


def test_row_numbers_and_quoted_decimal_commas_of_other_programs_are_read(tmp_path: Path) -> None:
    path = tmp_path / "frames.csv"
    path.write_bytes(checked_table(3))
    whole = read_table(path)[:]
    lines = checked_table(3).splitlines(keepends=True)
    path.write_bytes(b"," + lines[0] + b"".join(b"%d,%s" % (k, x) for k, x in enumerate(lines[1:])))
    assert read_table(path)[:] == whole
    path.write_text(PLAIN + '0.png,0,"1,5","-2",0,1,0,0,0\n')
    assert read_table(path)[0].pose.x_mm == 1.5


def poses_table(tmp_path: Path, *lines: str) -> Path:
    path = tmp_path / "POSES.csv"
    path.write_text("\n".join((",".join(POSES_HEADER), *lines)) + "\n")
    return path


def test_lines_become_poses(tmp_path: Path) -> None:
    one, other = read_poses(
        poses_table(tmp_path, "a.png,1,2,3,1,0,0,0", "sub/b.png,-1.5,0,0,0,1.004,0,0")
    )
    assert one.path == tmp_path / "a.png"
    assert other.path == tmp_path / "sub" / "b.png"
    assert other.where.endswith("POSES.csv:3")
    np.testing.assert_allclose(one.base_T_flange.apply(np.zeros(3)), (1, 2, 3))
    np.testing.assert_allclose(
        other.base_T_flange.apply(np.array((0, 0, 1))), (-1.5, 0, -1), atol=1e-12
    )


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("a.png,1,2,3,1,0,0", ":2: found 7 columns, expected 8"),
        ("a.png,1,2,nan,1,0,0,0", ":2: z_mm: found 'nan'"),
        ("a.png,1,2,3,0,0,0,0", ":2: .*found a quaternion of length 0, expected length 1"),
        (",1,2,3,1,0,0,0", ":2: image: found nothing"),
        ("", "found no rows"),
    ],
)
def test_a_mistake_in_poses_names_the_line(tmp_path: Path, line: str, message: str) -> None:
    with pytest.raises(ConfigError, match=rf"POSES\.csv.*{message}"):
        read_poses(poses_table(tmp_path, line))


def test_a_spreadsheets_table_says_so(tmp_path: Path) -> None:
    *rows, _ = checked_table(12).decode().split("\n")
    rounded = [
        rows[0],
        *(f"{a},{int(b):.11E},{c}" for a, b, c in (r.split(",", 2) for r in rows[1:])),
    ]
    edited = [rows[0], *(f"{row[:-8]}{'0' * 8}" for row in rows[1:])]
    path = tmp_path / "frames.csv"
    for lines, said in (
        (
            rounded,
            r"found no rows.*found '8\.1200000000\dE\+10', expected a whole number .*spreadsheet",
        ),
        (edited, "found no rows.*was the table edited"),
        ([line.rpartition(",")[0] for line in rounded], r"2: t_ns: found '8\.12.* spreadsheet"),
    ):
        path.write_text("\n".join(lines) + "\n")
        with pytest.raises(ConfigError, match=said):
            read_table(path)


def test_times_in_another_unit_are_said_and_the_frames_read(tmp_path: Path) -> None:
    path = tmp_path / "frames.csv"
    path.write_text(PLAIN + "".join(f"{k}.png,{k * 33},,,,,,,\n" for k in range(9)))
    table = read_table(path)
    assert len(table) == 9
    assert table.damage == (
        f"{path}: t_ns: found frames 33 ns apart, expected at least 100000 ns: are the times in ms?"
    )
    path.write_text(PLAIN + "0.png,0.5,,,,,,,\n")
    with pytest.raises(ConfigError, match=r"2: t_ns: found '0\.5', .* are the times in s\?"):
        read_table(path)
