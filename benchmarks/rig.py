"""Rig that measurements share: a folder, a daemon to ask, and the memory of this process."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from veilcam_client import Camera
from veilcam_client.keys.receivers import ReceiverKey
from veilcam_server.demo.daemon import running
from veilcam_server.demo_data import BUNDLE, load_digits
from veilcam_server.devices.simulated.scenes import write_scene


@contextmanager
def work_folder() -> Iterator[Path]:
    """Yield a folder that is gone afterwards."""
    with tempfile.TemporaryDirectory(prefix="veilcam-") as name:
        yield Path(name)


@contextmanager
def prompt_daemon(folder: Path, *options: str) -> Iterator[str]:
    """Yield the URL of a simulated daemon that looks at a digit and waits for no device.

    Args:
        folder: for its scene, its state and its log.
        options: more options for ``veilcamd serve``.
    """
    scene = folder / "scene.npy"
    write_scene(scene, load_digits().images[0])
    with running(BUNDLE, scene, folder, "--settle", "0", "--exposure", "0", *options) as url:
        yield url


def pair(url: str) -> ReceiverKey:
    """Have a daemon seal to a receiver that is made for it, from the mask that is shown next."""
    key = ReceiverKey.generate()
    with Camera(url) as camera:
        camera.receivers.add("measurement", key.public)
        camera.rotation.advance()
    return key


def resident() -> float:
    """Resident memory of this process [MB]."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6
