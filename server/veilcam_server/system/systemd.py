"""Messages between systemd and a service, and the sockets that systemd opened.

Source: sd_notify(3) and sd_listen_fds(3). Outside systemd nothing here does anything.
"""

from __future__ import annotations

import os
import socket

import structlog

from veilcam_server.errors import StartError

log = structlog.get_logger()

FIRST_DESCRIPTOR = 3
"""Of the sockets that systemd passes."""


def notify(state: str) -> None:
    """Tell systemd of a state, such as ``READY=1`` or ``WATCHDOG=1``.

    A systemd that does not hear ends the daemon by itself, so no failure is raised.
    """
    address = os.environ.get("NOTIFY_SOCKET")
    if not address:
        return
    if address.startswith("@"):  # the abstract name space
        address = "\0" + address[1:]
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
            sender.sendto(state.encode(errors="replace"), address)
    except OSError as error:
        log.warning("systemd not told", told=state, error=error.strerror)


def watchdog_period() -> float | None:
    """Longest time between two ``WATCHDOG=1`` [s] that systemd allows, None where it asks for none.

    Tell it twice as often.
    """
    period, process = os.environ.get("WATCHDOG_USEC"), os.environ.get("WATCHDOG_PID")
    if not period or process not in (None, str(os.getpid())):
        return None
    return int(period) / 1e6


def take_sockets() -> list[socket.socket]:
    """Return the listening sockets that systemd passed to this process; a second call has none.

    Raises:
        StartError: one of them is not a listening stream socket.
    """
    count, process = os.environ.pop("LISTEN_FDS", "0"), os.environ.pop("LISTEN_PID", None)
    names = os.environ.pop("LISTEN_FDNAMES", "").split(":")
    if process != str(os.getpid()):
        return []
    taken = []
    for index in range(int(count)):
        descriptor = FIRST_DESCRIPTOR + index
        # What this process starts has no business with them.
        os.set_inheritable(descriptor, False)
        try:
            passed = socket.socket(fileno=descriptor)
            listens = passed.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN) == 1
        except OSError:
            listens = False
        if not listens:
            name = names[index] if index < len(names) else str(descriptor)
            raise StartError(
                f"systemd passed {name!r}, which is no listening socket: "
                "use ListenStream= and Accept=no in the socket unit"
            )
        taken.append(passed)
    return taken
