"""State of a daemon in its directory."""

from __future__ import annotations

from functools import cached_property, partial
from pathlib import Path
from typing import Self

from veilcam_client.wire.events import Fault
from veilcam_server.camera.engine import Publish
from veilcam_server.errors import ProblemError
from veilcam_server.sealing.identity import DeviceKey
from veilcam_server.sealing.receivers import ReceiverStore
from veilcam_server.security.log import FOLDER, Log
from veilcam_server.system.state_file import HeldDirectory


class State:
    """State directory of a daemon. Its key, receivers and log are opened when they are needed.

    Args:
        directory: state directory.
        held: lock that keeps other daemons off it; None: there is none.
    """

    def __init__(self, directory: Path, held: HeldDirectory | None = None) -> None:
        self.directory, self._held = directory, held
        self._found: list[ProblemError] = []
        self._publish: Publish | None = None

    @classmethod
    def open(cls, directory: Path) -> Self:
        """Hold a state directory; raises :class:`StartError` where another daemon does."""
        return cls(directory, HeldDirectory(directory))

    @cached_property
    def key(self) -> DeviceKey:
        """Key of the device; raises :class:`StartError`."""
        return DeviceKey.open(self.directory, self.report)

    @cached_property
    def receivers(self) -> ReceiverStore:
        """Receivers of embeddings; raises :class:`StartError`."""
        return ReceiverStore(self.directory, self.report)

    @cached_property
    def log(self) -> Log:
        """Log of what leaves, and of who changes it; raises :class:`StartError`."""
        return Log(self.directory / FOLDER, self.key, self.report)

    def report(self, fault: ProblemError) -> None:
        """Take a fault that ended nothing, on any thread; it is kept until somebody listens."""
        if self._publish is None:
            self._found.append(fault)
        else:
            make = partial(Fault, code=fault.code, detail=str(fault), remedy=fault.remedy)
            self._publish(make)

    def listen(self, publish: Publish) -> None:
        """Publish every fault that was reported before, and those to come."""
        self._publish, found = publish, self._found
        for fault in found:
            self.report(fault)

    def close(self) -> None:
        """Let another daemon have the directory; twice does no harm."""
        if self._held is not None:
            self._held.close()
