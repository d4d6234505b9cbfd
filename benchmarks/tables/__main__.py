"""Write the tables of figures in README and docs, and the daemon's: they cannot go stale.

``python -m benchmarks.tables``
"""

from __future__ import annotations

from benchmarks.tables import privacy
from benchmarks.tables.pages import PAGES, with_tables
from benchmarks.tables.table import ROOT


def main() -> None:
    """Rewrite the pages, and the daemon's module of figures."""
    privacy.MODULE.write_text(privacy.module())
    for name in PAGES:
        path = ROOT / name
        path.write_text(with_tables(name, path.read_text()))


if __name__ == "__main__":
    main()
