"""Mutants of the product: small edits that the tests of a room must notice. Cosmic Ray makes them.

    python -m tests.mutants --count 100 --seed 1 --out build/mutants.json
    python -m tests.mutants --given build/mutants.json --tree TREE --out build/there.json

A stopped run goes on where its own result is given: ``--given`` and ``--out`` are the same then.
"""

from __future__ import annotations

import json
import os
import queue
import random
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter, defaultdict
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import typer
from attrs import evolve
from cosmic_ray import plugins
from cosmic_ray.ast import ast_nodes, get_ast_from_path
from cosmic_ray.ast.ast_query import ASTQuery
from cosmic_ray.config import load_config
from cosmic_ray.modules import filter_paths, find_modules
from cosmic_ray.mutating import mutate_and_test
from cosmic_ray.testing import run_tests
from cosmic_ray.work_item import MutationSpec, TestOutcome

ROOT = Path(__file__).resolve().parents[1]
CONFIG = load_config(str(ROOT / "cosmic-ray.toml"))
EQUIVALENT = [{key: each[key] for key in each if key != "reason"} for each in CONFIG["equivalent"]]
Mutant: TypeAlias = dict[str, Any]
"""``file``, ``line``, ``definition`` (its function or class), ``operator``, ``before`` (text of the
line) and ``number`` (among the file's mutants with this operator and text); once tried also
``outcome`` and ``after``."""


def modules(tree: Path) -> list[str]:
    """Return the product's files under ``tree``, relative to it."""
    found = find_modules([tree / path for path in CONFIG["module-path"]])
    kept = filter_paths(found, [f"{tree}/{glob}" for glob in CONFIG["excluded-modules"]])
    return sorted(str(path.relative_to(tree)) for path in kept)


def mutants_of(tree: Path, file: str) -> list[tuple[Mutant, MutationSpec]]:
    """Return the mutants of a file, each with Cosmic Ray's own description of it."""
    path, found, seen = tree / file, [], Counter[tuple[str, str]]()
    excluded = re.compile("|".join(CONFIG["filters"]["operators-filter"]["exclude-operators"]))
    lines, nodes = path.read_text().splitlines(), list(ast_nodes(get_ast_from_path(path)))
    for name in plugins.operator_names():
        if excluded.match(name) or (operator := plugins.get_operator(name)).arguments():
            continue
        places = ((node, at) for node in nodes for at in operator().mutation_positions(node))
        for occurrence, (node, (start, end)) in enumerate(places):
            before, definition = lines[start[0] - 1].strip(), ASTQuery(node).get_definition_name()
            mutant = {"file": file, "line": start[0], "definition": definition, "operator": name}
            mutant |= {"before": before, "number": seen[name, before]}
            seen[name, before] += 1
            if not (before.startswith("@") or any(e.items() <= mutant.items() for e in EQUIVALENT)):
                found.append((mutant, MutationSpec(file, name, occurrence, start, end)))
    return found


def draw(tree: Path, files: list[str], count: int, seed: int) -> list[Mutant]:
    """Draw ``count`` places of the files, and for each of them one mutant."""
    places = defaultdict(list)
    for mutant, spec in (each for file in files for each in mutants_of(tree, file)):
        places[mutant["file"], spec.start_pos].append(mutant)
    generator = random.Random(seed)
    drawn = generator.sample(sorted(places), min(count, len(places)))
    return [generator.choice(places[place]) for place in sorted(drawn)]


def judges_of(tree: Path, file: str) -> tuple[str, ...]:
    """Return the test files of a module's room, or of the room around it where that has none.

    The room's folder may stand anywhere below ``tests``.
    """
    room = [Path(file).parts[1].removeprefix("veilcam_"), *Path(file).parts[2:-1]]
    for depth in range(len(room), 0, -1):
        folders = (tree / "tests").rglob("/".join(room[:depth]))
        if tests := {test for folder in folders for test in folder.glob("test_*.py")}:
            return tuple(sorted(str(test.relative_to(tree)) for test in tests))
    return ()


def locate(mutant: Mutant, tree: Path) -> MutationSpec | None:
    """Return the same edit in ``tree``: in its file, or where its function stands now."""
    known = {each: mutant[each] for each in ("operator", "before", "number")}
    moved = {each: mutant[each] for each in ("operator", "before", "definition")}
    for file in sorted(modules(tree), key=lambda file: file != mutant["file"]):
        if mutant["before"] in (tree / file).read_text():
            for there, spec in mutants_of(tree, file):
                if (known if file == mutant["file"] else moved).items() <= there.items():
                    return spec
    return None


