"""The pages with tables, and their text with the tables replaced."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from benchmarks.tables.attacks import ATTRIBUTES, CONVEX, CONVEX_BESIDE, GENERATOR
from benchmarks.tables.camera import CALIBRATED, SERVED, fills
from benchmarks.tables.cells import CELLS_READ, OWN_PICTURES
from benchmarks.tables.checks import CHECKS
from benchmarks.tables.deploy import DEPLOYED, SIMULATED
from benchmarks.tables.light import HONESTY, LIMIT, TOLERANCE
from benchmarks.tables.masks import FRESH, HIDING, REFUSED, RELEASED, TIMES
from benchmarks.tables.overview import DAEMON, HEADLINES, LIGHT, TRAINED, UNUSED
from benchmarks.tables.paper import paper_table, scores
from benchmarks.tables.privacy import learned
from benchmarks.tables.table import Figures, table
from benchmarks.tables.threats import CAPTURE_LOG, CARD_TIME, GUARD, KEYS, MORE_KEYS, SIEGE, cards
from benchmarks.tables.watch import BELIEF

BEGIN, END = "<!-- figures -->\n", "<!-- end of figures -->"

PAGES: dict[str, list[Figures | Callable[[], str]]] = {
    "CONTRIBUTING.md": [CHECKS],
    "README.md": [HIDING, HEADLINES],
    "deploy/README.md": [DEPLOYED, SIMULATED],
    "docs/figures.md": [
        TRAINED | CELLS_READ | OWN_PICTURES,
        LIGHT,
        UNUSED,
        KEYS | MORE_KEYS | CAPTURE_LOG,
        DAEMON,
    ],
    "docs/accuracy.md": [LIMIT, TOLERANCE],
    "docs/effects.md": [HONESTY],
    "docs/privacy-card.md": [cards, CARD_TIME],
    "docs/attacks.md": [CONVEX, CONVEX_BESIDE, GENERATOR, ATTRIBUTES],
    "docs/bundle.md": [REFUSED],
    "docs/device.md": [fills],
    "docs/fresh-masks.md": [FRESH, RELEASED, TIMES],
    "docs/privacy.md": [learned],
    "docs/proof.md": [GUARD],
    "docs/siege.md": [SIEGE],
    "docs/calibration.md": [SERVED, CALIBRATED],
    "docs/tables/README.md": [
        scores,
        *(
            partial(paper_table, name)
            for name in ("mnist", "fashion", "robust", "faces", "cifar10")
        ),
    ],
    "docs/watch.md": [BELIEF],
}
"""The tables of each page, from top to bottom."""


def with_tables(name: str, page: str) -> str:
    """The text of page ``name`` with its tables replaced."""
    first, *parts = page.split(BEGIN)
    tables = PAGES[name]
    if len(parts) != len(tables):
        raise ValueError(f"{name} has {len(parts)} tables, not {len(tables)}")
    for shown, part in zip(tables, parts, strict=True):
        first += BEGIN + (shown() if callable(shown) else table(shown)) + END + part.split(END)[1]
    return first
