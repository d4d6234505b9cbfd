"""The camera for asyncio."""

from __future__ import annotations

import os
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from types import TracebackType
from typing import TYPE_CHECKING, Self

import numpy.typing as npt

from veilcam_client.camera import DEFAULT_URL, KeySource, opened, opener_of
from veilcam_client.http import calls
from veilcam_client.http.credentials import Credentials
from veilcam_client.http.transport import AsyncHttpClient, AsyncTransport, Options, RetryPolicy
from veilcam_client.wire.bundles import InstalledBundle
from veilcam_client.wire.calibration import CalibrationRun, CalibrationStatus, SceneName
from veilcam_client.wire.captures import Capture, Classification
from veilcam_client.wire.diagnostics import Diagnostics
from veilcam_client.wire.events import Event
from veilcam_client.wire.lease import Lease, NewLease
from veilcam_client.wire.log import RECORDS_AT_ONCE, LogHead, LogRecords
from veilcam_client.wire.rotation import Rotation, RotationPolicy
from veilcam_client.wire.sealing import PairedReceiver, Receivers
from veilcam_client.wire.simulation import Faults, HeldScene, picture_bytes
from veilcam_client.wire.status import Status
from veilcam_client.wire.tokens import TOKENS_AT_ONCE, NewToken, Scope, Token, Tokens

if TYPE_CHECKING:
    from veilcam_client.keys.receivers import Receiver


