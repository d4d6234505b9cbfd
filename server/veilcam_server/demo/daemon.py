"""A ``veilcamd serve`` of one's own, as a subprocess on a free port."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from veilcam_server.errors import StartError

START_LIMIT = 120.0
"""Longest wait for the daemon to listen [s]."""
_GREETING = "veilcamd listening on "


@contextmanager
def running(bundle: Path, scene: Path, directory: Path, *options: str) -> Iterator[str]:
    """Yield the URL of a simulated daemon that looks at ``scene``; stop it afterwards.

    Args:
        bundle: bundle to serve.
        scene: the file that it sees.
        directory: directory of its state and its log.
        options: more options for ``veilcamd serve``.

    Raises:
        StartError: it did not start; the reason is its own.
    """
    log = directory / "veilcamd.log"
    command = [
        *(sys.executable, "-m", "veilcam_server", "serve", "--simulate", "--port", "0"),
        *("--bundle", str(bundle), "--scenes", str(scene)),
        *("--state-dir", str(directory / "state"), *options),
    ]
    with (
        log.open("w") as errors,
        subprocess.Popen(  # noqa: S603 - our own interpreter, no shell
            command, stdout=subprocess.PIPE, stderr=errors, text=True
        ) as process,
    ):
        assert process.stdout is not None  # noqa: S101 - it is a pipe
        # A daemon that neither starts nor ends is killed, which ends the wait for its first line.
        watchdog = threading.Timer(START_LIMIT, process.kill)
        watchdog.start()
        try:
            line = process.stdout.readline()
        finally:
            watchdog.cancel()
        try:
            if not line.startswith(_GREETING):
                process.kill()
                process.wait()
                raise StartError(_reason(log))
            yield line.removeprefix(_GREETING).strip()
        finally:
            process.terminate()
            try:
                process.wait(20)
            except subprocess.TimeoutExpired:
                process.kill()


def _reason(log: Path) -> str:
    lines = log.read_text().strip().splitlines()
    last = lines[-1] if lines else f"the daemon did not start within {START_LIMIT:.0f} s"
    return last.removeprefix("veilcamd: error: ")
