"""Resources of a camera for asyncio: what is managed beside captures."""

from __future__ import annotations

from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING

from veilcam_client.http import calls
from veilcam_client.http.async_transport import AsyncTransport
from veilcam_client.http.deadline import CAMERA_TIMEOUT, CallTimeout
from veilcam_client.wire.base import Nothing
from veilcam_client.wire.bundles import InstalledBundle, InstalledBundles
from veilcam_client.wire.calibration import CalibrationRun, CalibrationStatus, SceneName
from veilcam_client.wire.lease import Lease, NewLease
from veilcam_client.wire.log import RECORDS_AT_ONCE, LogHead, LogRecords
from veilcam_client.wire.rotation import Rotation, RotationPolicy
from veilcam_client.wire.sealing import PairedReceiver, Receivers
from veilcam_client.wire.simulation import Faults, HeldScene, picture_bytes
from veilcam_client.wire.tokens import TOKENS_AT_ONCE, NewToken, Scope, Token, Tokens
from veilcam_client.wire.watch import Watch, WatchPolicy

if TYPE_CHECKING:
    import numpy.typing as npt

    from veilcam_client.keys.receivers import Receiver


class AsyncResource:
    """Part of a camera. Every method takes ``timeout=``, the time-out of the call in all [s]."""

    def __init__(self, transport: AsyncTransport) -> None:
        self._transport = transport


class AsyncBundleResource(AsyncResource):
    """Bundles of masks and classifiers, one of which is in use."""

    async def list(self, *, timeout: CallTimeout = CAMERA_TIMEOUT) -> InstalledBundles:
        """Return all bundles; one of them is ``active``."""
        return await self._transport.send(calls.BUNDLES, timeout)

    async def install(
        self, bundle: bytes, *, timeout: CallTimeout = CAMERA_TIMEOUT
    ) -> InstalledBundle:
        """Hand over the content of a bundle; it is checked, and not used yet."""
        return await self._transport.send(calls.install_bundle(bundle), timeout)

    async def activate(
        self,
        digest: str,
        *,
        allow_older: bool = False,
        wait: float | None = None,
        timeout: CallTimeout = CAMERA_TIMEOUT,
    ) -> InstalledBundle:
        """Take masks and classifiers from this bundle from now on.

        One of an older version than that in use is refused unless ``allow_older``, and always where
        the daemon wants its owner's signature.
        """
        call = calls.activate_bundle(digest, allow_older)
        return await self._transport.send(call, timeout, wait=wait)

    async def remove(
        self, digest: str, *, timeout: CallTimeout = CAMERA_TIMEOUT
    ) -> InstalledBundles:
        """Remove a bundle that is not in use, for good; return those that are left."""
        return await self._transport.send(calls.remove_bundle(digest), timeout)


class AsyncTokenResource(AsyncResource):
    """Tokens, with a token that has the scope ``admin:tokens``."""

    async def list(
        self,
        *,
        limit: int = TOKENS_AT_ONCE,
        after: str | None = None,
        timeout: CallTimeout = CAMERA_TIMEOUT,
    ) -> Tokens:
        """Return tokens, the oldest first, revoked and expired ones included.

        Args:
            limit: greatest number of tokens.
            after: id of the token after which others are wanted, as ``next`` of an answer names it.
            timeout: time-out of the call in all [s].
        """
        return await self._transport.send(calls.tokens(limit, after), timeout)

    async def create(
        self,
        label: str,
        scopes: Sequence[Scope],
        *,
        seconds: int | None = None,
        timeout: CallTimeout = CAMERA_TIMEOUT,
    ) -> NewToken:
        """Make a token that is valid for so long [s]; its ``secret`` is told this once."""
        return await self._transport.send(calls.create_token(label, scopes, seconds), timeout)

    async def revoke(self, token_id: str, *, timeout: CallTimeout = CAMERA_TIMEOUT) -> Token:
        """End a token now."""
        return await self._transport.send(calls.revoke_token(token_id), timeout)


