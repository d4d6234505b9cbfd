"""Private key of a receiver, and answers that it opens."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, TypeAlias, TypeVar

from veilcam_client.arguments import of_type
from veilcam_client.errors import ArgumentError
from veilcam_client.wire.captures import Capture, Classification

if TYPE_CHECKING:
    from veilcam_client.keys.blocks import Opener
    from veilcam_client.keys.receivers import ReceiverKey

KeySource: TypeAlias = "str | os.PathLike[str] | ReceiverKey"
"""A receiver's private key, or its file."""
TakenT = TypeVar("TakenT", Capture, Classification)


def receiver_key(source: KeySource) -> ReceiverKey:
    """Read a receiver's private key; raises ``FileError``."""
    # Late: whoever opens nothing need not wait for the cryptography to load.
    from veilcam_client.keys.receivers import ReceiverKey  # noqa: PLC0415

    of_type("key", source, (str, os.PathLike, ReceiverKey), "a receiver's key, or its file")
    return source if isinstance(source, ReceiverKey) else ReceiverKey.read(source)


def opener_of(key: KeySource | None, device: str | None) -> Opener | None:
    """Return the reader of sealed embeddings; None: there is no key."""
    if key is None:
        if device is not None:
            raise ArgumentError("device= is checked when embeddings are opened: give key= as well")
        return None
    from veilcam_client.keys.blocks import Opener  # noqa: PLC0415 - late, as above

    return Opener(receiver_key(key), device)


def opened(answer: TakenT, opener: Opener | None) -> TakenT:
    """Return an answer with its embedding opened, where there is a key for it."""
    return answer if opener is None else opener.open(answer)
