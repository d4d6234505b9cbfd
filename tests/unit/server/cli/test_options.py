"""An option for every setting, and the same ones in every command."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from typer.testing import CliRunner

from veilcam_client.wire.rotation import EveryCaptures, EverySeconds, RotationOff
from veilcam_server.cli.main import app
from veilcam_server.settings import Settings
from veilcam_server.wiring import DoctorSettings, Wiring

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

runner = CliRunner()

SIMULATED = ("--simulate",)
CERTIFICATE, KEY = ("--tls-certificate", "c.pem"), ("--tls-key", "k.pem")

CASES: Mapping[str, tuple[Sequence[str], object]] = {
    "panel": (("--panel", "ILI9341"), "ILI9341"),
    "sensor": (("--sensor", "IMX219"), "IMX219"),
    "panel_tab": (("--panel-tab", "red"), "red"),
    "spi": (("--spi", "/dev/spidev1.1"), Path("/dev/spidev1.1")),
    "spi_hz": (("--spi-hz", "1000000"), 1_000_000),
    "gpio_chip": (("--gpio-chip", "mine"), "mine"),
    "data_line": (("--data-line", "5"), 5),
    "reset_line": (("--reset-line", "6"), 6),
    "panel_read_back": (("--panel-read-back", "miso"), "miso"),
    "trust_clock": (("--trust-clock",), True),
    "camera_number": (("--camera-number", "1"), 1),
    "exposure_factor": (("--exposure-factor", "3"), 3.0),
    "bundle": (("--bundle", "other.veilcam"), Path("other.veilcam")),
    "owner_keys": (("--owner-keys", "owners"), Path("owners")),
    "allow_older": (("--allow-older",), True),
    "allow_visible": (("--allow-visible",), True),
    "device": (SIMULATED, "simulated"),
    "scenes": ((*SIMULATED, "--scenes", "a.png", "--scenes", "b.png"), ("a.png", "b.png")),
    "skip_damaged": ((*SIMULATED, "--scenes", "a", "--skip-damaged"), True),
    "scene_api": ((*SIMULATED, "--scene-api"), True),
    "replay": (("--replay", "r.jsonl"), Path("r.jsonl")),
    "host": (("--host", "::1"), "::1"),
    "hosts": (("--hosts", "a.example", "--hosts", "B:1"), ("a.example", "b:1")),
    "frame_ancestors": (("--frame-ancestors", "https://a.example"), ("https://a.example",)),
    "port": (("--port", "0"), 0),
    "root_path": (("--root-path", "/camera"), "/camera"),
    "socket": (("--socket", "s"), Path("s")),
    "state_dir": (("--state-dir", "state"), Path("state")),
    "rotation": (("--every-captures", "3", "--reuse", "2"), EveryCaptures(captures=3, reuse=2)),
    "watch": (("--watch", "2/s"), "2/s"),
    "quiet_hours": (("--quiet-hours", "22-7"), "22-7"),
    "watch_threshold": (("--watch-threshold", "0.9"), 0.9),
    "calibration": (("--calibration", "c.json"), Path("c.json")),
    "release": (("--release", "sealed"), "sealed"),
    "raw_budget": (("--raw-budget", "3"), 3),
    "full_scores": (("--full-scores",), True),
    "beat": (("--beat", "off"), "off"),
    "settle": (("--settle", "0"), 0.0),
    "exposure": (("--exposure", "0.02"), 0.02),
    "snr_db": (("--simulate", "--snr-db", "30"), 30.0),
    "imperfections": ((*SIMULATED, "--imperfections", "b.json"), Path("b.json")),
    "guard": (("--guard", "3"), 3.0),
    "callers": (("--callers", "3"), 3),
    "auth": (("--auth", "none"), "none"),
    "tls_certificate": ((*CERTIFICATE, *KEY), Path("c.pem")),
    "tls_key": ((*CERTIFICATE, *KEY), Path("k.pem")),
    "wrong_classifier": ((*SIMULATED, "--wrong-classifier"), True),
    "log_level": (("--log-level", "error"), "error"),
}


@pytest.fixture
def told(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[Any]:
    """Settings with which a command did its work."""
    settings: list[Any] = []

    def note(*given: object, **_: object) -> list[object]:
        settings.extend(each for each in given if isinstance(each, Wiring))
        return []

    for work in (
        "daemon.serve",
        "cli.calibration_session.calibrate_device",
        "doctor.checkup.examine",
    ):
        monkeypatch.setattr(f"veilcam_server.{work}", note)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    return settings


def run(*command: str) -> None:
    result = runner.invoke(app, list(command))
    assert result.exit_code == 0, result.output


def test_every_setting_has_an_option() -> None:
    assert set(CASES) == set(Settings.model_fields)


@pytest.mark.thorough
@pytest.mark.parametrize("name", CASES)
def test_every_option_changes_its_setting(told: list[Any], name: str) -> None:
    options, value = CASES[name]
    base = () if name in ("replay", "bundle") else ("--bundle", "x.veilcam")
    run("serve", *base, *options)
    assert getattr(told[0], name) == value
    assert getattr(Settings(bundle=Path("x.veilcam")), name) != value


def test_masks_change_every_so_many_seconds(told: list[Any]) -> None:
    run("serve", "--simulate", "--every-seconds", "30", "--jitter", "10", "--reuse", "1")
    assert told[0].rotation == EverySeconds(seconds=30, jitter=10, reuse=1)


def test_masks_never_change(told: list[Any]) -> None:
    run("serve", "--simulate", "--rotation-off")
    assert told[0].rotation == RotationOff()
    for more in ("--every-seconds=3", "--every-captures=3", "--jitter=0", "--reuse=0"):
        result = runner.invoke(app, ["serve", "--simulate", "--rotation-off", more])
        assert result.exit_code == 2
        assert "with --rotation-off no mask changes" in result.stderr


@pytest.mark.parametrize(
    ("command", "settings"), [("calibrate", Wiring), ("doctor", DoctorSettings)]
)
def test_other_commands_have_the_options_of_serve(
    told: list[Any], command: str, settings: type[Wiring]
) -> None:
    base = ("--bundle", "x.veilcam") if command == "calibrate" else ()
    for name in settings.model_fields:
        options, value = CASES[name]
        run(command, *(() if name == "bundle" else base), *options)
        assert getattr(told[-1], name) == value


@pytest.mark.parametrize("command", ["serve", "calibrate", "doctor"])
def test_option_that_is_none_is_refused(told: list[Any], command: str) -> None:
    result = runner.invoke(app, [command, "--no-such-option"])
    assert result.exit_code == 2
    assert not told


def test_help_tells_what_is_taken_if_nothing_is_given() -> None:
    result = runner.invoke(app, ["serve", "--help"], env={"COLUMNS": "200", "TERM": "dumb"})
    for field in Settings.model_fields.values():
        assert field.description
    for told in ("Default: 8787.", "Default: 127.0.0.1.", "Default: /dev/spidev0.0."):
        assert told in result.stdout
