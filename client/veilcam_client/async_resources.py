"""Resources of a camera for asyncio: what is managed beside captures."""

from __future__ import annotations

from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING

from veilcam_client.arguments import model, of_type, whole
from veilcam_client.http.async_transport import AsyncTransport
from veilcam_client.http.calls import Call, part
from veilcam_client.http.deadline import CAMERA_TIMEOUT, CallTimeout
from veilcam_client.wire.base import Nothing
from veilcam_client.wire.bundles import BUNDLE_MEDIA_TYPE, InstalledBundle, InstalledBundles
from veilcam_client.wire.calibration import (
    CalibrationRequest,
    CalibrationRun,
    CalibrationStatus,
    SceneConfirmation,
    SceneName,
)
from veilcam_client.wire.lease import Lease, LeaseRequest, NewLease
from veilcam_client.wire.log import RECORDS_AT_ONCE, LogRecords
from veilcam_client.wire.pairing import Paired, PairingClaim, PairingOffer, PairingRequest
from veilcam_client.wire.rotation import (
    EveryCaptures,
    EverySeconds,
    Rotation,
    RotationOff,
    RotationPolicy,
)
from veilcam_client.wire.sealing import PairedReceiver, ReceiverRequest, Receivers
from veilcam_client.wire.simulation import Faults, HeldScene, picture_bytes, picture_media_type
from veilcam_client.wire.tokens import (
    MOST_TOKENS,
    TOKENS_AT_ONCE,
    NewToken,
    Role,
    Scope,
    Token,
    TokenRequest,
    Tokens,
)
from veilcam_client.wire.watch import OnRequest, Watch, Watching, WatchOff, WatchPolicy

if TYPE_CHECKING:
    import numpy.typing as npt

    from veilcam_client.keys.receivers import Receiver


_CALIBRATION = "/v1/calibration"


class AsyncResource:
    """Part of a camera. Every method takes ``timeout=``, the time-out of the call in all [s]."""

    def __init__(self, transport: AsyncTransport) -> None:
        self._transport = transport


class AsyncBundleResource(AsyncResource):
    """Bundles of masks and classifiers, one of which is in use."""

    async def list(self, *, timeout: CallTimeout = CAMERA_TIMEOUT) -> InstalledBundles:
        """Return all bundles; one of them is ``active``."""
        return await self._transport.send(Call("GET", "/v1/bundles", InstalledBundles), timeout)

    async def install(
        self, bundle: bytes, *, timeout: CallTimeout = CAMERA_TIMEOUT
    ) -> InstalledBundle:
        """Hand over the content of a bundle; it is checked, and not used yet."""
        of_type("bundle", bundle, bytes, "the content of its file")
        # To repeat it changes nothing.
        call = Call("POST", "/v1/bundles", InstalledBundle, bundle, BUNDLE_MEDIA_TYPE)
        return await self._transport.send(call, timeout)

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
        of_type("allow_older", allow_older, bool, "True or False")
        query = "?allow_older=true" if allow_older else ""
        path = f"/v1/bundles/{part('digest', digest)}/activate{query}"
        call = Call("POST", path, InstalledBundle, once=True)
        return await self._transport.send(call, timeout, wait=wait)

    async def remove(
        self, digest: str, *, timeout: CallTimeout = CAMERA_TIMEOUT
    ) -> InstalledBundles:
        """Remove a bundle that is not in use, for good; return those that are left."""
        call = Call("DELETE", f"/v1/bundles/{part('digest', digest)}", InstalledBundles)
        return await self._transport.send(call, timeout)


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
        start = "" if after is None else f"&after={part('after', after)}"
        path = f"/v1/tokens?limit={whole('limit', limit, 1, MOST_TOKENS)}{start}"
        return await self._transport.send(Call("GET", path, Tokens), timeout)

    async def create(
        self,
        label: str,
        scopes: Sequence[Scope] = (),
        *,
        role: Role | None = None,
        seconds: int | None = None,
        timeout: CallTimeout = CAMERA_TIMEOUT,
    ) -> NewToken:
        """Make a token of a role or of scopes; its ``secret`` is told this once.

        Args:
            label: label for people; it stands in the log.
            scopes: scopes of the token; empty where a ``role`` is given.
            role: ``viewer``, ``operator`` or ``owner``; None where ``scopes`` are given.
            seconds: time that it is valid [s]; None: until it is revoked.
            timeout: time-out of the call in all [s].
        """
        given = {"label": label, "role": role, "scopes": scopes, "seconds": seconds}
        asked = model(TokenRequest, given)
        call = Call("POST", "/v1/tokens", NewToken, asked, once=True)
        return await self._transport.send(call, timeout)

    async def revoke(self, token_id: str, *, timeout: CallTimeout = CAMERA_TIMEOUT) -> Token:
        """End a token now."""
        call = Call("DELETE", f"/v1/tokens/{part('token_id', token_id)}", Token)
        return await self._transport.send(call, timeout)


