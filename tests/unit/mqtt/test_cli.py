"""The command ``veilcam-mqtt``: options that do not fit, and what it logs."""

from __future__ import annotations

import json
import logging
import re
from pathlib import Path

import pytest

pytest.importorskip("aiomqtt", reason="the extra 'mqtt' is not installed")

from typer.testing import CliRunner

from veilcam_client import __version__
from veilcam_mqtt.cli import JsonFormatter, app

runner = CliRunner()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--broker", "mqtt://broker.example"], "--allow-plain"),
        (["--username", "me", "--password-file", "{tmp}/none"], "cannot be read"),
        (["--username", "me", "--password-file", "{tmp}/two"], "must hold one line"),
        (["--password-file", "{tmp}/one"], "give --username"),
        (["--token-file", "{tmp}/none"], "cannot be read"),
        (["--webhook", "https://a"], "give --webhook-secret-file"),
        (["--webhook", "https://a", "--webhook-secret-file", "{tmp}/one"], "whsec_"),
        (["--name", "a/b"], "no level of a topic"),
        (["--base", "#"], "no level of a topic"),
        (["--url", "nonsense"], "http://HOST:PORT"),
        (["--url", "http://192.0.2.1", "--token-file", "{tmp}/one"], "use https://"),
        (["--log-level", "loud"], "one of debug"),
        (["--broker", "mqtts://a", "--ca-file", "{tmp}/one"], "cannot be used"),
        (["--broker", "mqtts://a", "--certificate", "{tmp}/one", "--key", "{tmp}/one"], "cannot"),
    ],
)
def test_option_that_does_not_fit_ends_with_a_line(
    options: list[str], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("veilcam_mqtt.cli.configure_logs", lambda *_, **__: None)
    (tmp_path / "one").write_text("word\n")
    (tmp_path / "two").write_text("word\nanother\n")
    result = runner.invoke(app, [option.replace("{tmp}", str(tmp_path)) for option in options])
    assert result.exit_code == 2, result.output
    (line,) = result.stderr.splitlines()
    assert line.startswith("veilcam-mqtt: error: ")
    assert message in line


def test_version_is_that_of_the_package() -> None:
    assert runner.invoke(app, ["--version"]).stdout == f"veilcam-mqtt {__version__}\n"


def test_every_option_stands_in_the_environment_too() -> None:
    text = runner.invoke(app, ["--help"], env={"COLUMNS": "300"}).stdout
    options = set(re.findall(r"^  (--[a-z][a-z-]+)", text, re.MULTILINE))
    named = {
        f"--{name.lower().replace('_', '-')}" for name in re.findall(r"VEILCAM_MQTT_(\w+)", text)
    }
    assert options - named <= {
        *("--url", "--profile", "--token-file", "--json", "--version", "--help"),
        *("--install-completion", "--show-completion"),
    }
    assert "VEILCAM_TOKEN_FILE" in text


def test_line_of_the_log_is_json_and_repeats_no_text_of_an_error() -> None:
    record = logging.LogRecord("veilcam.mqtt", logging.WARNING, "f", 1, "broker: %s", ("a",), None)
    entry = json.loads(JsonFormatter().format(record))
    assert (entry["event"], entry["level"]) == ("broker: a", "warning")
    error = ValueError("hidden")
    record.exc_info = (ValueError, error, None)
    assert json.loads(JsonFormatter().format(record))["error"] == "ValueError"
    assert "hidden" not in JsonFormatter().format(record)
