"""Forged answers of a sealing camera: how many of them a receiver takes for true.

python -m benchmarks.privacy.forgeries --figures benchmarks/results/keys.json
"""

from __future__ import annotations

import base64
import copy
import functools
import itertools
import json
import random
import secrets
from collections.abc import Callable, Iterator
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from functools import partial
from typing import Annotated, Any

import numpy as np
import typer
from benchmarks.figures import FiguresOption, record
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from pydantic import ValidationError

from veilcam_client.errors import SealedError
from veilcam_client.keys.blocks import Opener, Sealer
from veilcam_client.keys.envelopes import seal_key
from veilcam_client.keys.epoch_key import EpochKey
from veilcam_client.keys.receivers import Receiver, ReceiverKey
from veilcam_client.wire.captures import Capture, Exposure, Notes, Timing

Answer = dict[str, Any]
Path = tuple[str | int, ...]
BUNDLES = ("0f" * 32, "1e" * 32)
EPOCHS, CAPTURES, SHAPE = 4, 4, (3, 4)
OTHER_SHAPES = ([4, 3], [12], [2, 6], [3, 4, 1], [3, -1], [-1, 4], [1, 3, 4])
START = datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC)
NOTES = Notes(
    exposure=Exposure(started_after_shown_s=0.104, settle_s=0.1, duration_s=0.01),
    timing=Timing(queue_s=0.0, rotation_s=0.02, settle_s=0.08, capture_s=0.05),
)


class Device:
    """A camera, as far as it seals: every capture of every epoch, as the API answers it."""

    def __init__(self, receivers: tuple[Receiver, ...]) -> None:
        self._key = Ed25519PrivateKey.generate()
        self.answers = [
            list(self._epoch(place, BUNDLES[place % 2], receivers)) for place in range(EPOCHS)
        ]

    @property
    def public(self) -> str:
        """Its public key."""
        return self._key.public_key().public_bytes_raw().hex()

    def sign(self, message: bytes) -> str:
        """Sign as a device does."""
        return self._key.sign(message).hex()

    def _epoch(self, place: int, bundle: str, receivers: tuple[Receiver, ...]) -> Iterator[Answer]:
        epoch, key = secrets.token_hex(16), EpochKey.generate(device=self.public, bundle=bundle)
        sealer = Sealer(key, seal_key(key, self, epoch=epoch, bundle=bundle, receivers=receivers))
        for number in range(CAPTURES):
            at = START + timedelta(seconds=CAPTURES * place + number)
            values = np.full(SHAPE, number, np.float32)
            sealed = sealer.seal(number, at, values, NOTES)
            capture = Capture(
                id=secrets.token_hex(8), epoch=epoch, number=number, taken_at=at, embedding=sealed
            )
            yield capture.model_dump(mode="json")


