"""Measurements are found where a process holds them, and not where it let them go."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from benchmarks.privacy.memory import RUN, Sought, search

HOLDER = """
import json, sys
import numpy as np
from veilcam_client.numbers import erasable

given = np.load(sys.argv[1])
held = given[0].copy(), given[1].astype(float), json.dumps(given[2].tolist()).encode()
gone = erasable(given[3])
given.fill(0)
del gone
print("ready", flush=True)
sys.stdin.read()
"""


@pytest.mark.slow
def test_measurement_is_found_in_the_form_that_is_held(tmp_path: Path) -> None:
    measurements = np.random.default_rng(1).random((4, 2 * RUN), np.float32)
    path = tmp_path / "given.npy"
    np.save(path, measurements)
    command, pipe = [sys.executable, "-c", HOLDER, str(path)], subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == b"ready\n"
        found = search(holder.pid, Sought(measurements))
        holder.communicate()
    assert found == {"float32": {0}, "float64": {1}, "text": {2}}
