"""``veilcamd pair`` and ``veilcamd token first``: secrets for whoever sits before the machine."""

from __future__ import annotations

import hashlib
import json
import os
import pty
import ssl
import subprocess
import sys
from pathlib import Path

import httpx
import pytest
from tests.app.server.security.test_tls import write_pair
from tests.app.server.test_daemon import daemon
from tests.unit.server.logs import events, records
from typer.testing import CliRunner

from veilcam_client.keys.receivers import ReceiverKey
from veilcam_client.wire.pairing import PairingLine
from veilcam_client.wire.tokens import ROLES
from veilcam_server.cli.main import app
from veilcam_server.security.tokens import TokenStore
from veilcam_server.system.state_file import make_directory

runner = CliRunner()


def on_a_terminal(*command: str) -> tuple[int, str]:
    """Run ``veilcamd`` on a terminal of its own; return its exit code and what it printed."""
    ours, theirs = pty.openpty()
    with subprocess.Popen(
        [sys.executable, "-m", "veilcam_server", *command],
        stdout=theirs,
        stderr=theirs,
        stdin=subprocess.DEVNULL,
    ) as process:
        os.close(theirs)
        printed = bytearray()
        try:
            while some := os.read(ours, 4096):
                printed += some
        except OSError:  # the terminal's other end is closed
            pass
        os.close(ours)
    return process.returncode, printed.decode().replace("\r\n", "\n")


def test_first_token_is_an_owner_s_and_printed_on_a_terminal_alone(tmp_path: Path) -> None:
    state = tmp_path / "state"
    command = ("token", "first", "--state-dir", str(state))
    piped = runner.invoke(app, command)
    assert (piped.exit_code, piped.stdout) == (2, "")
    assert "run it in a terminal" in piped.stderr
    code, printed = on_a_terminal(*command)
    assert code == 1
    assert "start the daemon first" in printed
    make_directory(state)
    store = TokenStore(state)
    store.create("a viewer", ROLES["viewer"])
    code, secret = on_a_terminal(*command)
    assert code == 0
    caller = TokenStore(state).caller(f"Bearer {secret.strip()}")
    assert caller.scopes == set(ROLES["owner"])
    code, printed = on_a_terminal(*command)
    assert code == 1
    assert f"token {caller.id} (first owner) is an owner's" in printed
    store.revoke(caller.id)
    assert on_a_terminal(*command)[0] == 0
    assert [each["action"] for each in events(state, "command")] == ["token first"] * 2


def test_pair_wants_a_daemon_that_runs(tmp_path: Path) -> None:
    made = runner.invoke(app, ["pair", "--state-dir", str(tmp_path / "state")])
    assert made.exit_code == 1
    assert "no daemon runs in" in made.stderr
    wrong = runner.invoke(app, ["pair", "--role", "king", "--state-dir", str(tmp_path / "state")])
    assert (wrong.exit_code, wrong.stdout) == (2, "")
    assert "--role: " in wrong.stderr


@pytest.mark.thorough
def test_line_of_the_terminal_pairs_with_the_daemon_that_runs(
    bundle_file: Path, scene_file: Path, tmp_path: Path
) -> None:
    certificate, key = write_pair(tmp_path / "tls")
    state, served = tmp_path / "state", ["--host", "0.0.0.0", "--port", "0"]
    served += ["--hosts", "camera.example:8443", "--auth", "tokens", "--settle", "0"]
    served += ["--tls-certificate", str(certificate), "--tls-key", str(key)]
    served += ["--bundle", str(bundle_file), "--scenes", str(scene_file)]
    with daemon(tmp_path / "log", *served, "--state-dir", str(state)) as (_, url):
        port = httpx.URL(url).port
        answer = runner.invoke(
            app, ["pair", "--role", "owner", "--json", "--state-dir", str(state)]
        )
        replaced = PairingLine.parse(json.loads(answer.stdout)["line"])
        code, printed = on_a_terminal("pair", "--state-dir", str(state))
        assert code == 0
        text, *code_rows, said = printed.splitlines()
        line = PairingLine.parse(text)
        assert line.place == f"camera.example:{port}"
        der = ssl.PEM_cert_to_DER_cert(certificate.read_text())
        assert line.certificate == hashlib.sha256(der).digest()
        assert len(code_rows) > 20
        assert "valid once, for 5 minutes" in said
        claim = {"label": "laptop", "key": str(ReceiverKey.generate().public)}
        trust = ssl.create_default_context(cafile=str(certificate))
        with httpx.Client(base_url=f"https://127.0.0.1:{port}", verify=trust) as client:
            answers = [
                client.post("/v1/pairing/claim", json={**claim, "secret": each.secret.hex()})
                for each in (replaced, line, line)
            ]
    assert [each.status_code for each in answers] == [401, 201, 401]
    assert answers[1].json()["role"] == "operator"
    made = [each for each in events(state, "command") if each["action"] == "pair"]
    assert [each["role"] for each in made] == ["owner", "operator"]
    log = str(records(state)) + (tmp_path / "log").read_text()
    for secret in (text.partition("#")[2], line.secret.hex(), answers[1].json()["token"]):
        assert secret not in log