class AsyncReceiverResource(AsyncResource):
    """Receivers, to whom embeddings are sealed."""

    async def list(self, *, timeout: CallTimeout = CAMERA_TIMEOUT) -> Receivers:
        """Return all receivers, and the key of the device that seals to them."""
        return await self._transport.send(Call("GET", "/v1/receivers", Receivers), timeout)

    async def add(
        self, label: str, key: Receiver | str, *, timeout: CallTimeout = CAMERA_TIMEOUT
    ) -> PairedReceiver:
        """Seal to one receiver more, from the next mask on.

        Args:
            label: label for people; it stands in the status and in the log.
            key: public key of the receiver, as ``veilcam receiver keygen`` prints it.
            timeout: time-out of the call in all [s].
        """
        asked = model(ReceiverRequest, {"label": label, "key": str(key)})
        call = Call("POST", "/v1/receivers", PairedReceiver, asked, once=True)
        return await self._transport.send(call, timeout)

    async def remove(self, receiver_id: str, *, timeout: CallTimeout = CAMERA_TIMEOUT) -> Nothing:
        """Seal to a receiver no more, from the next mask on; what it has it still opens."""
        call = Call("DELETE", f"/v1/receivers/{part('receiver_id', receiver_id)}", Nothing)
        return await self._transport.send(call, timeout)

    async def offer(
        self, role: Role = "operator", *, timeout: CallTimeout = CAMERA_TIMEOUT
    ) -> PairingOffer:
        """Offer to pair one receiver: whoever has the ``line`` may, once, and soon.

        Args:
            role: role of the token that the receiver's user gets.
            timeout: time-out of the call in all [s].
        """
        asked = model(PairingRequest, {"role": role})
        call = Call("POST", "/v1/pairing", PairingOffer, asked, once=True)
        return await self._transport.send(call, timeout)

    async def claim(
        self, secret: str, label: str, key: Receiver | str, *, timeout: CallTimeout = CAMERA_TIMEOUT
    ) -> Paired:
        """Pair a receiver by the secret of an offer; ``veilcam pair`` does all of it.

        Args:
            secret: secret of the offer's line, 32 hexadecimal digits.
            label: label for people; it stands in the status and in the log.
            key: public key of the receiver.
            timeout: time-out of the call in all [s].
        """
        asked = model(PairingClaim, {"secret": secret, "label": label, "key": str(key)})
        call = Call("POST", "/v1/pairing/claim", Paired, asked)
        return await self._transport.send(call, timeout)


class AsyncCalibrationResource(AsyncResource):
    """Calibration: the camera measured with itself."""

    async def get(self, *, timeout: CallTimeout = CAMERA_TIMEOUT) -> CalibrationStatus:
        """Return the calibration in use, and the progress of a running one."""
        return await self._transport.send(Call("GET", _CALIBRATION, CalibrationStatus), timeout)

    async def start(
        self, *, repeats: int = 2, wait: float | None = None, timeout: CallTimeout = CAMERA_TIMEOUT
    ) -> CalibrationRun:
        """Begin to measure; the camera takes no captures meanwhile.

        It goes on by itself but for scenes that somebody must set: see ``stage`` and
        ``instruction`` of :meth:`get` or of the events, and :meth:`confirm`.
        """
        asked = model(CalibrationRequest, {"repeats": repeats})
        call = Call("POST", _CALIBRATION, CalibrationRun, asked, once=True)
        return await self._transport.send(call, timeout, wait=wait)

    async def confirm(
        self, scene: SceneName, *, timeout: CallTimeout = CAMERA_TIMEOUT
    ) -> CalibrationRun:
        """Confirm that the scene that the calibration waits for is set."""
        asked = model(SceneConfirmation, {"scene": scene})
        call = Call("POST", f"{_CALIBRATION}/scene", CalibrationRun, asked, once=True)
        return await self._transport.send(call, timeout)

    async def cancel(self, *, timeout: CallTimeout = CAMERA_TIMEOUT) -> CalibrationRun:
        """End the calibration that is under way; what was in use before stays in use."""
        return await self._transport.send(Call("DELETE", _CALIBRATION, CalibrationRun), timeout)


