"""What a command loads before it does anything: seconds of a Raspberry Pi, if that were torch."""

from __future__ import annotations

import socket
import subprocess
import sys
from pathlib import Path

import pytest

from veilcam_server.security.tokens import TokenStore

HEAVY = ("torch", "scipy", "matplotlib", "fastapi", "uvicorn")
ARRAYS_AND_COLOURS = ("numpy", "rich", "structlog", "httpx")
"""What a terminal waits longest for where neither is wanted."""
PROGRAM = """
import atexit, sys
sys.argv = ["veilcamd", *sys.argv[1:]]
heavy = {heavy!r}
atexit.register(lambda: print("loaded", *(name for name in heavy if name in sys.modules)))
from veilcam_client.entry_points import veilcamd
veilcamd()
"""


def run(*arguments: str, heavy: tuple[str, ...] = HEAVY) -> tuple[int, str, str]:
    """Exit code, what was loaded of that, and all that was said."""
    command = [sys.executable, "-c", PROGRAM.format(heavy=heavy), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    *said, loaded = done.stdout.splitlines()
    return done.returncode, loaded.removeprefix("loaded").strip(), "\n".join(said) + done.stderr


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        (["--help"], 0, "a privacy camera"),
        (["serve", "--help"], 0, "--simulate"),
        (["token", "list", "--state-dir", "{tmp}"], 0, "no tokens"),
        (["doctor", "--state-dir", "{tmp}"], 1, "none named"),
    ],
)
def test_torch_is_not_loaded_for(
    arguments: list[str], code: int, says: str, tmp_path: Path
) -> None:
    ended, loaded, said = run(*(each.replace("{tmp}", str(tmp_path)) for each in arguments))
    assert (ended, loaded) == (code, "")
    assert says in said


@pytest.mark.slow
def test_help_and_tokens_wait_for_neither_arrays_nor_colours(tmp_path: Path) -> None:
    made = TokenStore(tmp_path).create("hall lamp", ("classify",), None)
    for arguments, says in (
        (("--help",), "a privacy camera"),
        (("token", "list", "--state-dir", str(tmp_path)), made.id),
    ):
        ended, loaded, said = run(*arguments, heavy=(*HEAVY, *ARRAYS_AND_COLOURS))
        assert (ended, loaded) == (0, ""), arguments
        assert says in said


@pytest.mark.slow
def test_occupied_port_is_told_before_torch_is_loaded(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        ended, loaded, said = run(
            *("serve", "--simulate", "--port", str(port), "--state-dir", str(tmp_path))
        )
    assert (ended, loaded) == (1, "")
    assert f"port {port} is occupied" in said
    assert not any(tmp_path.iterdir())
