"""The camera as a program sees it; ``async_camera.py`` has the same surface for asyncio."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import TracebackType
from typing import TYPE_CHECKING, Self, TypeAlias, TypeVar

import numpy.typing as npt

from veilcam_client.http import calls
from veilcam_client.http.credentials import Credentials
from veilcam_client.http.transport import HttpClient, Options, RetryPolicy, Transport
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
    from veilcam_client.keys.blocks import Opener
    from veilcam_client.keys.receivers import Receiver, ReceiverKey

DEFAULT_URL = "http://127.0.0.1:8787"
KeySource: TypeAlias = "str | os.PathLike[str] | ReceiverKey"
"""A receiver's private key, or its file."""

TakenT = TypeVar("TakenT", Capture, Classification)


def receiver_key(source: KeySource) -> ReceiverKey:
    """A receiver's private key; raises ``KeyFileError``."""
    # Late: whoever opens nothing need not wait for the cryptography to load.
    from veilcam_client.keys.receivers import ReceiverKey  # noqa: PLC0415

    return source if isinstance(source, ReceiverKey) else ReceiverKey.read(source)


def opener_of(key: KeySource | None, device: str | None) -> Opener | None:
    """What opens sealed embeddings; None: nothing does."""
    if key is None:
        if device is not None:
            raise ValueError("device= is checked when embeddings are opened: give key= as well")
        return None
    from veilcam_client.keys.blocks import Opener  # noqa: PLC0415 - late, as above

    return Opener(receiver_key(key), device)


def opened(answer: TakenT, opener: Opener | None) -> TakenT:
    """An answer with its embedding opened, where there is what opens it."""
    return answer if opener is None else opener.open(answer)


