"""What the site has beside the pages of this folder, and where links that leave it lead.

Hooks of MkDocs (https://www.mkdocs.org/user-guide/configuration/#hooks). In a checkout all links
are paths. On the site, README and its neighbours are pages too, and a link to source code is its
path.
"""

from __future__ import annotations

import posixpath
import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parent.parent
OUTSIDE = {
    "README.md": "index.md",
    "CONTRIBUTING.md": "contributing.md",
    "SECURITY.md": "security.md",
    "CHANGELOG.md": "changelog.md",
    "deploy/README.md": "deployment.md",
}
"""Pages that stand elsewhere in the repository, and what they are called on the site."""
LINK = re.compile(r"(?<=\]\()(?P<target>[^)\s]+)(?=\))")
NAMED = re.compile(r"\[(?P<text>[^\]]+)\]\((?P<target>[^)\s]+)\)")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that stand elsewhere."""
    for path, name in OUTSIDE.items():
        files.append(File.generated(config, name, content=(ROOT / path).read_text()))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:  # noqa: ARG001 - MkDocs gives them
    """Turn links between places of the repository into links between pages of the site."""
    name = page.file.src_uri
    place = next((path for path, there in OUTSIDE.items() if there == name), f"docs/{name}")
    return NAMED.sub(lambda match: _link(match["text"], match["target"], place, name), markdown)


def _link(text: str, target: str, place: str, name: str) -> str:
    """One link of the page ``name``, which stands at ``place`` in the repository."""
    if re.match(r"[a-z]+:|#", target):
        return f"[{text}]({target})"
    path, mark, part = target.partition("#")
    there = posixpath.normpath(posixpath.join(posixpath.dirname(place), path))
    if there in OUTSIDE:
        on_site = OUTSIDE[there]
    elif there.startswith("docs/"):
        on_site = there.removeprefix("docs/")
    else:
        return text if text.strip("`") == there else f"{text} (`{there}`)"
    return f"[{text}]({posixpath.relpath(on_site, posixpath.dirname(name) or '.')}{mark}{part})"