def copy(tree: Path, target: Path) -> Path:
    """Copy the files of ``tree`` that git does not ignore, and return where they are now."""
    told = ["git", "-C", str(tree), "ls-files", "-z", "-co", "--exclude-standard"]
    for name in subprocess.run(told, check=True, capture_output=True, text=True).stdout.split("\0"):
        if (tree / name).is_file():
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(tree / name, target / name)
    compiled = [sys.executable, "-m", "compileall", "-q", *CONFIG["module-path"]]
    subprocess.run(compiled, check=True, cwd=target)
    return target


def command(tree: Path, tests: tuple[str, ...], first: str = "") -> str:
    """Return the command that runs ``tests``, those named ``first`` before the others."""
    tests = tuple(sorted(tests, key=lambda test: first not in test))
    packages = os.pathsep.join(str((tree / path).parent) for path in CONFIG["module-path"])
    pytest = Path(sys.executable).with_name(CONFIG.test_command)
    # Without a pipe that a forgotten child of a test could hold open.
    told = shlex.quote(f"exec {pytest} {shlex.join(tests)} >/dev/null 2>&1")
    return f"env -C {tree} PYTHONPATH={packages} OMP_NUM_THREADS=1 sh -c {told}"


def judge(tree: Path, tests: tuple[str, ...], specs: list[MutationSpec]) -> list[Mutant]:
    """Return what a room's tests say of each edit of ``tree``: killed, survived, or no verdict."""
    if not tests:
        return [{"outcome": "no tests"} for _ in specs]
    begun, found = time.monotonic(), []
    if run_tests(command(tree, tests), CONFIG.timeout)[0] is not TestOutcome.SURVIVED:
        return [{"outcome": "tests fail on the original"} for _ in specs]
    limit = 60 + 3 * (time.monotonic() - begun)
    for spec in specs:
        told = command(tree, tests, first=f"test_{spec.module_path.stem}")
        there = evolve(spec, module_path=tree / spec.module_path)
        result = mutate_and_test([there], told, limit)
        after = re.findall(r"^\+(?!\+\+)(.*)$", result.diff or "", re.MULTILINE)
        found.append({"after": " ".join(after).strip(), "outcome": result.test_outcome.value})
        typer.echo(f"{spec.module_path}:{spec.start_pos[0]} {result.test_outcome.value}")
    return found


def main(
    *,
    count: Annotated[int, typer.Option(min=1, help="Mutants to draw.")] = 100,
    seed: Annotated[int, typer.Option(help="Another one draws other mutants.")] = 1,
    given: Annotated[Path | None, typer.Option(help="File of mutants; none are drawn.")] = None,
    tree: Annotated[Path, typer.Option(help="Repository whose tests judge.")] = ROOT,
    workers: Annotated[int, typer.Option(min=1, help="Copies of it that work at once.")] = 2,
    out: Annotated[Path, typer.Option(help="Result.")] = Path("build/mutants.json"),
) -> None:
    """Draw mutants, or take those of a file, and write which of them the tests kill."""
    tree = tree.resolve()
    drawn = json.loads(given.read_text()) if given else draw(tree, modules(tree), count, seed)
    rooms: dict[tuple[str, ...], list[tuple[Mutant, MutationSpec]]] = defaultdict(list)
    settled = ("killed", "survived") if given == out else ()
    for mutant in (each for each in drawn if each.get("outcome") not in settled):
        if spec := locate(mutant, tree):
            rooms[judges_of(tree, str(spec.module_path))].append((mutant, spec))
        else:
            mutant["outcome"] = "gone"
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(workers) as pool:
        idle: queue.SimpleQueue[Path] = queue.SimpleQueue()
        for index in range(workers):
            idle.put(copy(tree, Path(folder, str(index))))

        def judge_room(tests: tuple[str, ...]) -> tuple[tuple[str, ...], list[Mutant]]:
            place = idle.get()
            try:
                return tests, judge(place, tests, [spec for _, spec in rooms[tests]])
            finally:
                idle.put(place)

        for done in as_completed([pool.submit(judge_room, tests) for tests in rooms]):
            tests, verdicts = done.result()
            for (mutant, _), verdict in zip(rooms[tests], verdicts, strict=True):
                mutant.update(verdict)
            out.parent.mkdir(parents=True, exist_ok=True)
            out.write_text(json.dumps(drawn, indent=1))
    outcomes = Counter(mutant["outcome"] for mutant in drawn)
    typer.echo(", ".join(f"{number} {outcome}" for outcome, number in outcomes.items()))


if __name__ == "__main__":
    typer.run(main)
