"""Do the tests of a room notice when one of its modules is wrong?

A seeded sample of small edits of the product is drawn, evenly over the subjects, and each is tried
on the tests of its own room alone. Run it again and it goes on where it was stopped.

    python -m tests.mutation --count 100 --seed 1 --figures benchmarks/results/house.json
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import typer
from benchmarks.figures import check_record, record_figures

from .operators import Mutant
from .report import BAR, Report
from .results import Result, append_result, read_results
from .runner import Copy, Runner, digest, list_files
from .sample import draw, mutants_of, read_equivalents
from .subjects import SUBJECTS, Subject, check_subjects

ROOT = Path(__file__).resolve().parents[2]


def main(
    *,
    count: Annotated[int, typer.Option(min=1, help="Mutants of all subjects together.")] = 100,
    seed: Annotated[int, typer.Option(help="Another one draws other mutants.")] = 1,
    workers: Annotated[int, typer.Option(min=1, help="Mutants tried at the same time.")] = 2,
    subjects: Annotated[str, typer.Option(help="Names, by commas; all by default.")] = "",
    out: Annotated[Path, typer.Option(help="Folder of results and report.")] = Path(
        "build/mutants"
    ),
    figures: Annotated[Path | None, typer.Option(help="Record to write the share into.")] = None,
) -> None:
    """Draw mutants, try them, and say which ones live; status 1 if too many do."""
    if figures is not None:
        check_record(figures)
        if subjects:
            raise typer.BadParameter("the figure is of all subjects: use --subjects without it")
    chosen = choose(subjects)
    check_subjects(ROOT, chosen)
    drawn = draw({subject: mutants_of(subject, ROOT) for subject in chosen}, count, seed)
    results = try_all(drawn, workers, out / "results.jsonl")
    report = Report(results, read_equivalents(), seed)
    out.mkdir(parents=True, exist_ok=True)
    (out / "report.md").write_text(report.render())
    typer.echo(report.render(), nl=False)
    if figures is not None:
        command = ["python", "-m", "tests.mutation", *sys.argv[1:]]
        record_figures(figures, {"mutants_killed_by_room": round(report.share, 3)}, command)
    if report.share < BAR:
        raise SystemExit(1)


def choose(names: str) -> tuple[Subject, ...]:
    """Subjects by name, all for none; refuse an unknown one."""
    wanted = [name.strip() for name in names.split(",") if name.strip()]
    known = {subject.name: subject for subject in SUBJECTS}
    for name in wanted:
        if name not in known:
            raise typer.BadParameter(f"{name!r} is unknown: use some of {', '.join(known)}")
    return tuple(known[name] for name in wanted) or SUBJECTS


def try_all(drawn: Mapping[Subject, Sequence[Mutant]], workers: int, path: Path) -> list[Result]:
    """Results of all mutants, in their order; those that the file at ``path`` has are kept."""
    files = list_files(ROOT)
    tree = digest(ROOT, files)
    found = {(result.subject, result.mutant): result for result in read_results(path, tree)}
    todo = {
        subject: [mutant for mutant in mutants if (subject.name, mutant) not in found]
        for subject, mutants in drawn.items()
    }
    left = sum(map(len, todo.values()))
    with tempfile.TemporaryDirectory() as folder:
        copies = [Copy.make(ROOT, files, Path(folder, str(index))) for index in range(workers)]
        for result in Runner(copies, tree).run(todo):
            append_result(path, result)
            found[result.subject, result.mutant] = result
            left -= 1
            mutant = result.mutant
            typer.echo(f"{left} left: {mutant.file}:{mutant.line} {result.outcome}", err=True)
    return [found[subject.name, mutant] for subject in drawn for mutant in drawn[subject]]


if __name__ == "__main__":
    typer.run(main)
