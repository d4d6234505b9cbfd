"""``report.html``: a table beside the paper's, with its pictures."""

import base64
from collections.abc import Mapping, Sequence
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined

from benchmarks.paper.grid import Table, load_paper
from benchmarks.paper.plots import draw_charts
from benchmarks.paper.results import HIDING, SEEDS_FOR_A_VERDICT, CellResult, Summary
from benchmarks.paper.style import encoder_title

PICTURE_FOLDER = "pictures"


def write_report(out: Path, table: Table, results: Sequence[CellResult], work: Path) -> None:
    """Write the report of ``table``, which holds its pictures; they stand beside it, too.

    Args:
        out: folder, made if it is not there.
        table: is reported.
        results: its finished cells, perhaps none.
        work: folder of the cells.
    """
    folder = out / PICTURE_FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    summary = Summary(table, results)
    charts = draw_charts(folder, summary, work) if results else []
    environment = Environment(
        loader=PackageLoader("benchmarks.paper"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["signed"] = lambda value: f"{value:+.1f}".replace("-", "−")
    environment.filters["encoder"] = encoder_title
    environment.filters["shares"] = _shares
    context = {
        "table": table,
        "summary": summary,
        "paper": load_paper(),
        "has_paper": any(e.paper is not None for row in summary.rows for e in summary.entries(row)),
        "commands": dict.fromkeys(result.origin.command for result in results),
        "commits": dict.fromkeys(result.origin.commit for result in results),
        "machines": dict.fromkeys(result.origin.machine for result in results),
        "seeds": SEEDS_FOR_A_VERDICT,
    }
    pictures = [(_inline(folder / name), caption) for name, caption in charts]
    text = environment.get_template("report.html.jinja").render(context, pictures=pictures)
    (out / "report.html").write_text(text)


def _shares(hiding: Mapping[str, float]) -> str:
    """Return percents of a mask, each with that of random masks in brackets."""
    names = [name for name in HIDING if name in hiding]
    return ", ".join(f"{100 * hiding[n]:.0f} ({100 * hiding[f'random_{n}']:.0f})" for n in names)


def _inline(path: Path) -> str:
    return "data:image/png;base64," + base64.b64encode(path.read_bytes()).decode()
