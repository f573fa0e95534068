from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tacshade_edge.requirements import missing_requirements


@pytest.mark.parametrize(
    ("requirement", "said"),
    [
        ("numpy>=1.20", None),
        ("numpy (>=1.20)", None),
        ("numpy[extra]>=1.20,<99", None),
        ("numpy~=1.99; python_version < '3'", None),  # a marker is pip's
        ("numpy<1.2", f"numpy: found {np.__version__} in "),
        ("numpy==0.*", f"numpy: found {np.__version__} in "),
        ("no-such-package>=2", "no-such-package: found no such package, expected >=2"),
        ("no-such-package", "no-such-package: found no such package, expected any version"),
        ("another==1.0.0", None),  # 1.0 is the same
        ("another!=1.*", "another: found 1.0 in "),
        ("another~=1.1", "another: found 1.0 in "),
        ("broken", "broken: cannot import broken: RuntimeError: no licence"),
        ("older>=2", "older: found older 1.9 at "),  # its metadata say 2.0
    ],
)
def test_a_package_in_the_place_of_another_is_named(
    requirement: str, said: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, version, text in (
        ("program", "1.0", ""),
        ("another", "1.0", ""),
        ("broken", "1.0", "raise RuntimeError('no licence')"),
        ("older", "2.0", "__version__ = '1.9'"),
    ):
        (tmp_path / f"{name}.py").write_text(text)
        stated = tmp_path / f"{name}-{version}.dist-info"
        stated.mkdir()
        needs = f"Requires-Dist: {requirement}\n" if name == "program" else ""
        (stated / "METADATA").write_text(
            f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n{needs}"
        )
    monkeypatch.syspath_prepend(str(tmp_path))
    lines = missing_requirements("program")
    assert [line[: len(said or "")] for line in lines] == ([said] if said else [])


def test_a_tree_that_was_not_installed_states_nothing() -> None:
    assert missing_requirements("no-such-program") == ()
