from __future__ import annotations

from pathlib import Path

import pytest

from tacshade_edge.errors import DeviceError
from tacshade_edge.storage.atomic_files import disk_errors, part, sync, write_whole


@pytest.mark.parametrize("wait", [True, False])
def test_a_file_is_replaced_whole(tmp_path: Path, wait: bool) -> None:
    path = tmp_path / "a.json"
    for data in (b"one", b"two"):
        write_whole(path, data, sync=wait)
        assert path.read_bytes() == data
    sync(path)
    sync(tmp_path)
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_that_cannot_be_written_leaves_nothing_and_is_named(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    with pytest.raises(DeviceError, match=r"a.*: cannot write it: Is a directory"), disk_errors(tmp_path):
        write_whole(tmp_path / "a", b"data")  # written beside, and then not to be renamed
    assert not part(tmp_path / "a").exists()
    with pytest.raises(DeviceError, match=r"none: cannot write it: No such file"), disk_errors(tmp_path):
        sync(tmp_path / "none")
    with pytest.raises(DeviceError, match=rf"^{tmp_path}: cannot write it: no name"), disk_errors(tmp_path):
        raise OSError("no name")