class AsyncRotationResource(AsyncResource):
    """Rotation: changes of the mask."""

    async def get(self, *, timeout: CallTimeout = CAMERA_TIMEOUT) -> Rotation:
        """Return the rotation policy and the present mask epoch."""
        return await self._transport.send(Call("GET", "/v1/rotation", Rotation), timeout)

    async def set(
        self,
        policy: RotationPolicy,
        *,
        wait: float | None = None,
        timeout: CallTimeout = CAMERA_TIMEOUT,
    ) -> Rotation:
        """Change when masks change."""
        kinds = (RotationOff, EverySeconds, EveryCaptures)
        of_type("policy", policy, kinds, "RotationOff, EverySeconds or EveryCaptures")
        call = Call("PUT", "/v1/rotation", Rotation, policy)
        return await self._transport.send(call, timeout, wait=wait)

    async def advance(
        self, *, wait: float | None = None, timeout: CallTimeout = CAMERA_TIMEOUT
    ) -> Rotation:
        """Show another mask now."""
        call = Call("POST", "/v1/rotation/advance", Rotation, once=True)
        return await self._transport.send(call, timeout, wait=wait)


class AsyncWatchResource(AsyncResource):
    """Watch: the camera looks by itself."""

    async def get(self, *, timeout: CallTimeout = CAMERA_TIMEOUT) -> Watch:
        """Return the policy of the watch, and the belief of the camera about the scene."""
        return await self._transport.send(Call("GET", "/v1/watch", Watch), timeout)

    async def set(
        self,
        policy: WatchPolicy,
        *,
        wait: float | None = None,
        timeout: CallTimeout = CAMERA_TIMEOUT,
    ) -> Watch:
        """Let the camera look by itself, or on request alone, or not at all."""
        kinds = (WatchOff, OnRequest, Watching)
        of_type("policy", policy, kinds, "WatchOff, OnRequest or Watching")
        return await self._transport.send(
            Call("PUT", "/v1/watch", Watch, policy), timeout, wait=wait
        )


class AsyncLogResource(AsyncResource):
    """Signed log of what left, and of who changed it; see docs/capture-log.md."""

    async def list(
        self,
        *,
        limit: int = RECORDS_AT_ONCE,
        after: int | None = None,
        newest: bool = False,
        timeout: CallTimeout = CAMERA_TIMEOUT,
    ) -> LogRecords:
        """Return records, the oldest first.

        Args:
            limit: greatest number of records.
            after: position after which records are wanted, as ``next`` of an answer names it.
            newest: True: the newest records, instead of the oldest.
            timeout: time-out of the call in all [s].
        """
        start = "" if after is None else f"&after={whole('after', after, 0)}"
        start += "&newest=true" if newest else ""
        path = f"/v1/log?limit={whole('limit', limit, 1, RECORDS_AT_ONCE)}{start}"
        return await self._transport.send(Call("GET", path, LogRecords), timeout)


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
        call = Call("DELETE", "/v1/simulation/scene", HeldScene)
        if picture is not None:
            content = picture_bytes(picture)
            call = Call("PUT", call.path, HeldScene, content, picture_media_type(content))
        return await self._transport.send(call, timeout)

    async def set_faults(self, faults: Faults, *, timeout: CallTimeout = CAMERA_TIMEOUT) -> Faults:
        """Break the camera; ``Faults()`` mends it. Return its faults from now on."""
        of_type("faults", faults, Faults, "Faults(...)")
        call = Call("PUT", "/v1/simulation/faults", Faults, faults)
        return await self._transport.send(call, timeout)


class AsyncLeaseResource(AsyncResource):
    """Lease: the camera for oneself, for a while."""

    async def get(self, *, timeout: CallTimeout = CAMERA_TIMEOUT) -> Lease:
        """Return the holder of the camera, and the remaining time."""
        return await self._transport.send(Call("GET", "/v1/lease", Lease), timeout)

    async def take(
        self,
        *,
        seconds: float,
        owner: str = "veilcam_client",
        wait: float | None = None,
        timeout: CallTimeout = CAMERA_TIMEOUT,
    ) -> NewLease:
        """Hold the camera, or go on holding it: for so long, others take no captures [s]."""
        asked = model(LeaseRequest, {"owner": owner, "seconds": seconds})
        call = Call("POST", "/v1/lease", NewLease, asked, once=True)
        taken = await self._transport.send(call, timeout, wait=wait)
        self._transport.options.credentials.lease = taken.secret
        return taken

    async def release(self, *, timeout: CallTimeout = CAMERA_TIMEOUT) -> Lease:
        """Hold the camera no longer."""
        released = await self._transport.send(Call("DELETE", "/v1/lease", Lease), timeout)
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
        call = Call("DELETE", "/v1/lease?force=true", Lease)
        return await self._transport.send(call, timeout)
