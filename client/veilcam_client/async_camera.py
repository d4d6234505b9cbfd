"""The camera as a program sees it, for asyncio."""

from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import asynccontextmanager
from types import TracebackType
from typing import TYPE_CHECKING, ParamSpec, Self, TypeVar

from veilcam_client.discovery import FoundCamera, discover
from veilcam_client.http import calls
from veilcam_client.http.answers import RawResponse, kept_answers, raw_response
from veilcam_client.http.async_streams import AsyncEventStream
from veilcam_client.http.async_transport import AsyncHttpClient, AsyncTransport
from veilcam_client.http.credentials import Credentials
from veilcam_client.http.deadline import CAMERA_TIMEOUT, CallTimeout
from veilcam_client.http.options import Options, RetryPolicy, address, follow_environment
from veilcam_client.keys.opening import KeySource, opened, opener_of
from veilcam_client.wire.bundles import InstalledBundle
from veilcam_client.wire.calibration import CalibrationRun, CalibrationStatus, SceneName
from veilcam_client.wire.captures import Capture, Classification
from veilcam_client.wire.lease import Lease, NewLease
from veilcam_client.wire.log import RECORDS_AT_ONCE, LogHead, LogRecords
from veilcam_client.wire.rotation import Rotation, RotationPolicy
from veilcam_client.wire.sealing import PairedReceiver, Receivers
from veilcam_client.wire.simulation import Faults, HeldScene, picture_bytes
from veilcam_client.wire.status import Diagnostics, Status
from veilcam_client.wire.tokens import TOKENS_AT_ONCE, NewToken, Scope, Token, Tokens
from veilcam_client.wire.watch import Watch, WatchPolicy

if TYPE_CHECKING:
    import numpy.typing as npt

    from veilcam_client.keys.receivers import Receiver


P = ParamSpec("P")
ResultT = TypeVar("ResultT")


