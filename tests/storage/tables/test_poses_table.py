from pathlib import Path

import numpy as np
import pytest

from tacshade_edge.errors import ConfigError
from tacshade_edge.storage.tables.frame_table import HEADER, read_poses


def table(tmp_path: Path, *lines: str) -> Path:
    path = tmp_path / "POSES.csv"
    path.write_text("\n".join((",".join(HEADER), *lines)) + "\n")
    return path


def test_lines_become_poses(tmp_path: Path) -> None:
    one, other = read_poses(table(tmp_path, "a.png,1,2,3,1,0,0,0", "sub/b.png,-1.5,0,0,0,1.004,0,0"))
    assert one.path == tmp_path / "a.png"
    assert other.path == tmp_path / "sub" / "b.png"
    assert other.where.endswith("POSES.csv:3")
    np.testing.assert_allclose(one.base_T_flange.apply(np.zeros(3)), (1, 2, 3))
    np.testing.assert_allclose(other.base_T_flange.apply(np.array((0, 0, 1))), (-1.5, 0, -1), atol=1e-12)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("a.png,1,2,3,1,0,0", "found 7 columns, expected 8"),
        ("a.png,1,2,x,1,0,0,0", "z_mm: found 'x', expected a number"),
        ("a.png,1,2,nan,1,0,0,0", "z_mm: found 'nan'"),
        ("a.png,1,2,3,0,0,0,0", "found a quaternion of length 0, expected length 1"),
        ("a.png,1,2,3,1,1,0,0", "found a quaternion of length 1.414, expected length 1"),
        (",1,2,3,1,0,0,0", "image: found nothing"),
    ],
)
def test_mistakes_name_the_line(tmp_path: Path, line: str, message: str) -> None:
    with pytest.raises(ConfigError, match=r"POSES\.csv:2") as error:
        read_poses(table(tmp_path, line))
    assert message in str(error.value)


def test_an_empty_table(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="found no rows"):
        read_poses(table(tmp_path))
