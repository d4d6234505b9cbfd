"""Privacy of a camera as it is set up."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from typer.testing import CliRunner

from veilcam_client.wire.privacy import Privacy
from veilcam_server.cli.main import app
from veilcam_server.security.privacy import privacy_of

if TYPE_CHECKING:
    from tests.unit.server.conftest import Bench, Running


@pytest.mark.anyio
async def test_privacy_is_that_of_the_release(running: Running, bench: Bench) -> None:
    bench.release = "raw"
    async with running() as client:
        answer = await client.get("/v1/privacy")
    assert Privacy.model_validate_json(answer.content) == privacy_of("raw")


def test_command_says_the_same() -> None:
    said = CliRunner().invoke(app, ["privacy", "--beat", "off", "--json"])
    assert said.exit_code == 0, said.output
    assert Privacy.model_validate_json(said.output) == privacy_of("sealed", beat=False)


def test_each_setting_changes_what_somebody_learns() -> None:
    sealed = privacy_of("sealed")
    for other, who in (
        (privacy_of("none"), "receiver"),
        (privacy_of("raw"), "receiver"),
        (privacy_of("sealed", beat=False), "network"),
        (privacy_of("sealed", full_scores=True), "scores"),
    ):
        pairs = zip(sealed.observers, other.observers, strict=True)
        [(one, changed)] = [pair for pair in pairs if pair[0] != pair[1]]
        assert who in one.who
        assert changed.who == one.who
        assert changed.learns != one.learns