class AsyncCamera:
    """One connection to a ``veilcamd`` for asyncio.

    While another holds the camera, a method raises ``LeasedError`` at once. Those that take
    ``wait=`` wait so long for the lease to end [s], before their ``timeout`` begins.

    Repetitions stand in the log ``veilcam`` of ``logging``; ``VEILCAM_LOG=debug`` shows every
    request on the terminal.

    Args:
        url: ``http://HOST:PORT``, or ``unix:///PATH`` for a unix socket; that in ``VEILCAM_URL`` if
            None, else that of a daemon on this machine.
        timeout: time-out of a call with repetitions and their pauses [s]; None: no limit. Every
            method takes one of its own.
        connect_timeout: time-out of a connection to the daemon [s].
        read_timeout: between two pieces of an answer [s]; it must cover settling and exposure.
        max_retries: number of repetitions of a request that may succeed later.
        key: private key of a receiver, or its file: embeddings come opened, each with its notes,
            and one that is not sealed to it, or that came before or later than the next one of its
            mask, raises ``SealedError``. So ask for one after the other.
        device: public key of the camera, 64 hexadecimal digits, as ``veilcam receiver add`` prints
            it; that of the first embedding that is opened if None.
        token: made by ``veilcamd token create``; that in ``VEILCAM_TOKEN`` if None. It goes over
            https, unix sockets, and http to this machine, nowhere else.
        ca_file: PEM file of the authority that vouches for an https daemon; that in
            ``VEILCAM_CA_FILE`` if None, else those that the system trusts.
        http_client: an ``httpx.AsyncClient`` to use instead of an own one; it is not closed. Where
            such a client is not for asyncio, a deadline is asked for between two pieces alone.

    Raises:
        ArgumentError: an argument that cannot be used; the message names it. Every method raises
            it, too, also where the camera is closed. It is a ``ValueError``.
        KeyFileError: a key's file that cannot be used.
    """

    def __init__(
        self,
        url: str | None = None,
        *,
        timeout: float | None = 120.0,
        connect_timeout: float = 2.0,
        read_timeout: float = 30.0,
        max_retries: int = 2,
        key: KeySource | None = None,
        device: str | None = None,
        token: str | None = None,
        ca_file: str | os.PathLike[str] | None = None,
        http_client: AsyncHttpClient | None = None,
    ) -> None:
        follow_environment()
        self._opener = opener_of(key, device)
        retry, credentials = RetryPolicy(retries=max_retries), Credentials(token, ca_file)
        options = Options(address(url), timeout, connect_timeout, read_timeout, retry, credentials)
        self._transport = AsyncTransport(options, http_client)

    def __repr__(self) -> str:
        return f"AsyncCamera({self._transport.options.url!r})"

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        await self.close()

    @classmethod
    async def discover(cls, seconds: float = 3.0) -> tuple[FoundCamera, ...]:
        """Cameras that announce themselves on the local network; none is asked or told anything.

        Args:
            seconds: time to listen [s].

        Raises:
            DiscoveryError: the extra ``discover`` is not installed, or there is no network.
        """
        return await asyncio.to_thread(discover, seconds)

    async def close(self) -> None:
        """Close the connection."""
        await self._transport.close()

    async def status(self, *, timeout: CallTimeout = CAMERA_TIMEOUT) -> Status:
        """State, device, bundle, rotation and queue of the daemon."""
        return await self._transport.send(calls.STATUS, timeout)

    async def calibration(self, *, timeout: CallTimeout = CAMERA_TIMEOUT) -> CalibrationStatus:
        """Return the calibration in use, and how a running one goes on."""
        return await self._transport.send(calls.CALIBRATION, timeout)

    async def start_calibration(
        self, *, repeats: int = 2, wait: float | None = None, timeout: CallTimeout = CAMERA_TIMEOUT
    ) -> CalibrationRun:
        """Begin to measure the camera with itself; it takes no captures meanwhile.

        It goes on by itself but for scenes that somebody must set: see ``stage`` and
        ``instruction`` of :meth:`calibration` or of the events, and :meth:`confirm_scene`.
        """
        return await self._transport.send(calls.start_calibration(repeats), timeout, wait=wait)

    async def confirm_scene(
        self, scene: SceneName, *, timeout: CallTimeout = CAMERA_TIMEOUT
    ) -> CalibrationRun:
        """Confirm that the scene that the calibration waits for is set."""
        return await self._transport.send(calls.confirm_scene(scene), timeout)

    async def cancel_calibration(self, *, timeout: CallTimeout = CAMERA_TIMEOUT) -> CalibrationRun:
        """End the calibration that is under way; what was in use before stays in use."""
        return await self._transport.send(calls.CANCEL_CALIBRATION, timeout)

    async def capture(
        self, *, wait: float | None = None, timeout: CallTimeout = CAMERA_TIMEOUT
    ) -> Capture:
        """Take one embedding; ``np.asarray`` of the result is the array, if ``key`` opens it."""
        return opened(await self._transport.send(calls.CAPTURE, timeout, wait=wait), self._opener)

    async def classify(
        self,
        *,
        include_embedding: bool = False,
        wait: float | None = None,
        timeout: CallTimeout = CAMERA_TIMEOUT,
    ) -> Classification:
        """Take one embedding and classify it on the device."""
        answer = await self._transport.send(calls.classify(include_embedding), timeout, wait=wait)
        return opened(answer, self._opener)

    async def rotation(self, *, timeout: CallTimeout = CAMERA_TIMEOUT) -> Rotation:
        """Return the rotation policy and the present mask epoch."""
        return await self._transport.send(calls.ROTATION, timeout)

    async def set_rotation(
        self,
        policy: RotationPolicy,
        *,
        wait: float | None = None,
        timeout: CallTimeout = CAMERA_TIMEOUT,
    ) -> Rotation:
        """Change when masks change."""
        return await self._transport.send(calls.set_rotation(policy), timeout, wait=wait)

    async def rotate(
        self, *, wait: float | None = None, timeout: CallTimeout = CAMERA_TIMEOUT
    ) -> Rotation:
        """Show another mask now."""
        return await self._transport.send(calls.ROTATE, timeout, wait=wait)

    async def watch(self, *, timeout: CallTimeout = CAMERA_TIMEOUT) -> Watch:
        """Return the policy of the watch, and what the camera believes to see."""
        return await self._transport.send(calls.WATCH, timeout)

    async def set_watch(
        self,
        policy: WatchPolicy,
        *,
        wait: float | None = None,
        timeout: CallTimeout = CAMERA_TIMEOUT,
    ) -> Watch:
        """Let the camera look by itself, or on request alone, or not at all."""
        return await self._transport.send(calls.set_watch(policy), timeout, wait=wait)

    async def take_lease(
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

    async def release_lease(self, *, timeout: CallTimeout = CAMERA_TIMEOUT) -> Lease:
        """Hold the camera no longer."""
        released = await self._transport.send(calls.release_lease(), timeout)
        self._transport.options.credentials.lease = None
        return released

    @asynccontextmanager
    async def lease(
        self,
        *,
        seconds: float,
        owner: str = "veilcam_client",
        wait: float | None = None,
        timeout: CallTimeout = CAMERA_TIMEOUT,
    ) -> AsyncIterator[NewLease]:
        """Hold the camera within the context; :meth:`take_lease` within it renews."""
        taken = await self.take_lease(seconds=seconds, owner=owner, wait=wait, timeout=timeout)
        try:
            yield taken
        finally:
            await self.release_lease(timeout=timeout)

    async def break_lease(self, *, timeout: CallTimeout = CAMERA_TIMEOUT) -> Lease:
        """End the lease of whoever holds the camera; wants the scope ``admin:tokens`` too."""
        return await self._transport.send(calls.release_lease(force=True), timeout)

    async def lease_state(self, *, timeout: CallTimeout = CAMERA_TIMEOUT) -> Lease:
        """Return the holder of the camera, and the remaining time."""
        return await self._transport.send(calls.LEASE_STATE, timeout)

    async def diagnostics(self, *, timeout: CallTimeout = CAMERA_TIMEOUT) -> Diagnostics:
        """Versions, settings, and the last states and faults of the daemon."""
        return await self._transport.send(calls.DIAGNOSTICS, timeout)

    async def tokens(
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

    async def create_token(
        self,
        label: str,
        scopes: Sequence[Scope],
        *,
        seconds: int | None = None,
        timeout: CallTimeout = CAMERA_TIMEOUT,
    ) -> NewToken:
        """Make a token that is valid for so long [s]; its ``secret`` is told this once."""
        return await self._transport.send(calls.create_token(label, scopes, seconds), timeout)

    async def revoke_token(self, token_id: str, *, timeout: CallTimeout = CAMERA_TIMEOUT) -> Token:
        """Let a token do nothing any more."""
        return await self._transport.send(calls.revoke_token(token_id), timeout)

    async def log(
        self,
        *,
        limit: int = RECORDS_AT_ONCE,
        after: int | None = None,
        timeout: CallTimeout = CAMERA_TIMEOUT,
    ) -> LogRecords:
        """Return signed records of what was answered, the oldest first; see docs/capture-log.md.

        Args:
            limit: greatest number of records.
            after: position after which records are wanted, as ``next`` of an answer names it.
            timeout: time-out of the call in all [s].
        """
        return await self._transport.send(calls.log(limit, after), timeout)

    async def log_head(self, *, timeout: CallTimeout = CAMERA_TIMEOUT) -> LogHead:
        """Return the signed end of the log: keep it, and what is dropped from that end shows."""
        return await self._transport.send(calls.LOG_HEAD, timeout)

    async def receivers(self, *, timeout: CallTimeout = CAMERA_TIMEOUT) -> Receivers:
        """To whom embeddings are sealed, and the key of the device that seals them."""
        return await self._transport.send(calls.RECEIVERS, timeout)

    async def add_receiver(
        self, label: str, key: Receiver | str, *, timeout: CallTimeout = CAMERA_TIMEOUT
    ) -> PairedReceiver:
        """Seal to one receiver more, from the next mask on.

        Args:
            label: label for people; it stands in the status and in the audit log.
            key: public key of the receiver, as ``veilcam receiver keygen`` prints it.
            timeout: time-out of the call in all [s].
        """
        return await self._transport.send(calls.add_receiver(label, str(key)), timeout)

    async def remove_receiver(
        self, receiver_id: str, *, timeout: CallTimeout = CAMERA_TIMEOUT
    ) -> None:
        """Seal to a receiver no more, from the next mask on; what it has it still opens."""
        await self._transport.send(calls.remove_receiver(receiver_id), timeout)

    async def hold_scene(
        self, picture: npt.ArrayLike | bytes | None, *, timeout: CallTimeout = CAMERA_TIMEOUT
    ) -> HeldScene:
        """Hold a picture up before a simulated camera that allows it; None takes it away.

        Args:
            picture: the content of a PNG, JPEG, WebP, BMP, TIFF, GIF or ``.npy`` file, or an array
                (rows, columns) or (rows, columns, 3), uint8, or floats in [0, 1].
            timeout: time-out of the call in all [s].
        """
        if picture is None:
            return await self._transport.send(calls.TAKE_SCENE_AWAY, timeout)
        return await self._transport.send(calls.hold_scene(picture_bytes(picture)), timeout)

    async def set_faults(self, faults: Faults, *, timeout: CallTimeout = CAMERA_TIMEOUT) -> Faults:
        """Break a simulated camera that allows it; ``Faults()`` mends it.

        Returns:
            What is wrong with it from now on.
        """
        return await self._transport.send(calls.set_faults(faults), timeout)

    async def bundles(
        self, *, timeout: CallTimeout = CAMERA_TIMEOUT
    ) -> tuple[InstalledBundle, ...]:
        """All bundles; one of them is ``active``."""
        return (await self._transport.send(calls.BUNDLES, timeout)).bundles

    async def install_bundle(
        self, bundle: bytes, *, timeout: CallTimeout = CAMERA_TIMEOUT
    ) -> InstalledBundle:
        """Hand over the content of a bundle; it is checked, and not used yet."""
        return await self._transport.send(calls.install_bundle(bundle), timeout)

    async def activate_bundle(
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
        return await self._transport.send(
            calls.activate_bundle(digest, allow_older), timeout, wait=wait
        )

    async def remove_bundle(
        self, digest: str, *, timeout: CallTimeout = CAMERA_TIMEOUT
    ) -> tuple[InstalledBundle, ...]:
        """Remove a bundle that is not in use for good; return those that are left."""
        return (await self._transport.send(calls.remove_bundle(digest), timeout)).bundles

    def events(
        self, *, last_event_id: str | None = None, reconnect: bool = True
    ) -> AsyncEventStream:
        """Events as they happen; a context, or a loop that ends when the stream is closed.

        It is opened again by itself when it breaks, after the last event; a ``Gap`` tells of missed
        ones.

        Args:
            last_event_id: go on after this event; None: from now on.
            reconnect: True: a broken stream is opened again; False: the error is raised.
        """
        return AsyncEventStream(self._transport, last_event_id, reconnect)

    async def raw(
        self, method: Callable[P, Awaitable[ResultT]], *args: P.args, **options: P.kwargs
    ) -> RawResponse[ResultT]:
        """Return the answer to a method as it came, beside its result.

        ``camera.raw(camera.classify, timeout=9)`` has the status, the headers and the content;
        its ``parse()`` is the method's result.
        """
        with kept_answers() as kept:
            result = await method(*args, **options)
        return raw_response(kept, result)