class AsyncReceiverResource(AsyncResource):
    """Receivers, to whom embeddings are sealed."""

    async def list(self, *, timeout: CallTimeout = CAMERA_TIMEOUT) -> Receivers:
        """Return all receivers, and the key of the device that seals to them."""
        return await self._transport.send(calls.RECEIVERS, timeout)

    async def add(
        self, label: str, key: Receiver | str, *, timeout: CallTimeout = CAMERA_TIMEOUT
    ) -> PairedReceiver:
        """Seal to one receiver more, from the next mask on.

        Args:
            label: label for people; it stands in the status and in the audit log.
            key: public key of the receiver, as ``veilcam receiver keygen`` prints it.
            timeout: time-out of the call in all [s].
        """
        return await self._transport.send(calls.add_receiver(label, str(key)), timeout)

    async def remove(self, receiver_id: str, *, timeout: CallTimeout = CAMERA_TIMEOUT) -> Nothing:
        """Seal to a receiver no more, from the next mask on; what it has it still opens."""
        return await self._transport.send(calls.remove_receiver(receiver_id), timeout)


class AsyncCalibrationResource(AsyncResource):
    """Calibration: the camera measured with itself."""

    async def get(self, *, timeout: CallTimeout = CAMERA_TIMEOUT) -> CalibrationStatus:
        """Return the calibration in use, and the progress of a running one."""
        return await self._transport.send(calls.CALIBRATION, timeout)

    async def start(
        self, *, repeats: int = 2, wait: float | None = None, timeout: CallTimeout = CAMERA_TIMEOUT
    ) -> CalibrationRun:
        """Begin to measure; the camera takes no captures meanwhile.

        It goes on by itself but for scenes that somebody must set: see ``stage`` and
        ``instruction`` of :meth:`get` or of the events, and :meth:`confirm`.
        """
        return await self._transport.send(calls.start_calibration(repeats), timeout, wait=wait)

    async def confirm(
        self, scene: SceneName, *, timeout: CallTimeout = CAMERA_TIMEOUT
    ) -> CalibrationRun:
        """Confirm that the scene that the calibration waits for is set."""
        return await self._transport.send(calls.confirm_scene(scene), timeout)

    async def cancel(self, *, timeout: CallTimeout = CAMERA_TIMEOUT) -> CalibrationRun:
        """End the calibration that is under way; what was in use before stays in use."""
        return await self._transport.send(calls.CANCEL_CALIBRATION, timeout)


class AsyncRotationResource(AsyncResource):
    """Rotation: changes of the mask."""

    async def get(self, *, timeout: CallTimeout = CAMERA_TIMEOUT) -> Rotation:
        """Return the rotation policy and the present mask epoch."""
        return await self._transport.send(calls.ROTATION, timeout)

    async def set(
        self,
        policy: RotationPolicy,
        *,
        wait: float | None = None,
        timeout: CallTimeout = CAMERA_TIMEOUT,
    ) -> Rotation:
        """Change when masks change."""
        return await self._transport.send(calls.set_rotation(policy), timeout, wait=wait)

    async def advance(
        self, *, wait: float | None = None, timeout: CallTimeout = CAMERA_TIMEOUT
    ) -> Rotation:
        """Show another mask now."""
        return await self._transport.send(calls.ROTATE, timeout, wait=wait)


class AsyncWatchResource(AsyncResource):
    """Watch: the camera looks by itself."""

    async def get(self, *, timeout: CallTimeout = CAMERA_TIMEOUT) -> Watch:
        """Return the policy of the watch, and the belief of the camera about the scene."""
        return await self._transport.send(calls.WATCH, timeout)

    async def set(
        self,
        policy: WatchPolicy,
        *,
        wait: float | None = None,
        timeout: CallTimeout = CAMERA_TIMEOUT,
    ) -> Watch:
        """Let the camera look by itself, or on request alone, or not at all."""
        return await self._transport.send(calls.set_watch(policy), timeout, wait=wait)


