"""Row of mutated pictures: each is refused by name or read, by every door, and never does harm.

The table of pictures is tried first. Those of it that can be read are mutated.
"""

from __future__ import annotations

import random
import re
from collections import Counter
from collections.abc import Sequence

import numpy as np
from tests.pictures.doors import DOORS, Doors, open_doors
from tests.pictures.samples import Sample, levels, make_samples
from tests.siege.ground import Ground, Judgement
from tests.siege.mutations import cut, flip, splice

HEADERS = 256  # [bytes]


def renumber(chance: random.Random, data: Sequence[bytes]) -> bytes:
    content = bytearray(chance.choice(data))
    for _ in range(chance.choice((1, 1, 2, 8))):
        place, size = chance.randrange(min(len(content), HEADERS)), chance.choice((1, 2, 4))
        value = chance.choice((0, 1, 127, 255, 2**15, 2**31 - 1, 2**32 - 1)) % 256**size
        content[place : place + size] = value.to_bytes(size, chance.choice(("big", "little")))
    return bytes(content)


def mutated(seed: int, samples: Sequence[Sample]) -> tuple[str, bytes]:
    chance, sample = random.Random(seed), samples[seed % len(samples)]
    mutation = chance.choice((flip, cut, splice, renumber, renumber))
    data = [sample.content, *([chance.choice(samples).content] if mutation is splice else ())]
    return sample.name, mutation(chance, data)


def fault_of(found: object) -> str | None:
    if isinstance(found, str):
        told = "UNNAMED" not in found and "Traceback" not in found and "\n" not in found
        return None if found and told else f"refused so: {found[:200]}"
    values = np.asarray(found)
    whole = values.ndim == 2 and bool(((values >= 0) & (values <= 1)).all())
    return None if whole else "read as what is no picture"


def try_all(doors: Doors, count: int, samples: Sequence[Sample]) -> tuple[Counter[str], list[str]]:
    outcomes, failures = Counter[str](), list[str]()
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


def holds(sample: Sample, found: object) -> bool:
    if isinstance(found, str):
        return bool(sample.refusal and re.search(sample.refusal, found))
    shown = levels(np.asarray(found))
    return not sample.refusal and np.allclose(shown, sample.levels, atol=sample.tolerance)


async def fuzzed(ground: Ground, judgement: Judgement) -> None:
    samples, folder = make_samples(), ground.folder / "picture-fuzz"
    folder.mkdir()
    readable, count = [each for each in samples if not each.refusal], ground.extent.pictures
    with open_doors(folder) as doors:
        tried = [
            (f"{sample.name} by {door}", holds(sample, doors(door, sample.name, sample.content)))
            for sample in samples
            for door in DOORS
        ]
        outcomes, failures = try_all(doors, count, readable)
    wrong = [name for name, true in tried if not true]
    judgement.none(f"wrong of {len(tried)} rows of the table", wrong)
    judgement.figures["picture_table_rows"] = len(tried) - len(wrong)
    judgement.none(f"failures of {count} files", failures, "picture_fuzz_failures")
    for result in ("read", "refused"):
        judgement.at_least(result, outcomes[result], 1)
