"""What an index is given: every distribution of the last commit, under the number of its tag."""

from __future__ import annotations

import email
import re
import shutil
import subprocess
import zipfile
from importlib.util import find_spec
from pathlib import Path

import pytest

from tools.release import distributions
from tools.release.distributions import absolute

ADDRESS = "https://example.org/one"


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ("[a](docs/a.md#b)", f"[a]({ADDRESS}/blob/v1/docs/a.md#b)"),
        ("![a](docs/a.png)", f"![a]({ADDRESS}/raw/v1/docs/a.png)"),
        ("[![a](a.png)](docs/a.md)", f"[![a]({ADDRESS}/raw/v1/a.png)]({ADDRESS}/blob/v1/docs/a.md)"),
        ('<img src="a.webp">', f'<img src="{ADDRESS}/raw/v1/a.webp">'),
        ('<a href="a.md">', f'<a href="{ADDRESS}/blob/v1/a.md">'),
        ("[a](#here)", "[a](#here)"),
        ("[a](https://example.org)", "[a](https://example.org)"),
    ],
)
def test_links_of_a_readme_lead_into_the_repository(given: str, expected: str) -> None:
    assert absolute(given, ".", ADDRESS, "v1") == expected


def test_links_of_a_readme_in_a_folder_start_there() -> None:
    assert absolute("[a](../docs/a.md) [b](b.md)", "client", ADDRESS, "v1") == (
        f"[a]({ADDRESS}/blob/v1/docs/a.md) [b]({ADDRESS}/blob/v1/client/b.md)"
    )


def test_an_address_is_expected(tmp_path: Path) -> None:
    (tmp_path / "pyproject.toml").write_text('[project.urls]\nRepository = "REPOSITORY_URL"\n')
    with pytest.raises(ValueError, match="Repository: found REPOSITORY_URL, expected an address"):
        distributions.repository(tmp_path)


@pytest.mark.slow
@pytest.mark.skipif(
    find_spec("uv") is None or find_spec("hatchling") is None, reason="uv or hatchling is not installed"
)
@pytest.mark.skipif(shutil.which("git") is None, reason="git is not installed")
def test_every_distribution_of_a_tag(tmp_path: Path) -> None:
    tree = tmp_path / "tree"
    subprocess.run(("git", "clone", "--quiet", str(distributions.TREE), str(tree)), check=True)
    project = tree / "pyproject.toml"
    project.write_text(re.sub("(?m)^Repository = .*$", f'Repository = "{ADDRESS}"', project.read_text()))
    git = ("git", "-C", str(tree), "-c", "user.name=a", "-c", "user.email=a@b")
    subprocess.run((*git, "commit", "--quiet", "--all", "-m", "Release"), check=True)
    subprocess.run((*git, "tag", "-am", "release", "v71.2.3"), check=True)
    files = distributions.build(tree, tmp_path / "out")
    assert {"tacshade_edge-71.2.3-py3-none-any.whl", "tacshade_edge-71.2.3.tar.gz"} <= {path.name for path in files}
    wheels = {path.name.partition("-")[0] for path in files if path.suffix == ".whl"}
    assert len(wheels) == len(distributions.projects(tree))
    with zipfile.ZipFile(tmp_path / "out/tacshade_edge-71.2.3-py3-none-any.whl") as wheel:
        about = email.message_from_bytes(wheel.read("tacshade_edge-71.2.3.dist-info/METADATA"))
    assert "/blob/v71.2.3/docs/" in str(about.get_payload())
    assert "](docs/" not in str(about.get_payload())
    found = subprocess.run((*distributions.TWINE[:-2], "--version"), capture_output=True, text=True, check=False)
    if found.returncode:
        pytest.skip(f"built, but twine cannot be fetched here: {found.stderr.strip()[-200:]}")
    distributions.check(files)
