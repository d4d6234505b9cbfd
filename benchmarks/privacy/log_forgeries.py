"""Logs with one record forged: how many of them pass for whole.

    python -m benchmarks.privacy.log_forgeries --figures benchmarks/results/log.json

Every log is written by the daemon's own. In each, one record has one bit flipped, or is dropped, or
changes places with another one. The newest record is not dropped without a head that was kept
elsewhere: nothing else could show that.
"""

from __future__ import annotations

import random
import secrets
import statistics
import tempfile
import time
from datetime import UTC, datetime
from itertools import cycle
from pathlib import Path
from typing import Annotated, TypeAlias

import numpy as np
import typer
from benchmarks.figures import FiguresOption, record
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from veilcam_client.keys.commitments import ID_DIGITS
from veilcam_client.keys.log import line_of, verify_log
from veilcam_client.wire.captures import Capture, Embedding
from veilcam_server.camera.capture import Provenance
from veilcam_server.sealing.identity import DeviceKey
from veilcam_server.security.log import Log
from veilcam_server.service.responses import logged
from veilcam_server.system.state_file import log_fault

SEGMENT, KEPT = 4000, 2
"""Small files, so that some logs begin where the oldest records were dropped [bytes, files]."""
START = datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC)

Forged: TypeAlias = tuple[list[bytes], bytes | None]
"""Lines, and the head that they are checked with."""


class Campaign:
    """Logs of one device, and somebody who has their files.

    Args:
        seed: of what is forged; keys are the kernel's.
    """

    def __init__(self, seed: int) -> None:
        self._chance = random.Random(seed)
        self._key = DeviceKey(Ed25519PrivateKey.generate())
        self.kinds = {"flipped": self.flipped, "dropped": self.dropped, "swapped": self.swapped}

    def log(self, captures: int) -> list[bytes]:
        """Lines of a log over two lives of a daemon."""
        with tempfile.TemporaryDirectory() as folder:
            for _ in range(2):
                log = Log(Path(folder) / "log", self._key, limit=SEGMENT, kept=KEPT)
                log.begin(log_fault)
                for number in range(captures):
                    log.append("capture", self._capture(number))
                    log.append("request", {"action": "PUT /v1/rotation", "status": 200})
                found = log.records(None, 1000)
                log.close()
        return [line_of(each) for each in found.records]

    def missed(self, kind: str, lines: list[bytes]) -> bool:
        """Whether one more forgery of this kind passes for whole."""
        forged, shown = self.kinds[kind](lines)
        return not verify_log(_content(forged), device=self._key.public, head=shown).findings

    def flipped(self, lines: list[bytes]) -> Forged:
        """One bit of one record is another."""
        place = self._chance.randrange(len(lines))
        line = bytearray(lines[place])
        line[self._chance.randrange(len(line))] ^= 1 << self._chance.randrange(8)
        return [*lines[:place], bytes(line), *lines[place + 1 :]], None

    def dropped(self, lines: list[bytes]) -> Forged:
        """One record is gone; with the newest, the head shows it."""
        place = self._chance.randrange(len(lines))
        return lines[:place] + lines[place + 1 :], lines[-1] if place == len(lines) - 1 else None

    def swapped(self, lines: list[bytes]) -> Forged:
        """Two records have changed places."""
        one, other = sorted(self._chance.sample(range(len(lines)), 2))
        forged = lines.copy()
        forged[one], forged[other] = lines[other], lines[one]
        return forged, None

    def _capture(self, number: int) -> dict[str, str | int]:
        return {
            "epoch": secrets.token_hex(16),
            "number": number,
            "mask": secrets.token_hex(32),
            "tested_s": 60,
            "answer": secrets.token_hex(32),
        }


def forgeries(count: int, seed: int) -> tuple[int, int]:
    """Forge so many records, in every way alike.

    Returns:
        How many passed for whole, and how many logs did not pass as they were.
    """
    campaign, missed, refused, left = Campaign(seed), 0, 0, count
    while left:
        # Of 12 to 40 records; what the longer ones began with was dropped by the camera.
        lines = campaign.log(captures=2 + left % 8)
        refused += bool(verify_log(_content(lines), head=lines[-1]).findings)
        # As many forgeries as it has records.
        for _, kind in zip(lines, cycle(campaign.kinds), strict=False):
            if left:
                missed += campaign.missed(kind, lines)
                left -= 1
    return missed, refused


def record_ms(captures: int = 1000) -> float:
    """What it takes to digest an answer, sign its record and write it: the median [ms]."""
    took = []
    provenance = Provenance(secrets.token_hex(32), tested=90.0, calibration=None)
    values = np.random.default_rng(0).random((24, 32), np.float32)
    embedding = Embedding.from_array(values)
    with tempfile.TemporaryDirectory() as folder:
        log = Log(Path(folder) / "log", DeviceKey(Ed25519PrivateKey.generate()))
        log.begin(log_fault)
        for number in range(captures):
            answer = Capture(
                id=secrets.token_hex(ID_DIGITS // 2),
                epoch=secrets.token_hex(16),
                number=number,
                taken_at=START,
                embedding=embedding,
            )
            begun = time.perf_counter()
            log.append("capture", logged(answer, provenance, "3f9a1c20"))
            took.append(time.perf_counter() - begun)
        log.close()
    return 1e3 * statistics.median(took)


def _content(lines: list[bytes]) -> bytes:
    return b"".join(line + b"\n" for line in lines)


def main(
    count: Annotated[int, typer.Argument(min=1, help="Forged records, of all kinds.")] = 10_000,
    seed: Annotated[int, typer.Option(help="Of what is forged; keys are the kernel's.")] = 1,
    figures: FiguresOption = None,
) -> None:
    """Forge records of logs, count those that pass for whole afterwards, and time a record."""
    missed, refused = forgeries(count, seed)
    print(f"{missed} of {count} forged records were missed; {refused} whole logs were refused")
    if refused:
        raise typer.Exit(1)
    took = record_ms()
    print(f"a record takes {took:.3f} ms")
    record(figures, {"log_forgeries_missed": missed, "log_record_ms": round(took, 3)})


if __name__ == "__main__":
    typer.run(main)