class AsyncCamera:
    """:class:`Camera` for asyncio: the same arguments, methods and results."""

    def __init__(
        self,
        url: str = DEFAULT_URL,
        *,
        connect_timeout: float = 2.0,
        read_timeout: float = 30.0,
        max_retries: int = 2,
        key: KeySource | None = None,
        device: str | None = None,
        token: str | None = None,
        ca_file: str | os.PathLike[str] | None = None,
        http_client: AsyncHttpClient | None = None,
    ) -> None:
        self._opener = opener_of(key, device)
        retry, credentials = RetryPolicy(retries=max_retries), Credentials(token, ca_file)
        options = Options(url, connect_timeout, read_timeout, retry, credentials)
        self._transport = AsyncTransport(options, http_client)

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        await self.close()

    async def close(self) -> None:
        """Close the connection."""
        await self._transport.close()

    async def status(self) -> Status:
        """State, device, bundle, rotation and queue of the daemon."""
        return await self._transport.send(calls.STATUS)

    async def calibration(self) -> CalibrationStatus:
        """What the camera found out about itself, and how finding out goes on."""
        return await self._transport.send(calls.CALIBRATION)

    async def start_calibration(self, *, repeats: int = 2) -> CalibrationRun:
        """Begin to measure the camera with itself; it takes no captures meanwhile.

        It goes on by itself but for scenes that somebody must set: see ``stage`` and
        ``instruction`` of :meth:`calibration` or of the events, and :meth:`confirm_scene`.
        """
        return await self._transport.send(calls.start_calibration(repeats))

    async def confirm_scene(self, scene: SceneName) -> CalibrationRun:
        """Confirm that the scene that the calibration waits for is set."""
        return await self._transport.send(calls.confirm_scene(scene))

    async def cancel_calibration(self) -> CalibrationRun:
        """End the calibration that is under way; what was in use before stays in use."""
        return await self._transport.send(calls.CANCEL_CALIBRATION)

    async def capture(self) -> Capture:
        """Take one embedding, as :meth:`Camera.capture` does."""
        return opened(await self._transport.send(calls.CAPTURE), self._opener)

    async def classify(self, *, include_embedding: bool = False) -> Classification:
        """Take one embedding and classify it on the device."""
        answer = await self._transport.send(calls.classify(include_embedding))
        return opened(answer, self._opener)

    async def rotation(self) -> Rotation:
        """The rotation policy and the present mask epoch."""
        return await self._transport.send(calls.ROTATION)

    async def set_rotation(self, policy: RotationPolicy) -> Rotation:
        """Change when masks change."""
        return await self._transport.send(calls.set_rotation(policy))

    async def rotate(self) -> Rotation:
        """Show another mask now."""
        return await self._transport.send(calls.ROTATE)

    async def take_lease(self, *, seconds: float, owner: str = "veilcam_client") -> NewLease:
        """Hold the camera, or go on holding it: for so long, others take no captures [s]."""
        taken = await self._transport.send(calls.take_lease(seconds, owner))
        self._transport.options.credentials.lease = taken.secret
        return taken

    async def release_lease(self) -> Lease:
        """Hold the camera no longer."""
        released = await self._transport.send(calls.release_lease())
        self._transport.options.credentials.lease = None
        return released

    @asynccontextmanager
    async def lease(
        self, *, seconds: float, owner: str = "veilcam_client"
    ) -> AsyncIterator[NewLease]:
        """Hold the camera within the context; :meth:`take_lease` within it renews."""
        taken = await self.take_lease(seconds=seconds, owner=owner)
        try:
            yield taken
        finally:
            await self.release_lease()

    async def break_lease(self) -> Lease:
        """End the lease of whoever holds the camera; wants the scope ``admin:tokens`` too."""
        return await self._transport.send(calls.release_lease(force=True))

    async def lease_state(self) -> Lease:
        """Who holds the camera, and how long."""
        return await self._transport.send(calls.LEASE_STATE)

    async def diagnostics(self) -> Diagnostics:
        """Versions, settings, and the last states and faults of the daemon."""
        return await self._transport.send(calls.DIAGNOSTICS)

    async def tokens(self, *, limit: int = TOKENS_AT_ONCE, after: str | None = None) -> Tokens:
        """Return tokens, as :meth:`Camera.tokens` does."""
        return await self._transport.send(calls.tokens(limit, after))

    async def create_token(
        self, label: str, scopes: Sequence[Scope], *, seconds: int | None = None
    ) -> NewToken:
        """Make a token that is valid for so long [s]; its ``secret`` is told this once."""
        return await self._transport.send(calls.create_token(label, scopes, seconds))

    async def revoke_token(self, token_id: str) -> Token:
        """Let a token do nothing any more."""
        return await self._transport.send(calls.revoke_token(token_id))

    async def log(self, *, limit: int = RECORDS_AT_ONCE, after: int | None = None) -> LogRecords:
        """Return signed records of what was answered, the oldest first; see docs/capture-log.md.

        Args:
            limit: so many at most.
            after: those that follow this position, as ``next`` of an answer names it.
        """
        return await self._transport.send(calls.log(limit, after))

    async def log_head(self) -> LogHead:
        """Where the log ends now, signed: keep it, and what is dropped from that end shows."""
        return await self._transport.send(calls.LOG_HEAD)

    async def receivers(self) -> Receivers:
        """To whom embeddings are sealed, and the key of the device that seals them."""
        return await self._transport.send(calls.RECEIVERS)

    async def add_receiver(self, label: str, key: Receiver | str) -> PairedReceiver:
        """Seal to one receiver more, as :meth:`Camera.add_receiver` does."""
        return await self._transport.send(calls.add_receiver(label, str(key)))

    async def remove_receiver(self, receiver_id: str) -> None:
        """Seal to a receiver no more, from the next mask on; what it has it still opens."""
        await self._transport.send(calls.remove_receiver(receiver_id))

    async def hold_scene(self, picture: npt.ArrayLike | bytes | None) -> HeldScene:
        """Hold a picture up, or take it away, as :meth:`Camera.hold_scene` does."""
        if picture is None:
            return await self._transport.send(calls.TAKE_SCENE_AWAY)
        return await self._transport.send(calls.hold_scene(picture_bytes(picture)))

    async def set_faults(self, faults: Faults) -> Faults:
        """Break a simulated camera, or mend it, as :meth:`Camera.set_faults` does."""
        return await self._transport.send(calls.set_faults(faults))

    async def bundles(self) -> tuple[InstalledBundle, ...]:
        """All bundles; one of them is ``active``."""
        return (await self._transport.send(calls.BUNDLES)).bundles

    async def install_bundle(self, bundle: bytes) -> InstalledBundle:
        """Hand over the content of a bundle; it is checked, and not used yet."""
        return await self._transport.send(calls.install_bundle(bundle))

    async def activate_bundle(self, digest: str, *, allow_older: bool = False) -> InstalledBundle:
        """Take masks and classifiers from this bundle from now on.

        One of an older version than that in use is refused unless ``allow_older``, and always where
        the daemon wants its owner's signature.
        """
        return await self._transport.send(calls.activate_bundle(digest, allow_older))

    async def remove_bundle(self, digest: str) -> tuple[InstalledBundle, ...]:
        """Remove a bundle that is not in use for good; return those that are left."""
        return (await self._transport.send(calls.remove_bundle(digest))).bundles

    def events(self, *, last_event_id: str | None = None) -> AsyncIterator[Event]:
        """Yield events as they happen; resumes by itself, a ``Gap`` tells of missed ones."""
        return self._transport.events(last_event_id)