class AsyncLogResource(AsyncResource):
    """Signed log of what was answered; see docs/capture-log.md."""

    async def list(
        self,
        *,
        limit: int = RECORDS_AT_ONCE,
        after: int | None = None,
        timeout: CallTimeout = CAMERA_TIMEOUT,
    ) -> LogRecords:
        """Return records, the oldest first.

        Args:
            limit: greatest number of records.
            after: position after which records are wanted, as ``next`` of an answer names it.
            timeout: time-out of the call in all [s].
        """
        return await self._transport.send(calls.log(limit, after), timeout)

    async def head(self, *, timeout: CallTimeout = CAMERA_TIMEOUT) -> LogHead:
        """Return the signed end of the log: keep it, and what is dropped from that end shows."""
        return await self._transport.send(calls.LOG_HEAD, timeout)


class AsyncSimulationResource(AsyncResource):
    """Simulated camera that its daemon lets callers change (``--scene-api``)."""

    async def hold_scene(
        self, picture: npt.ArrayLike | bytes | None, *, timeout: CallTimeout = CAMERA_TIMEOUT
    ) -> HeldScene:
        """Hold a picture up before the camera; None takes it away.

        Args:
            picture: the content of a PNG, JPEG, WebP, BMP, TIFF, GIF or ``.npy`` file, or an array
                (rows, columns) or (rows, columns, 3), uint8, or floats in [0, 1].
            timeout: time-out of the call in all [s].
        """
        if picture is None:
            return await self._transport.send(calls.TAKE_SCENE_AWAY, timeout)
        return await self._transport.send(calls.hold_scene(picture_bytes(picture)), timeout)

    async def set_faults(self, faults: Faults, *, timeout: CallTimeout = CAMERA_TIMEOUT) -> Faults:
        """Break the camera; ``Faults()`` mends it. Return its faults from now on."""
        return await self._transport.send(calls.set_faults(faults), timeout)


class AsyncLeaseResource(AsyncResource):
    """Lease: the camera for oneself, for a while."""

    async def get(self, *, timeout: CallTimeout = CAMERA_TIMEOUT) -> Lease:
        """Return the holder of the camera, and the remaining time."""
        return await self._transport.send(calls.LEASE_STATE, timeout)

    async def take(
        self,
        *,
        seconds: float,
        owner: str = "veilcam_client",
        wait: float | None = None,
        timeout: CallTimeout = CAMERA_TIMEOUT,
    ) -> NewLease:
        """Hold the camera, or go on holding it: for so long, others take no captures [s]."""
        taken = await self._transport.send(calls.take_lease(seconds, owner), timeout, wait=wait)
        self._transport.options.credentials.lease = taken.secret
        return taken

    async def release(self, *, timeout: CallTimeout = CAMERA_TIMEOUT) -> Lease:
        """Hold the camera no longer."""
        released = await self._transport.send(calls.release_lease(), timeout)
        self._transport.options.credentials.lease = None
        return released

    @asynccontextmanager
    async def hold(
        self,
        *,
        seconds: float,
        owner: str = "veilcam_client",
        wait: float | None = None,
        timeout: CallTimeout = CAMERA_TIMEOUT,
    ) -> AsyncIterator[NewLease]:
        """Hold the camera within the context; :meth:`take` within it renews."""
        taken = await self.take(seconds=seconds, owner=owner, wait=wait, timeout=timeout)
        try:
            yield taken
        finally:
            await self.release(timeout=timeout)

    async def revoke(self, *, timeout: CallTimeout = CAMERA_TIMEOUT) -> Lease:
        """End the lease of whoever holds the camera; wants the scope ``admin:tokens`` too."""
        return await self._transport.send(calls.release_lease(force=True), timeout)
