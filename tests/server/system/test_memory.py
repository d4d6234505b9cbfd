"""No core file of a daemon, however it is ended."""

from __future__ import annotations

import subprocess
import sys

FORBID = """
import resource
from veilcam_server.system.memory import forbid_core_files
soft, hard = resource.getrlimit(resource.RLIMIT_CORE)
resource.setrlimit(resource.RLIMIT_CORE, (hard, hard))
forbid_core_files()
print(resource.getrlimit(resource.RLIMIT_CORE))
"""


def test_no_core_file_is_written() -> None:
    # In a process of its own: a hard limit that was lowered stays low.
    command = [sys.executable, "-c", FORBID]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout == "(0, 0)\n"
