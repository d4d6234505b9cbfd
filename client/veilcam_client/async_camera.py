"""The camera as a program sees it, for asyncio."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Awaitable, Callable
from typing import ParamSpec, Self, TypeVar

from veilcam_client.arguments import model
from veilcam_client.async_resources import (
    AsyncBundleResource,
    AsyncCalibrationResource,
    AsyncLeaseResource,
    AsyncLogResource,
    AsyncReceiverResource,
    AsyncRotationResource,
    AsyncSimulationResource,
    AsyncTokenResource,
    AsyncWatchResource,
)
from veilcam_client.discovery import FoundCamera, discover
from veilcam_client.http.answers import RawResponse, kept_answers, raw_response
from veilcam_client.http.async_streams import AsyncEventStream
from veilcam_client.http.async_transport import AsyncHttpClient, AsyncTransport
from veilcam_client.http.calls import Call
from veilcam_client.http.credentials import Credentials
from veilcam_client.http.deadline import CAMERA_TIMEOUT, CallTimeout
from veilcam_client.http.options import Options, RetryPolicy, follow_environment
from veilcam_client.keys.opening import KeySource, opened, opener_of
from veilcam_client.profiles import Profile, profile_of
from veilcam_client.wire.captures import (
    NPY_MEDIA_TYPE,
    Capture,
    Classification,
    ClassificationRequest,
)
from veilcam_client.wire.status import Diagnostics, Status

P = ParamSpec("P")
ResultT = TypeVar("ResultT")


class AsyncCamera:
    """One connection to a ``veilcamd`` for asyncio.

    What is managed beside captures has a resource each: ``camera.bundles``, ``tokens``,
    ``receivers``, ``calibration``, ``rotation``, ``watch``, ``log``, ``lease`` and ``simulation``.

    While another holds the camera, a method raises ``LeasedError`` at once. Those that take
    ``wait=`` wait so long for the lease to end [s], before their ``timeout`` begins.

    Repetitions stand in the log ``veilcam`` of ``logging``; ``VEILCAM_LOG=debug`` shows every
    request on the terminal.

    Args:
        url: ``http://HOST:PORT``, or ``unix:///PATH`` for a unix socket. If None, the camera of the
            profile, else that in ``VEILCAM_URL``, else that of the default profile, else a daemon
            on this machine.
        profile: name of a profile in ``veilcam/config.toml``, as ``veilcam pair`` makes it: URL,
            token, certificate, key and device, none of which reaches another camera. That in
            ``VEILCAM_PROFILE`` if None and there is no ``url``.
        timeout: time-out of a call with repetitions and their pauses [s]; None: no limit. Every
            method takes one of its own.
        connect_timeout: time-out of a connection to the daemon [s].
        read_timeout: between two pieces of an answer [s]; it must cover settling and exposure.
        max_retries: number of repetitions of a request that may succeed later.
        key: private key of a receiver, or its file: embeddings come opened, each with its notes,
            and one that is not sealed to it, or that came before or later than the next one of its
            mask, raises ``SealedError``. So ask for one after the other.
            That of the profile if None.
        device: public key of the camera, 64 hexadecimal digits, as ``veilcam receiver add`` prints
            it; that of the profile if None, else that of the first embedding that is opened.
        token: made by ``veilcamd token create``; that of the profile or in ``VEILCAM_TOKEN`` if
            None. It goes over https, unix sockets, and http to this machine, nowhere else.
        ca_file: PEM file of the authority that vouches for an https daemon; that of the profile or
            in ``VEILCAM_CA_FILE`` if None, else those that the system trusts.
        http_client: an ``httpx.AsyncClient`` to use instead of an own one; it is not closed. Where
            such a client is not for asyncio, a deadline is asked for between two pieces alone.

    Raises:
        ArgumentError: an argument that cannot be used; the message names it. Every method raises
            it, too, also where the camera is closed. It is a ``ValueError``.
        FileError: a key's file that cannot be used.
    """

    def __init__(
        self,
        url: str | None = None,
        *,
        profile: str | Profile | None = None,
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
        own = profile_of(url, profile, token=token, ca_file=ca_file, key=key, device=device)
        self._opener = opener_of(own.key, own.device)
        retry = RetryPolicy(retries=max_retries)
        credentials = Credentials(own.token, own.ca_file, own.certificate)
        options = Options(own.url, timeout, connect_timeout, read_timeout, retry, credentials)
        self._transport = transport = AsyncTransport(options, http_client)
        self.bundles: AsyncBundleResource = AsyncBundleResource(transport)
        self.tokens: AsyncTokenResource = AsyncTokenResource(transport)
        self.receivers: AsyncReceiverResource = AsyncReceiverResource(transport)
        self.calibration: AsyncCalibrationResource = AsyncCalibrationResource(transport)
        self.rotation: AsyncRotationResource = AsyncRotationResource(transport)
        self.watch: AsyncWatchResource = AsyncWatchResource(transport)
        self.log: AsyncLogResource = AsyncLogResource(transport)
        self.lease: AsyncLeaseResource = AsyncLeaseResource(transport)
        self.simulation: AsyncSimulationResource = AsyncSimulationResource(transport)

    def __repr__(self) -> str:
        return f"AsyncCamera({self._transport.options.url!r})"

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    @classmethod
    async def discover(cls, seconds: float = 3.0) -> tuple[FoundCamera, ...]:
        """Cameras that announce themselves on the local network; none is asked or told anything.

        Args:
            seconds: time to listen [s].

        Raises:
            VeilcamError: the extra ``discover`` is not installed, or there is no network (code
                ``discovery_failed``).
        """
        return await asyncio.to_thread(discover, seconds)

    async def close(self) -> None:
        """Close the connection."""
        await self._transport.close()

    async def status(self, *, timeout: CallTimeout = CAMERA_TIMEOUT) -> Status:
        """Return state, device, bundle, rotation and queue of the daemon."""
        return await self._transport.send(Call("GET", "/v1/status", Status), timeout)

    async def capture(
        self, *, wait: float | None = None, timeout: CallTimeout = CAMERA_TIMEOUT
    ) -> Capture:
        """Take one embedding; ``np.asarray`` of the result is the array, if ``key`` opens it."""
        # As an array where it is one: it is read several times faster, and a sealed one is none.
        accept = f"{NPY_MEDIA_TYPE}, application/json;q=0.9"
        call = Call("POST", "/v1/captures", Capture, once=True, accept=accept)
        return opened(await self._transport.send(call, timeout, wait=wait), self._opener)

    async def classify(
        self,
        *,
        include_embedding: bool = False,
        wait: float | None = None,
        timeout: CallTimeout = CAMERA_TIMEOUT,
    ) -> Classification:
        """Take one embedding and classify it on the device."""
        # What a body would say goes without saying, and without it the request is one packet.
        asked = model(ClassificationRequest, {"include_embedding": include_embedding})
        body = asked if asked.include_embedding else None
        call = Call("POST", "/v1/classifications", Classification, body, once=True)
        return opened(await self._transport.send(call, timeout, wait=wait), self._opener)

    async def diagnostics(self, *, timeout: CallTimeout = CAMERA_TIMEOUT) -> Diagnostics:
        """Return versions, settings, and the last states and faults of the daemon."""
        return await self._transport.send(Call("GET", "/v1/diagnostics", Diagnostics), timeout)

    def events(
        self, *, last_event_id: str | None = None, reconnect: bool = True
    ) -> AsyncEventStream:
        """Return events as they happen; a context, or a loop that ends when the stream is closed.

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
