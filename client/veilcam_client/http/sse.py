"""Server-sent events as the WHATWG HTML standard defines them, from bytes to messages."""

from collections.abc import Iterator
from dataclasses import dataclass

from veilcam_client.errors import ProtocolError

MAX_EVENT = 2**20
"""No event of a daemon comes near [bytes]."""


@dataclass(frozen=True, slots=True)
class Message:
    """One dispatched event; ``id`` is the last one seen on the stream."""

    event: str
    data: str
    id: str | None


class Decoder:
    """Feed it chunks as they come; it yields a message at every blank line."""

    def __init__(self) -> None:
        self._rest = b""
        self._event = ""
        self._data: list[str] = []
        self._id: str | None = None
        self._size = 0

    def feed(self, chunk: bytes) -> Iterator[Message]:
        """Yield the messages that ``chunk`` completes. Comments (heartbeats) yield nothing.

        Raises:
            ProtocolError: an event that has no end.
        """
        *lines, self._rest = (self._rest + chunk).split(b"\n")
        for line in lines:
            self._size += len(line)
            message = self._line(line.removesuffix(b"\r").decode(errors="replace"))
            if message is not None:
                yield message
            if line in (b"", b"\r"):
                self._size = 0
        if self._size + len(self._rest) > MAX_EVENT:
            raise ProtocolError(f"the server sent an event of more than {MAX_EVENT >> 20} MiB")

    def _line(self, line: str) -> Message | None:
        if not line:
            message = Message(self._event or "message", "\n".join(self._data), self._id)
            empty = not self._data
            self._event, self._data = "", []
            return None if empty else message
        name, _, value = line.partition(":")
        value = value.removeprefix(" ")
        if name == "event":
            self._event = value
        elif name == "data":
            self._data.append(value)
        elif name == "id" and "\0" not in value:
            self._id = value
        return None
