"""Installing: what messages and pages say works from a checkout."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
FROM_AN_INDEX = re.compile(r"""pip3? install [^\n`]*?(?<![\w./+-])["']?veilcam(?![\w-])""")
"""Veilcam is on no package index."""


def test_installing_from_an_index_is_told_nowhere() -> None:
    listed = subprocess.run(
        ["git", "ls-files", "*.py", "*.md", "*.toml", "*.sh", "*.html", "*.js", "*.service"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    told = []
    for name in listed.stdout.split():
        # A message may go on in the next line of the code.
        text = re.sub(r'"\s*\n\s*f?"', "", (ROOT / name).read_text())
        told += [f"{name}: {found[0]}" for found in FROM_AN_INDEX.finditer(text)]
    assert told == []
    for wrong in ("veilcam", "'veilcam[mqtt]'", "-U veilcam[x]"):
        assert FROM_AN_INDEX.search(f"pip install {wrong}")
    for right in ("-e '.[mqtt]'", "./veilcam-1.whl"):
        assert not FROM_AN_INDEX.search(f"pip install {right}")
