#!/usr/bin/python3 -Iu
"""Runs a command of Veilcam, the one it is called by, from the release that is in use.

-I: nothing that a user or an environment says decides what is imported. Wheels of this package go
before the system's; NumPy, spidev and picamera2 are the system's.
"""

import os
import sys
from importlib import import_module
from pathlib import Path

COMMANDS = {
    "veilcam": "veilcam_client.cli.main",
    "veilcamd": "veilcam_server.cli.main",
    "veilcam-mqtt": "veilcam_mqtt.cli",
}

release = Path("/var/lib/veilcam-release/current").resolve()
sys.path[:0] = [str(release / "lib"), str(release / "py{}{}".format(*sys.version_info))]
# Root and the daemon's user mean the daemon's state, as its unit does.
if os.access("/var/lib/veilcam", os.W_OK):
    os.environ.setdefault("VEILCAM_STATE_DIRECTORY", "/var/lib/veilcam")
# Before NumPy is loaded, as `veilcam_client.entry_points` does.
os.environ.setdefault("OMP_NUM_THREADS", "1")
import_module(COMMANDS[Path(sys.argv[0]).name]).main()
