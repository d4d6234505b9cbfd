"""Settings of a bridge: its camera, its broker and its webhooks."""

from __future__ import annotations

import asyncio
import logging
import re
import ssl
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import urlsplit

from veilcam_client.arguments import is_this_machine

log = logging.getLogger("veilcam.mqtt")
PAUSES = (0.2, 0.5, 1.0, 2.0, 5.0)
"""Before each attempt to reach what went [s]; the last one again and again. What was there for as
long as the last one begins with the first one anew."""
PORTS = {"mqtt": 1883, "mqtts": 8883}
_LEVEL = re.compile(r"[A-Za-z0-9_-]+")
"""What Home Assistant takes as an id, and as one level of a topic."""


@dataclass(frozen=True, slots=True)
class Broker:
    """A broker, and how it is reached.

    Attributes:
        url: ``mqtt://HOST:PORT`` or ``mqtts://HOST:PORT``; without a port, 1883 or 8883.
        username: user name, if the broker wants one.
        password: password of the user.
        ca_file: PEM file of the authority that vouches for the broker; the system's if None.
        certificate: PEM file, where the broker wants to see one.
        key: PEM file of its private key.
        allow_plain: over ``mqtt://`` to another machine, where whoever listens reads labels and
            password.

    Raises:
        ValueError: an address that is none, or what does not fit together.
    """

    url: str
    username: str | None = None
    password: str | None = field(default=None, repr=False)
    ca_file: Path | None = None
    certificate: Path | None = None
    key: Path | None = None
    allow_plain: bool = False
    host: str = field(init=False)
    port: int = field(init=False)

    def __post_init__(self) -> None:
        parts = urlsplit(self.url)
        try:
            port = parts.port
        except ValueError:
            port = 0
        if parts.scheme not in PORTS or not parts.hostname or port == 0 or parts.path not in "/":
            raise ValueError("the broker's address is not valid: use mqtt://HOST or mqtts://HOST")
        if parts.username is not None or parts.password is not None:
            raise ValueError("no password in the broker's address: use --username, --password-file")
        if self.password is not None and self.username is None:
            raise ValueError("a password goes with a user name: give --username")
        if (self.certificate is None) != (self.key is None):
            raise ValueError("--certificate and --key go together: give both")
        if not self.encrypted:
            if self.ca_file is not None or self.certificate is not None:
                raise ValueError("certificates are for mqtts://")
            if not self.allow_plain and not is_this_machine(parts.hostname):
                raise ValueError(
                    f"{parts.hostname} would be told labels in the clear: use mqtts://, or say "
                    "--allow-plain"
                )
        object.__setattr__(self, "host", parts.hostname)
        object.__setattr__(self, "port", port or PORTS[parts.scheme])

    @property
    def encrypted(self) -> bool:
        """True where the broker is reached over TLS."""
        return urlsplit(self.url).scheme == "mqtts"

    def tls(self) -> ssl.SSLContext | None:
        """Return the certificates of TLS, None without TLS; raises ValueError for an unfit file."""
        if not self.encrypted:
            return None
        try:
            context = ssl.create_default_context(cafile=self.ca_file)
            if self.certificate is not None:
                context.load_cert_chain(self.certificate, self.key)
        except OSError as error:
            raise ValueError(f"a certificate or key cannot be used: {error}") from None
        return context


@dataclass(frozen=True, slots=True)
class Names:
    """Names of a camera in the house.

    Attributes:
        node: id of the device, and a level of its topics; empty: made of the camera's key.
        base: first level of its topics.
        discovery: prefix under which Home Assistant looks for devices.

    Raises:
        ValueError: a name that cannot stand in a topic.
    """

    node: str = ""
    base: str = "veilcam"
    discovery: str = "homeassistant"

    def __post_init__(self) -> None:
        for name in (self.node or "veilcam", self.base, self.discovery):
            if not _LEVEL.fullmatch(name):
                raise ValueError(f"{name!r} is no level of a topic: use letters, digits, _ and -")

    def topic(self, name: str) -> str:
        """One of the camera's topics."""
        return f"{self.base}/{self.node}/{name}"

    @property
    def config(self) -> str:
        """Topic of the device's description."""
        return f"{self.discovery}/device/{self.node}/config"

    @property
    def birth(self) -> str:
        """Topic of Home Assistant's birth message."""
        return f"{self.discovery}/status"


class Attempts:
    """Attempts to reach a camera or a broker: a line of the log for each new reason, and pauses."""

    def __init__(self, name: str) -> None:
        self._name, self._failures, self._said = name, 0, ""

    async def failed(self, reason: str, *, lasted: float | None) -> None:
        """Log why an attempt ended, and wait before the next one.

        Args:
            reason: text of the error.
            lasted: time that the connection lasted [s]; None: there was none.
        """
        if lasted is not None:
            self._said = ""
            self._failures = 0 if lasted >= PAUSES[-1] else self._failures
        if reason != self._said:
            log.warning("%s: %s", self._name, reason)
        self._said = reason
        await asyncio.sleep(PAUSES[min(self._failures, len(PAUSES) - 1)])
        self._failures += 1
