"""Pairing: from the line that a camera shows to a profile that has all of it."""

from __future__ import annotations

import ipaddress
import platform
import re
from dataclasses import dataclass, replace

from veilcam_client.camera import Camera
from veilcam_client.errors import ArgumentError
from veilcam_client.profiles import Profile, new_profile
from veilcam_client.wire.pairing import PairingLine

LABEL_LENGTH = 64
"""Longest label of a receiver."""


@dataclass(frozen=True, slots=True)
class Pairing:
    """A camera that was just paired.

    Attributes:
        profile: name of the profile that has all of it, for ``Camera(profile=...)``.
        default: True: ``Camera()`` takes this profile.
        role: role of the token.
        camera: HOST:PORT of the camera, or the path of its socket.
        device: public key of the camera, 64 hexadecimal digits.
        receiver: SHA-256 of the receiver's public key, 64 hexadecimal digits.
    """

    profile: str
    default: bool
    role: str
    camera: str
    device: str
    receiver: str


def pair(
    line: str, *, profile: str | None = None, label: str | None = None, url: str | None = None
) -> Pairing:
    """Pair this user with the camera of a line, and write a profile: then ``Camera()`` has a key.

    The certificate is compared before anything is sent. Where it fails, nothing is left on the
    disk. A profile that is there is never changed.

    Args:
        line: ``veilcam://HOST:PORT/#...``, as ``veilcamd pair`` or the camera's page shows it.
        profile: new name of the profile; None: one that is free, after the host.
        label: label of the receiver for people; None: name of this machine.
        url: URL by which this machine reaches the camera; None: that of the line.

    Raises:
        ArgumentError: the line or the name cannot be used; no message repeats the line.
        FileError: the profile cannot be written.
        VeilcamError: the camera is not there, shows another certificate or refuses.
    """
    # Late: no other command needs it.
    from veilcam_client.keys.receivers import ReceiverKey  # noqa: PLC0415

    try:
        asked = PairingLine.parse(line)
    except ValueError as error:
        raise ArgumentError(str(error)) from None
    key, url = ReceiverKey.generate(), url or asked.url
    certificate = None if asked.certificate is None else asked.certificate.hex()
    label = label or re.sub(r"[^ -~]", "", platform.node())[:LABEL_LENGTH] or "receiver"
    with new_profile(profile or _name(asked), key, exact=profile is not None) as (name, save):
        # No token or authority of the environment: the line alone says whom to trust.
        own = Profile(url, certificate=certificate)
        with Camera(profile=own, max_retries=0) as camera:  # a line is used once
            paired = camera.receivers.claim(asked.secret.hex(), label, key.public)
        default = save(replace(own, token=paired.token, device=paired.device))
    return Pairing(name, default, paired.role, asked.place, paired.device, key.public.id)


def _name(line: PairingLine) -> str:
    """Return a name for the camera of a line: the first word of its host."""
    host = line.place.rpartition(":")[0].strip("[]")
    if line.certificate is None:
        return "local"
    try:
        word = str(ipaddress.ip_address(host))
    except ValueError:
        word = host.partition(".")[0]
    return re.sub(r"[^A-Za-z0-9_-]+", "-", word)[:32] or "camera"
