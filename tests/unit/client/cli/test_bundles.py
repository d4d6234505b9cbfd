"""Bundles through both cameras and the command line."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import TYPE_CHECKING, Any

import httpx
import pytest
from typer.testing import CliRunner

from veilcam_client import AsyncCamera, BundleChanged, Camera
from veilcam_client.cli import main as commands
from veilcam_client.cli.format import bundle_in_words, event_in_words
from veilcam_client.wire.bundles import InstalledBundle, example_bundle
from veilcam_client.wire.events import EVENT

if TYPE_CHECKING:
    from tests.unit.client.conftest import Daemon

pytestmark = pytest.mark.anyio
DIGEST = "ab" * 32
runner = CliRunner()


@pytest.mark.parametrize("kind", [Camera, AsyncCamera])
async def test_bundles_by_both_cameras(daemon: Daemon, kind: type) -> None:
    client = httpx.Client if kind is Camera else httpx.AsyncClient
    camera = kind(
        "http://camera.local:1", http_client=client(transport=httpx.MockTransport(daemon))
    )

    async def result(answer: Any) -> Any:
        return await answer if inspect.isawaitable(answer) else answer

    active, other = await result(camera.bundles())
    assert (active.active, active.configured, active.bundle) == (True, True, None)
    assert other.bundle.task == "fashion"
    assert (await result(camera.install_bundle(b"bundle"))).digest == DIGEST
    assert daemon.requests[-1].content == b"bundle"
    assert daemon.requests[-1].headers["content-type"] == "application/vnd.veilcam.bundle"
    assert (await result(camera.activate_bundle(DIGEST))).active
    assert len(await result(camera.remove_bundle(DIGEST))) == 1


def test_digest_is_no_path(daemon: Daemon) -> None:
    client = httpx.Client(transport=httpx.MockTransport(daemon))
    with pytest.raises(KeyError):
        Camera("http://camera.local:1", http_client=client).activate_bundle("../status?x")
    assert daemon.requests[0].url.raw_path == b"/v1/bundles/..%2Fstatus%3Fx/activate"


@pytest.mark.usefixtures("url")
@pytest.mark.parametrize(("options", "star"), [([], " "), (["--activate"], "*")])
def test_file_is_handed_over(daemon: Daemon, tmp_path: Path, options: list[str], star: str) -> None:
    path = tmp_path / "a.veilcam"
    path.write_bytes(b"bundle")
    result = runner.invoke(commands.app, ["bundle", "install", str(path), *options])
    assert result.exit_code == 0
    assert result.stdout.startswith(f"{star} abababababab")
    assert daemon.requests[0].content == b"bundle"
    assert len(daemon.requests) == 1 + len(options)


@pytest.mark.usefixtures("url")
@pytest.mark.parametrize("command", [["activate", "ab"], ["install", "a.veilcam", "--activate"]])
@pytest.mark.parametrize("options", [[], ["--allow-older"]])
def test_older_bundle_is_asked_for(
    daemon: Daemon,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    command: list[str],
    options: list[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("a.veilcam").write_bytes(b"bundle")
    result = runner.invoke(commands.app, ["bundle", *command, *options])
    assert result.exit_code == 0, result.output
    query = daemon.requests[-1].url.query
    assert query == (b"allow_older=true" if options else b"")


@pytest.mark.usefixtures("url")
def test_allow_older_without_activate_would_do_nothing(daemon: Daemon, tmp_path: Path) -> None:
    result = runner.invoke(commands.app, ["bundle", "install", "a.veilcam", "--allow-older"])
    assert result.exit_code == 2
    assert "--allow-older goes with --activate" in result.stderr
    assert not daemon.requests


def test_version_and_owner_in_words() -> None:
    held = example_bundle().model_copy(update={"card": None})
    card = example_bundle().card
    assert card is not None
    for change, words in (
        ({"card": card}, "signed by 3a6eb0790f39, privacy card: PASS"),
        ({"card": card.model_copy(update={"quick": True})}, "privacy card: PASS (quick)"),
        ({}, "6 masks, version 4 signed by 3a6eb0790f39"),
        ({"signed_by": None}, "6 masks, version 4 not signed"),
        ({"signed_by": None, "version": 0}, "6 masks"),
    ):
        bundle = held.model_copy(update=change)
        installed = InstalledBundle(
            digest=DIGEST, size=1, active=False, configured=False, bundle=bundle
        )
        assert bundle_in_words(installed).endswith(words)


@pytest.mark.usefixtures("url")
@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["install", "/nowhere/a.veilcam"], "/nowhere/a.veilcam cannot be read"),
        (["activate", "12"], "0 bundles begin with '12': see 'veilcam bundle list'"),
        (["remove", ""], "2 bundles begin with ''"),
    ],
)
def test_bundle_that_cannot_be_meant_is_named(arguments: list[str], reason: str) -> None:
    result = runner.invoke(commands.app, ["bundle", *arguments])
    assert result.exit_code == 2
    assert reason in result.stderr


def test_bundle_change_in_words() -> None:
    event = EVENT.validate_python(
        {
            "kind": "bundle",
            "id": "a-1",
            "at": "2026-01-02T03:04:05Z",
            "digest": DIGEST,
            "task": "mnist",
        },
        strict=False,
    )
    assert isinstance(event, BundleChanged)
    assert event_in_words(event) == "mnist  bundle abababababab"
    event = event.model_copy(update={"version": 3, "older": True})
    assert (
        event_in_words(event) == "mnist  bundle abababababab  version 3, older than the one before"
    )