class Campaign:
    """Two cameras that seal to the same two receivers, and somebody between one of each."""

    def __init__(self, seed: int) -> None:
        self._chance, self._key = random.Random(seed), ReceiverKey.generate()
        receivers = (self._key.public, ReceiverKey.generate().public)
        self._camera, self._other = Device(receivers), Device(receivers)
        self.kinds: dict[str, Callable[[Opener], Answer]] = {
            "replayed": self._replayed,
            "reordered": self._reordered,
            "cross-device": partial(self._changed, self._cross_device),
            "cross-form": partial(self._changed, self._cross_form),
            "transplanted": partial(self._changed, self._transplanted),
            "truncated": partial(self._changed, self._truncated),
            "flipped": partial(self._changed, self._flipped),
        }

    def taken(self, kind: str) -> bool:
        """Whether one more forgery of this kind is taken for true."""
        opener = self._opener()
        forged = self.kinds[kind](opener)
        try:
            _open(opener, forged)
        except (SealedError, ValidationError):
            return False
        return True

    def _opener(self) -> Opener:
        """One that was told which camera is its own, or has opened what that one sealed."""
        if self._chance.random() < 0.5:
            return Opener(self._key, self._camera.public)
        opener = Opener(self._key)
        _open(opener, self._camera.answers[0][0])
        return opener

    def _genuine(self) -> Answer:
        return copy.deepcopy(self._chance.choice(self._chance.choice(self._camera.answers[1:])))

    def _foreign(self) -> Answer:
        return copy.deepcopy(self._chance.choice(self._chance.choice(self._other.answers)))

    def _replayed(self, opener: Opener) -> Answer:
        """What was opened before."""
        answer = self._genuine()
        _open(opener, answer)
        return answer

    def _reordered(self, opener: Opener) -> Answer:
        """What was taken before another one of its epoch, which was opened."""
        epoch = self._chance.choice(self._camera.answers[1:])
        earlier, later = sorted(self._chance.sample(range(CAPTURES), 2))
        _open(opener, epoch[later])
        return epoch[earlier]

    def _changed(self, change: Callable[[Answer], None], _: Opener) -> Answer:
        """What was never opened, and says something else than was sealed."""
        genuine = self._genuine()
        forged = copy.deepcopy(genuine)
        while _told(forged) == _told(genuine):
            change(forged)
        return forged

    def _cross_device(self, answer: Answer) -> None:
        """All of another camera's answer, its embedding, or its envelope."""
        foreign = self._foreign()
        match self._chance.randrange(3):
            case 0:
                answer.update(foreign)
            case 1:
                answer["embedding"] = foreign["embedding"]
            case 2:
                answer["embedding"]["envelope"] = foreign["embedding"]["envelope"]

    def _cross_form(self, answer: Answer) -> None:
        """Another form, or the same bytes as another shape or type."""
        match self._chance.randrange(3):
            case 0:
                answer["embedding"] = {"form": "raw", "shape": [2], "values": [0.0, 1.0]}
            case 1:
                answer["embedding"]["shape"] = self._chance.choice(OTHER_SHAPES)
            case 2:
                answer["embedding"]["dtype"] = self._chance.choice(("float64", ">f4", "int32"))

    def _transplanted(self, answer: Answer) -> None:
        """Any part of another answer, of this camera or of the other."""
        path = self._chance.choice(list(_paths(answer)))
        donor = self._chance.choice((self._genuine, self._foreign))()
        _put(answer, path, _part(donor, path))

    def _truncated(self, answer: Answer) -> None:
        """Less of any list, of any text, or of the bytes that it stands for."""
        path, whole = self._any(answer, list, str)
        if isinstance(whole, str):
            whole, encode = self._chance.choice(list(_readings(whole)))
            less = encode(whole[: self._chance.randrange(len(whole))])
        else:
            less = whole[: self._chance.randrange(len(whole))]
        _put(answer, path, less)

    def _flipped(self, answer: Answer) -> None:
        """One bit of any number, of any text, or of the bytes that it stands for."""
        path, value = self._any(answer, int, str)
        if isinstance(value, str):
            data, encode = self._chance.choice(list(_readings(value)))
            flipped = bytearray(data)
            flipped[self._chance.randrange(len(data))] ^= 1 << self._chance.randrange(8)
            _put(answer, path, encode(bytes(flipped)))
        else:
            _put(answer, path, value ^ 1 << self._chance.randrange(100))

    def _any(self, answer: Answer, *kinds: type) -> tuple[Path, Any]:
        """Any part of these kinds that has something in it."""
        parts = ((path, _part(answer, path)) for path in _paths(answer))
        held = [(path, part) for path, part in parts if isinstance(part, kinds) and part != ""]
        return self._chance.choice(held)


def forgeries(count: int, seed: int) -> int:
    """Forge so many answers, of every kind alike; returns how many a receiver took for true.

    Of what an answer says, all but its id is forged: no key vouches for that one.
    """
    campaign = Campaign(seed)
    kinds = itertools.islice(itertools.cycle(campaign.kinds), count)
    return sum(campaign.taken(kind) for kind in kinds)


def _open(opener: Opener, answer: Answer) -> Capture:
    return opener.open(Capture.model_validate_json(json.dumps(answer)))


def _told(answer: Answer) -> Capture | None:
    """What a client reads; None: it cannot."""
    try:
        return Capture.model_validate_json(json.dumps(answer))
    except ValidationError:
        return None


def _paths(part: Any, above: Path = ()) -> Iterator[Path]:
    """Where parts are in an answer, lists and objects among them, but for its id."""
    places = part.items() if isinstance(part, dict) else enumerate(part)
    for place, below in places:
        if below is None or (*above, place) == ("id",):
            continue
        yield (*above, place)
        if isinstance(below, dict | list):
            yield from _paths(below, (*above, place))


def _part(answer: Any, path: Path) -> Any:
    return functools.reduce(lambda part, place: part[place], path, answer)


def _put(answer: Answer, path: Path, value: Any) -> None:
    _part(answer, path[:-1])[path[-1]] = value


def _readings(text: str) -> Iterator[tuple[bytes, Callable[[bytes], str]]]:
    """The bytes that a text can stand for, and how they become one again."""
    yield text.encode(), lambda data: data.decode("utf-8", "replace")
    with suppress(ValueError):
        yield bytes.fromhex(text), bytes.hex
    with suppress(ValueError):
        yield base64.b64decode(text, validate=True), lambda data: base64.b64encode(data).decode()


def main(
    count: Annotated[
        int, typer.Argument(min=1, help="Forged answers, of all kinds alike.")
    ] = 10_000,
    seed: Annotated[int, typer.Option(help="Of what is forged; keys are the kernel's.")] = 1,
    figures: FiguresOption = None,
) -> None:
    """Forge answers on their way to a receiver, and count those that it takes for true."""
    taken = forgeries(count, seed=seed)
    print(f"{taken} of {count} forged answers were taken")
    record(figures, {"forgeries_taken": taken})


if __name__ == "__main__":
    typer.run(main)
