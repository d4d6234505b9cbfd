"""The command ``veilcam pair``: what it sends, what it keeps, and attacks on it."""

from __future__ import annotations

import json
from pathlib import Path

import httpx
import pytest
from tests.unit.client.certificates import Certificate
from tests.unit.client.conftest import DEVICE, EXAMPLES, Daemon, handler_of, problem, serving
from typer.testing import CliRunner

from veilcam_client.cli.main import app
from veilcam_client.keys.receivers import ReceiverKey
from veilcam_client.profiles import profile_of
from veilcam_client.wire.pairing import PairingLine

SECRET = bytes(range(16))
PAIRED = EXAMPLES["Paired"]
runner = CliRunner()


def line_of(url: str, certificate: Certificate | None = None) -> str:
    digest = None if certificate is None else bytes.fromhex(certificate.digest)
    return str(PairingLine(url.partition("://")[2], SECRET, digest))


@pytest.fixture
def line(url: str, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.delenv("VEILCAM_URL")
    return line_of(url)


def test_line_is_claimed_and_kept(daemon: Daemon, line: str, settings: Path) -> None:
    made = runner.invoke(app, ["pair", line, "--label", "a laptop"], env={"VEILCAM_TOKEN": "vc_x"})
    assert made.exit_code == 0, made.output
    words = made.stdout.splitlines()
    assert words[0].endswith("as operator")
    assert words[1] == "profile: local, the default"
    assert words[2] == "next:    veilcam capture"
    assert words[4].strip() == "Camera().capture()"
    (asked,) = daemon.requests
    assert "authorization" not in asked.headers
    key = ReceiverKey.read(settings / "local.key")
    claim = {"label": "a laptop", "key": str(key.public), "secret": SECRET.hex()}
    assert json.loads(asked.content) == claim
    own = profile_of()
    assert (own.token, own.device, own.certificate) == (PAIRED["token"], DEVICE, None)
    for secret in (PAIRED["token"], SECRET.hex(), line):
        assert secret not in made.output
        assert secret not in (settings / "config.toml").read_text()
    assert runner.invoke(app, ["status"]).exit_code == 0
    assert daemon.requests[-1].headers["authorization"] == f"Bearer {PAIRED['token']}"


def test_camera_is_asked_for_a_line_where_none_is_given(
    daemon: Daemon, url: str, tmp_path: Path, settings: Path
) -> None:
    (tmp_path / "owner").write_text("vc_owner\n")
    offer = {**EXAMPLES["PairingOffer"], "line": line_of(url)}
    daemon.first = [
        httpx.Response(201, json=offer),
        httpx.Response(201, json={**PAIRED, "role": "viewer", "token": None}),
    ]
    options = ["--role", "viewer", "--token-file", str(tmp_path / "owner")]
    made = runner.invoke(app, ["pair", *options, "--profile", "hall", "--json"])
    assert made.exit_code == 0, made.output
    told = json.loads(made.stdout)
    assert told == {
        "profile": "hall",
        "default": True,
        "device": DEVICE,
        "role": "viewer",
        "receiver": ReceiverKey.read(settings / "hall.key").public.id,
    }
    offered, claimed = daemon.requests
    assert json.loads(offered.content) == {"role": "viewer"}
    assert offered.headers["authorization"] == "Bearer vc_owner"
    assert "authorization" not in claimed.headers
    assert not (settings / "hall.token").exists()


def test_line_of_tls_is_claimed_of_the_one_with_its_certificate(
    daemon: Daemon, tmp_path: Path
) -> None:
    shown = Certificate.made()
    with serving(handler_of(daemon), shown.context(tmp_path)) as url:
        line = line_of(url, shown)
        made = runner.invoke(app, ["pair", "-"], input=f"{line}\n")
        assert made.exit_code == 0, made.output
        assert "profile: 127-0-0-1, the default" in made.stdout
        assert runner.invoke(app, ["status"]).exit_code == 0
    assert profile_of().certificate == shown.digest
    assert daemon.requests[-1].headers["authorization"] == f"Bearer {PAIRED['token']}"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "this is no line that pairs"),
        ("nonsense", "this is no line that pairs"),
        ("veilcam://{place}/#c2VjcmV0", "this is no line that pairs"),
        ("veilcam://{place}/#{data}AAAA", "this is no line that pairs"),
        ("veilcam://me@{place}/#{data}", "this is no line that pairs"),
        ("http://{place}/#{data}", "this is no line that pairs"),
        ("veilcam://192.0.2.1:8787/#{data}", "leads to another machine and names no certificate"),
        ("veilcam://localhost.example:1/#{data}", "leads to another machine"),
    ],
)
def test_line_that_cannot_be_used_is_not_sent_or_repeated(
    daemon: Daemon, line: str, settings: Path, text: str, message: str
) -> None:
    place, _, data = line.removeprefix("veilcam://").partition("/#")
    given = text.format(place=place, data=data)
    for arguments in ([given], ["-"]):
        refused = runner.invoke(app, ["pair", *arguments], input=f"{given}\n")
        assert refused.exit_code == 2
        assert message in refused.stderr
        assert data not in refused.output
    assert daemon.requests == []
    assert not settings.exists()


@pytest.mark.parametrize(
    ("answer", "code"),
    [
        (problem(401, "unauthorized"), 4),
        (problem(503, "storage_failed", retryable=True), 6),
        (httpx.Response(201, json={**PAIRED, "device": 'ab"\n[profiles.x]'}), 6),
        (httpx.Response(201, json={**PAIRED, "token": "vc_a\nb"}), 6),
        (httpx.Response(201, text="none"), 6),
    ],
)
def test_nothing_is_left_of_a_claim_that_fails(
    daemon: Daemon, line: str, settings: Path, answer: httpx.Response, code: int
) -> None:
    daemon.first = [answer]
    refused = runner.invoke(app, ["pair", line])
    assert refused.exit_code == code, refused.output
    assert SECRET.hex() not in refused.output
    assert len(daemon.requests) == 1
    assert not settings.exists()


def test_profile_that_is_there_is_not_replaced(daemon: Daemon, line: str, settings: Path) -> None:
    assert runner.invoke(app, ["pair", line]).exit_code == 0
    before = {file: file.read_bytes() for file in settings.iterdir()}
    refused = runner.invoke(app, ["pair", line, "--profile", "local"])
    assert refused.exit_code == 2
    assert "has a profile 'local' already" in refused.stderr
    assert len(daemon.requests) == 1
    other = {**PAIRED, "device": "ab" * 32, "role": "viewer"}
    daemon.first = [httpx.Response(201, json=other)]
    made = runner.invoke(app, ["pair", line]).stdout
    assert "profile: local-2\n" in made
    assert "veilcam classify --profile local-2\n" in made
    assert "Camera(profile='local-2').classify()" in made
    kept = {file: file.read_bytes() for file in before if file.name != "config.toml"}
    assert kept.items() <= before.items()
    assert profile_of().device == DEVICE


@pytest.mark.parametrize("option", ["--url", "--token-file", "--role"])
def test_option_of_a_camera_goes_without_a_line(daemon: Daemon, line: str, option: str) -> None:
    refused = runner.invoke(app, ["pair", line, option, "owner"])
    assert refused.exit_code == 2
    assert "go without LINE" in refused.stderr
    assert daemon.requests == []
