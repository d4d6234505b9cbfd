"""Bundles through the command line."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.unit.client.conftest import Daemon
from tests.unit.client.sealing import AT
from typer.testing import CliRunner

from veilcam_client.cli import main as commands
from veilcam_client.cli.format import bundle_in_words, event_in_words
from veilcam_client.events import BundleChanged
from veilcam_client.wire.bundles import InstalledBundle, example_bundle, examples

DIGEST = "ab" * 32
pytestmark = pytest.mark.usefixtures("url")
runner = CliRunner()


@pytest.mark.parametrize(("options", "star"), [([], " "), (["--activate"], "*")])
def test_file_is_handed_over(daemon: Daemon, tmp_path: Path, options: list[str], star: str) -> None:
    path = tmp_path / "a.veilcam"
    path.write_bytes(b"bundle")
    result = runner.invoke(commands.app, ["bundle", "install", str(path), *options])
    assert result.exit_code == 0
    assert result.stdout.startswith(f"{star} abababababab")
    assert daemon.requests[0].content == b"bundle"
    assert len(daemon.requests) == 1 + len(options)


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
        (installed,) = (each for each in examples() if isinstance(each, InstalledBundle))
        told = bundle_in_words(installed.model_copy(update={"bundle": bundle}))
        assert told.endswith(words)


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
    event = BundleChanged(id="a-1", at=AT, digest=DIGEST, task="mnist")
    assert event_in_words(event) == "mnist  bundle abababababab"
    older = event.model_copy(update={"version": 3, "older": True})
    assert event_in_words(older).endswith("abababababab  version 3, older than the one before")
