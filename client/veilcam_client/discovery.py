"""Cameras that announce themselves on the local network: ``_veilcam._tcp`` over mDNS (RFC 6763).

An announcement is a hint and no proof: whoever is on the network can make one. What a camera is
says its certificate, and no token goes to one that was only announced.
"""

from __future__ import annotations

import re
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from veilcam_client import arguments
from veilcam_client.errors import ArgumentError, VeilcamError

if TYPE_CHECKING:
    from zeroconf import ServiceInfo, ServiceStateChange, Zeroconf

FAILED = "discovery_failed"
TYPE = "_veilcam._tcp.local."
_HOST = re.compile(r"[A-Za-z0-9]([A-Za-z0-9.-]{0,251}[A-Za-z0-9])?")


@dataclass(frozen=True, slots=True)
class FoundCamera:
    """A camera as it announces itself."""

    name: str
    url: str
    """By its name on the network, which is that of its certificate."""


def discover(seconds: float, interfaces: Sequence[str] | None = None) -> tuple[FoundCamera, ...]:
    """Listen for cameras, and return them by name.

    Args:
        seconds: time to listen [s].
        interfaces: addresses of this machine to listen on; all of them if None.

    Raises:
        VeilcamError: the extra ``discover`` is not installed, or there is no network (code
            ``discovery_failed``).
        ArgumentError: a time that is none.
    """
    if not 0 < arguments.seconds("seconds", seconds) <= 600:
        raise ArgumentError(f"seconds = {seconds} is not valid: use more than 0 and up to 600")
    try:
        # An extra, and the SDK is imported without it.
        import zeroconf  # noqa: PLC0415
    except ModuleNotFoundError:
        raise VeilcamError(
            "finding cameras needs the extra 'discover': run pip install -e '.[discover]' in the "
            "checkout",
            code=FAILED,
        ) from None
    listening = list(interfaces or ()) or zeroconf.InterfaceChoice.All
    announced: dict[str, ServiceInfo] = {}

    # zeroconf names the arguments.
    def heard(
        zeroconf: Zeroconf, service_type: str, name: str, state_change: ServiceStateChange
    ) -> None:
        went = state_change.name == "Removed"
        info = None if went else zeroconf.get_service_info(service_type, name)
        if info is None:
            announced.pop(name, None)
        else:
            announced[name] = info

    try:
        with zeroconf.Zeroconf(listening, ip_version=zeroconf.IPVersion.V4Only) as network:
            browser = zeroconf.ServiceBrowser(network, TYPE, handlers=[heard])
            time.sleep(seconds)
            browser.cancel()
    except OSError as error:
        why = f"the network cannot be listened to: {error.strerror}"
        raise VeilcamError(why, code=FAILED) from error
    found = (_camera(info) for info in announced.values())
    return tuple(sorted(filter(None, found), key=lambda each: (each.name, each.url)))


def _camera(info: ServiceInfo) -> FoundCamera | None:
    """Return the address that is announced, None where this SDK cannot use it."""
    told = info.decoded_properties
    host = (info.server or "").removesuffix(".")
    scheme = told.get("scheme")
    usable = scheme in ("http", "https") and told.get("api") == "v1" and info.port
    if not usable or not _HOST.fullmatch(host):
        return None
    # Printed in terminals, so nothing of a stranger's that they obey.
    name = "".join(filter(str.isprintable, info.name.removesuffix(f".{TYPE}")))
    return FoundCamera(name, f"{scheme}://{host}:{info.port}")
