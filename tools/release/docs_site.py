"""The settings and links that MkDocs cannot derive from docs/:
mkdocs.yml names this file as its hook.

The pages read as plain files too, on a forge or in an editor. So links to files outside docs/ are
relative there, and become addresses in the repository here; anchors are those that a forge makes of
headings.
"""

from __future__ import annotations

import logging
import os
import re
import tomllib
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
LOG = logging.getLogger("mkdocs.hooks.docs_site")
"""Below MkDocs' own logger, so that a warning fails a strict build."""
_LINK = re.compile(r"(?<!!)\[([^\]]*)\]\((?![a-z]+:)([^)\s#]+)(#[^)\s]*)?\)")


def slug(heading: str, separator: str = "-") -> str:
    """The anchor of a heading, as GitHub makes it."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", separator)


def pages_of(folder: str, docs: Path = DOCS) -> list[str]:
    """The pages of a folder that mkdocs.yml names as a whole, its README first."""
    pages = sorted(
        (docs / folder).glob("*.md"), key=lambda page: (page.name != "README.md", page.name)
    )
    return [page.relative_to(docs).as_posix() for page in pages]


def expand(nav: Any, docs: Path = DOCS) -> Any:
    """`nav` with each folder replaced by its pages."""
    if isinstance(nav, list):
        return [expand(entry, docs) for entry in nav]
    if isinstance(nav, dict):
        return {title: expand(entry, docs) for title, entry in nav.items()}
    return pages_of(nav, docs) if nav.endswith("/") else nav


def outside_links(markdown: str, page: Path, repository: str) -> str:
    """`markdown` with links to files outside docs/ turned into addresses,
    or into their text without an address.

    A folder within docs/ counts as outside: the site has no page for it.
    """

    def rewritten(link: re.Match[str]) -> str:
        text, target, anchor = link[1], link[2], link[3] or ""
        file = Path(os.path.normpath(page.parent / target))
        if file.is_relative_to(DOCS) and not file.is_dir():
            return link[0]
        if not file.is_relative_to(ROOT) or not file.exists():
            LOG.warning("%s links to %s, which is not there", page.relative_to(ROOT), target)
            return link[0]
        if not repository:
            return text
        kind = "tree" if file.is_dir() else "blob"
        return f"[{text}]({repository}/{kind}/main/{file.relative_to(ROOT)}{anchor})"

    return _LINK.sub(rewritten, markdown)


def repository_url() -> str:
    """The address that pyproject.toml states; empty if it states none."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return str(project.get("urls", {}).get("Repository", "")).rstrip("/")


def on_config(config: Any) -> Any:
    """MkDocs' event: the settings that are computed."""
    config.nav = expand(config.nav)
    config.repo_url = repository_url() or None
    config.mdx_configs.setdefault("toc", {})["slugify"] = slug
    return config


def on_page_markdown(markdown: str, *, page: Any, **_: Any) -> str:
    """MkDocs' event: a page before it is rendered."""
    return outside_links(markdown, Path(page.file.abs_src_path), repository_url())
