"""The clear part of answers: whether its sizes and bytes tell two scenes apart."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime
from functools import partial
from zlib import crc32

import numpy as np
import numpy.typing as npt
import torch
from benchmarks.privacy.keys.plant import Answer
from pydantic import JsonValue
from scipy.stats import ks_2samp

from veilcam_training.attacks.intervals import ALPHA, Gain
from veilcam_training.attacks.keyless import cross_fit, presence_gain
from veilcam_training.attacks.networks import (
    TRIALS,
    Attacker,
    best_of,
    by_neighbours,
    by_network,
    linear,
    perceptron,
)

HIDDEN = ("embedding.values", "embedding.block", "key", "signature")
"""Ends of the names of what is no clear part; their sizes are."""
_FIRST = 24
"""Bytes of a field that are columns of their own."""

Columns = dict[str, npt.NDArray[np.float64]]


def clear_fields(answer: Answer) -> dict[str, str]:
    """Every clear field of an answer by name; of hidden ones their size."""
    fields = {f"header {number} name": name for number, (name, _) in enumerate(answer.headers)}
    fields |= {f"header {name}": value for name, value in answer.headers}
    fields["body size"] = str(len(answer.body))
    fields |= dict(_leaves("", json.loads(answer.body)))
    return fields


def _leaves(name: str, value: JsonValue) -> Iterator[tuple[str, str]]:
    if name.endswith(HIDDEN):
        yield f"{name} size", str(len(json.dumps(value)))
    elif isinstance(value, Mapping):
        yield f"{name} names", " ".join(value)
        for each, inner in value.items():
            yield from _leaves(f"{name}.{each}" if name else each, inner)
    elif isinstance(value, list):
        yield f"{name} size", str(len(value))
        for number, inner in enumerate(value):
            yield from _leaves(f"{name}.{number}", inner)
    else:
        yield name, json.dumps(value)


def columns(answers: Sequence[Answer]) -> Columns:
    """Numbers that answers differ in, by name: (answers,) each.

    Of each field: whether it is there, its size, its value as a number, its first bytes; and how
    often each byte comes in the whole clear part.
    """
    fields = [clear_fields(answer) for answer in answers]
    names = sorted(set().union(*fields))
    made: Columns = {}
    for name in names:
        texts = [each.get(name) for each in fields]
        made[f"{name}: there"] = np.array([text is not None for text in texts], np.float64)
        present = [text or "" for text in texts]
        made[f"{name}: size"] = np.array([len(text) for text in present], np.float64)
        made[f"{name}: value"] = np.array([_number(text) for text in present])
        padded = [text.encode()[:_FIRST].ljust(_FIRST, b"\0") for text in present]
        for place, values in enumerate(np.array([list(text) for text in padded], np.float64).T):
            made[f"{name}: byte {place}"] = values
    clear = ["\n".join(each.values()).encode() for each in fields]
    counts = np.stack([np.bincount(np.frombuffer(text, np.uint8), minlength=256) for text in clear])
    made |= {f"byte {each}: count": counts[:, each].astype(np.float64) for each in range(256)}
    return {name: values for name, values in made.items() if np.ptp(values) > 0}


def _number(text: str) -> float:
    """A text as a number: of what it says, or else of what it is."""
    plain = text.strip('"')
    if re.fullmatch("[0-9a-f]{16,}", plain):
        return float(int(plain[:12], 16))
    for read in (float, lambda said: datetime.fromisoformat(said).timestamp()):
        try:
            return read(plain)
        except ValueError:
            continue
    return float(crc32(plain.encode()))


def differences(made: Columns, labels: npt.NDArray[np.int64], alpha: float = ALPHA) -> list[str]:
    """Names of columns whose distributions differ (Kolmogorov and Smirnov; Holm's procedure)."""
    doubts = {
        name: float(ks_2samp(values[labels == 0], values[labels == 1], method="asymp").pvalue)
        for name, values in made.items()
    }
    found = []
    for place, name in enumerate(sorted(doubts, key=doubts.__getitem__)):
        if doubts[name] > alpha / (len(doubts) - place):
            break
        found.append(name)
    return found


def clear_part_gain(
    made: Columns, labels: npt.NDArray[np.int64], *, epochs: int, seed: int
) -> Gain:
    """What the best of several trained classifiers makes of the columns, over all answers."""
    table = np.stack([*made.values(), np.zeros(len(labels))], axis=1)
    spread = table.std(axis=0)
    table = (table - table.mean(axis=0)) / np.where(spread > 0, spread, 1)
    vectors = torch.from_numpy(table.astype(np.float32))[:, None]
    answers = torch.from_numpy(labels)[:, None]
    scores, folds = cross_fit(_classifier(epochs), vectors, answers, 2, seed=seed)
    return presence_gain(scores, answers, folds)


def _classifier(epochs: int) -> Attacker:
    neighbours: list[Attacker] = [
        partial(by_neighbours, count=count, distances=True) for count in (10, 100)
    ]
    networks: list[Attacker] = [
        partial(by_network, build=build, trial=trial, epochs=epochs)
        for build in (linear, perceptron)
        for trial in TRIALS
    ]
    return best_of([*neighbours, *networks])
