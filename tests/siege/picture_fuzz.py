"""Mutated pictures: each is refused by name or read, by every door, and never does harm.

    python -m tests.siege.picture_fuzz --figures benchmarks/results/first-aid.json

The pictures of the table that can be read are mutated: bits, bytes, pieces, and numbers in
headers. The table itself is tried first.
"""

from __future__ import annotations

import random
import re
from collections import Counter
from typing import Annotated

import numpy as np
import structlog
import typer
from benchmarks.figures import FiguresOption, record
from benchmarks.rig import work_folder
from tests.pictures.doors import DOORS, Doors, open_doors
from tests.pictures.samples import Sample, levels, make_samples


def mutated(seed: int, samples: tuple[Sample, ...]) -> tuple[str, bytes]:
    """Return name and content of a mutated picture, the same for a seed in every run."""
    chance = random.Random(seed)
    sample = samples[seed % len(samples)]
    content = bytearray(sample.content)
    # Half of the changes are where the headers are.
    reach = chance.choice((len(content), min(len(content), 256)))
    kind = chance.randrange(5)
    for _ in range(chance.choice((1, 1, 2, 8, 64))):
        place = chance.randrange(reach)
        if kind == 0:
            content[place] ^= 1 << chance.randrange(8)
        elif kind == 1:
            content[place] = chance.choice((0, 1, 127, 128, 255))
        elif kind == 2:
            number = chance.choice((0, 1, 2**15, 2**31 - 1, 2**32 - 1)).to_bytes(4, "big")
            content[place : place + 4] = number[:: chance.choice((1, -1))]
    other = chance.choice(samples).content
    start, end = sorted(chance.randrange(len(content) + 1) for _ in range(2))
    if kind == 3:
        content = chance.choice(
            (content[:end], content[start:], content[:start] + content[end:], content + content)
        )
    elif kind == 4:
        begin = chance.randrange(len(other))
        content[start:start] = other[begin : begin + chance.randrange(1, 400)]
    return sample.name, bytes(content)


def fault_of(found: object) -> str | None:
    """Return what is wrong with the answer of a door; None if nothing is."""
    if isinstance(found, str):
        told = "UNNAMED" not in found and "Traceback" not in found and "\n" not in found
        return None if found and told else f"refused so: {found[:200]}"
    values = np.asarray(found)
    whole = values.ndim == 2 and bool(((values >= 0) & (values <= 1)).all())
    return None if whole else "read as what is no picture"


def try_all(
    doors: Doors, count: int, samples: tuple[Sample, ...]
) -> tuple[Counter[str], list[str]]:
    """Bring mutated pictures in by every door; return what became of them, and the failures."""
    outcomes, failures = Counter[str](), []
    for seed in range(count):
        name, content = mutated(seed, samples)
        for door in DOORS:
            try:
                found = doors(door, name, content)
                fault = fault_of(found)
                outcomes["refused" if isinstance(found, str) else "read"] += 1
            except Exception as error:
                fault = f"{type(error).__name__}: {str(error)[:200]}"
            if fault is not None:
                failures.append(f"seed {seed} ({name}) by {door}: {fault}")
    return outcomes, failures


def count_rows(doors: Doors, samples: tuple[Sample, ...]) -> int:
    """Return how many rows of the table hold: a sample by a door."""
    held = 0
    for sample in samples:
        for door in DOORS:
            found = doors(door, sample.name, sample.content)
            if isinstance(found, str):
                held += bool(sample.refusal and re.search(sample.refusal, found))
            else:
                held += bool(np.allclose(levels(found), sample.levels, atol=sample.tolerance))
    return held


def main(
    *,
    files: Annotated[int, typer.Option(min=1, help="To make and try.")] = 2000,
    figures: FiguresOption = None,
) -> None:
    """Look for pictures that crash, fail without a name, or are read as what they are not."""
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(50))
    samples = make_samples()
    with work_folder() as work, open_doors(work) as doors:
        rows = count_rows(doors, samples)
        readable = tuple(sample for sample in samples if not sample.refusal)
        outcomes, failures = try_all(doors, files, readable)
    for failure in failures[:20]:
        print(failure)
    counted = ", ".join(f"{count} {outcome}" for outcome, count in outcomes.most_common())
    print(f"{rows} of {len(samples) * len(DOORS)} rows of the table hold")
    print(f"{files} files by {len(DOORS)} doors: {counted}; {len(failures)} failures")
    record(figures, {"picture_fuzz_failures": len(failures), "picture_table_rows": rows})
    if failures or rows < len(samples) * len(DOORS):
        raise SystemExit(1)


if __name__ == "__main__":
    typer.run(main)