class Camera:
    """One connection to a ``veilcamd``.

    Args:
        url: ``http://HOST:PORT``, or ``unix:///PATH`` for a unix socket.
        connect_timeout: to reach the daemon [s].
        read_timeout: between two pieces of an answer [s]; it must cover settling and exposure.
        max_retries: how often a request that may succeed later is repeated.
        key: private key of a receiver, or its file: embeddings come opened, each with its notes,
            and one that is not sealed to it, or that came before or later than the next one of its
            mask, raises ``SealedError``. So ask for one after the other.
        device: public key of the camera, 64 hexadecimal digits, as ``veilcam receiver add`` prints
            it; that of the first embedding that is opened if None.
        token: made by ``veilcamd token create``; that in ``VEILCAM_TOKEN`` if None. It goes over
            https, unix sockets, and http to this machine, nowhere else.
        ca_file: PEM file of the authority that vouches for an https daemon; that in
            ``VEILCAM_CA_FILE`` if None, else those that the system trusts.
        http_client: an ``httpx.Client`` to use instead of an own one; it is not closed.

    Raises:
        ValueError: a URL, timeout, token, file or device that cannot be used.
        KeyFileError: a key's file that cannot be used.
    """

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
        http_client: HttpClient | None = None,
    ) -> None:
        self._opener = opener_of(key, device)
        retry, credentials = RetryPolicy(retries=max_retries), Credentials(token, ca_file)
        options = Options(url, connect_timeout, read_timeout, retry, credentials)
        self._transport = Transport(options, http_client)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the connection."""
        self._transport.close()

    def status(self) -> Status:
        """State, device, bundle, rotation and queue of the daemon."""
        return self._transport.send(calls.STATUS)

    def calibration(self) -> CalibrationStatus:
        """What the camera found out about itself, and how finding out goes on."""
        return self._transport.send(calls.CALIBRATION)

    def start_calibration(self, *, repeats: int = 2) -> CalibrationRun:
        """Begin to measure the camera with itself; it takes no captures meanwhile.

        It goes on by itself but for scenes that somebody must set: see ``stage`` and
        ``instruction`` of :meth:`calibration` or of the events, and :meth:`confirm_scene`.
        """
        return self._transport.send(calls.start_calibration(repeats))

    def confirm_scene(self, scene: SceneName) -> CalibrationRun:
        """Confirm that the scene that the calibration waits for is set."""
        return self._transport.send(calls.confirm_scene(scene))

    def cancel_calibration(self) -> CalibrationRun:
        """End the calibration that is under way; what was in use before stays in use."""
        return self._transport.send(calls.CANCEL_CALIBRATION)

    def capture(self) -> Capture:
        """Take one embedding; ``np.asarray`` of the result is the array, if ``key`` opens it."""
        return opened(self._transport.send(calls.CAPTURE), self._opener)

    def classify(self, *, include_embedding: bool = False) -> Classification:
        """Take one embedding and classify it on the device."""
        answer = self._transport.send(calls.classify(include_embedding))
        return opened(answer, self._opener)

    def rotation(self) -> Rotation:
        """The rotation policy and the present mask epoch."""
        return self._transport.send(calls.ROTATION)

    def set_rotation(self, policy: RotationPolicy) -> Rotation:
        """Change when masks change."""
        return self._transport.send(calls.set_rotation(policy))

    def rotate(self) -> Rotation:
        """Show another mask now."""
        return self._transport.send(calls.ROTATE)

    def take_lease(self, *, seconds: float, owner: str = "veilcam_client") -> NewLease:
        """Hold the camera, or go on holding it: for so long, others take no captures [s]."""
        taken = self._transport.send(calls.take_lease(seconds, owner))
        self._transport.options.credentials.lease = taken.secret
        return taken

    def release_lease(self) -> Lease:
        """Hold the camera no longer."""
        released = self._transport.send(calls.release_lease())
        self._transport.options.credentials.lease = None
        return released

    @contextmanager
    def lease(self, *, seconds: float, owner: str = "veilcam_client") -> Iterator[NewLease]:
        """Hold the camera within the context; :meth:`take_lease` within it renews."""
        taken = self.take_lease(seconds=seconds, owner=owner)
        try:
            yield taken
        finally:
            self.release_lease()

    def break_lease(self) -> Lease:
        """End the lease of whoever holds the camera; wants the scope ``admin:tokens`` too."""
        return self._transport.send(calls.release_lease(force=True))

    def lease_state(self) -> Lease:
        """Who holds the camera, and how long."""
        return self._transport.send(calls.LEASE_STATE)

    def diagnostics(self) -> Diagnostics:
        """Versions, settings, and the last states and faults of the daemon."""
        return self._transport.send(calls.DIAGNOSTICS)

    def tokens(self, *, limit: int = TOKENS_AT_ONCE, after: str | None = None) -> Tokens:
        """Return tokens, the oldest first, revoked and expired ones included.

        Args:
            limit: so many at most.
            after: those that follow the token of this id, as ``next`` of an answer names it.
        """
        return self._transport.send(calls.tokens(limit, after))

    def create_token(
        self, label: str, scopes: Sequence[Scope], *, seconds: int | None = None
    ) -> NewToken:
        """Make a token that is valid for so long [s]; its ``secret`` is told this once."""
        return self._transport.send(calls.create_token(label, scopes, seconds))

    def revoke_token(self, token_id: str) -> Token:
        """Let a token do nothing any more."""
        return self._transport.send(calls.revoke_token(token_id))

    def log(self, *, limit: int = RECORDS_AT_ONCE, after: int | None = None) -> LogRecords:
        """Return signed records of what was answered, the oldest first; see docs/capture-log.md.

        Args:
            limit: so many at most.
            after: those that follow this position, as ``next`` of an answer names it.
        """
        return self._transport.send(calls.log(limit, after))

    def log_head(self) -> LogHead:
        """Where the log ends now, signed: keep it, and what is dropped from that end shows."""
        return self._transport.send(calls.LOG_HEAD)

    def receivers(self) -> Receivers:
        """To whom embeddings are sealed, and the key of the device that seals them."""
        return self._transport.send(calls.RECEIVERS)

    def add_receiver(self, label: str, key: Receiver | str) -> PairedReceiver:
        """Seal to one receiver more, from the next mask on.

        Args:
            label: for whom or what it is; it stands in the status and in the audit log.
            key: its public key, as ``veilcam receiver keygen`` prints it.
        """
        return self._transport.send(calls.add_receiver(label, str(key)))

    def remove_receiver(self, receiver_id: str) -> None:
        """Seal to a receiver no more, from the next mask on; what it has it still opens."""
        self._transport.send(calls.remove_receiver(receiver_id))

    def hold_scene(self, picture: npt.ArrayLike | bytes | None) -> HeldScene:
        """Hold a picture up before a simulated camera that allows it; None takes it away.

        Args:
            picture: the content of a PNG, JPEG or ``.npy`` file, or an array (rows, columns) or
                (rows, columns, 3), uint8, or floats in [0, 1].
        """
        if picture is None:
            return self._transport.send(calls.TAKE_SCENE_AWAY)
        return self._transport.send(calls.hold_scene(picture_bytes(picture)))

    def set_faults(self, faults: Faults) -> Faults:
        """Break a simulated camera that allows it; ``Faults()`` mends it.

        Returns:
            What is wrong with it from now on.
        """
        return self._transport.send(calls.set_faults(faults))

    def bundles(self) -> tuple[InstalledBundle, ...]:
        """All bundles; one of them is ``active``."""
        return self._transport.send(calls.BUNDLES).bundles

    def install_bundle(self, bundle: bytes) -> InstalledBundle:
        """Hand over the content of a bundle; it is checked, and not used yet."""
        return self._transport.send(calls.install_bundle(bundle))

    def activate_bundle(self, digest: str, *, allow_older: bool = False) -> InstalledBundle:
        """Take masks and classifiers from this bundle from now on.

        One of an older version than that in use is refused unless ``allow_older``, and always where
        the daemon wants its owner's signature.
        """
        return self._transport.send(calls.activate_bundle(digest, allow_older))

    def remove_bundle(self, digest: str) -> tuple[InstalledBundle, ...]:
        """Remove a bundle that is not in use for good; return those that are left."""
        return self._transport.send(calls.remove_bundle(digest)).bundles

    def events(self, *, last_event_id: str | None = None) -> Iterator[Event]:
        """Yield events as they happen; resumes by itself, a ``Gap`` tells of missed ones."""
        return self._transport.events(last_event_id)
