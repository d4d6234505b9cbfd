"""What a daemon may be told, and the refusal of everything else."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError
from typer.testing import CliRunner

from veilcam_client.wire.rotation import EveryCaptures, EverySeconds
from veilcam_client.wire.watch import OnRequest, QuietHours, Watching, WatchOff, WatchPolicy
from veilcam_server.cli.main import app
from veilcam_server.cli.terminal import one_line
from veilcam_server.demo_data import BUNDLE
from veilcam_server.environment import default_state_dir, unknown_names
from veilcam_server.settings import Settings

runner = CliRunner()


def refused(**given: Any) -> str:
    with pytest.raises(ValidationError) as caught:
        Settings(**{"bundle": Path("a.veilcam"), "device": "simulated", **given})
    return one_line(caught.value)


@pytest.mark.parametrize("host", ["0.0.0.0", "192.168.1.7", "::"])
def test_other_machines_are_served_with_tls_and_tokens_only(host: str) -> None:
    tls = {"tls_certificate": Path("c.pem"), "tls_key": Path("k.pem")}
    for given in ({}, {"auth": "tokens"}, {"auth": "none", **tls}):
        assert f"--host {host}: other machines are served with TLS" in refused(host=host, **given)
    made = Settings.model_validate({"bundle": Path("a.veilcam"), "host": host, **tls})
    assert made.serves_others
    assert made.auth == "tokens"


@pytest.mark.parametrize("host", ["camera.example", ""])
def test_host_is_an_address(host: str) -> None:
    assert "is no IP address" in refused(host=host)


def test_further_names_are_hosts() -> None:
    made = Settings(bundle=Path("a.veilcam"), hosts=("Camera.example", "door_2:8443", "[FE80::1]"))
    assert made.hosts == ("camera.example", "door_2:8443", "[fe80::1]")
    made = Settings.model_validate({"replay": "r.jsonl", "hosts": ("a.example",)})
    assert made.hosts == ("a.example",)
    wrongs = ("https://a.example", "a.example/", "", "a b", "*.example", "a:", ".example", "a;")
    for wrong in wrongs:
        assert refused(hosts=("a.example", wrong)) == (
            f"--hosts: {wrong!r} is no host name: use camera.example, or with :PORT"
        )


def test_pages_in_whose_frames_it_may_stand_are_origins() -> None:
    origins = ("https://home.example", "http://home.example:8123")
    assert Settings(bundle=Path("a"), frame_ancestors=origins).frame_ancestors == origins
    # What stands in a header must not go on to another directive.
    for wrong in ("home.example", "https://a.example/", "https://*", "'self'", "https://a; x", "*"):
        assert refused(frame_ancestors=(wrong,)) == (
            f"--frame-ancestors: {wrong!r} is no origin: use https://home.example, or with :PORT"
        )


def test_one_name_or_several_come_from_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    for given, hosts in (("a.example", ("a.example",)), ('["a", "b:1"]', ("a", "b:1"))):
        monkeypatch.setenv("VEILCAM_HOSTS", given)
        assert Settings(bundle=Path("a.veilcam")).hosts == hosts


def test_redacted_settings_are_json() -> None:
    made = Settings(bundle=Path("a.veilcam"), device="simulated", snr_db=math.inf, beat="off")
    assert json.loads(json.dumps(made.redacted(), allow_nan=False))["snr_db"] == "inf"
    assert made.redacted()["beat"] == "off"


def test_watch_setting_is_a_rate_and_hours() -> None:
    def policy(**given: str) -> WatchPolicy:
        return Settings.model_validate({"bundle": Path("a.veilcam"), **given}).watch_policy

    night = QuietHours(begin="22:00", end="07:00")
    assert policy() == OnRequest()
    assert policy(quiet_hours="22-7") == OnRequest(quiet=night)
    assert policy(watch="2/s") == Watching(rate_hz=2.0)
    assert policy(watch="30/min", quiet_hours="22-7") == Watching(rate_hz=0.5, quiet=night)
    assert policy(watch="off") == WatchOff()
    assert refused(watch="on") == (
        "--watch: 'on' is no rate: use 2/s, 30/min or 6/h, from 1/h to 10/s"
    )
    assert "are no hours: use 22-7" in refused(quiet_hours="at night")
    made = Settings(bundle=Path("a.veilcam"), watch="2/s", quiet_hours="22-7").redacted()
    assert (made["watch"], made["quiet_hours"]) == ("2/s", "22-7")


def test_names_are_not_told() -> None:
    made = Settings(bundle=Path("a.veilcam"), hosts=("a.example",), frame_ancestors=())
    assert (made.redacted()["hosts"], made.redacted()["frame_ancestors"]) == ("given", None)


def test_tokens_are_wanted_unless_the_camera_is_simulated() -> None:
    assert Settings(bundle=Path("a.veilcam")).auth == "tokens"
    assert Settings.model_validate({"device": "simulated"}).auth == "none"
    assert Settings.model_validate({"device": "simulated", "auth": "tokens"}).auth == "tokens"
    assert Settings(bundle=Path("a.veilcam"), auth="none").auth == "none"


def test_tls_costs_memory_for_each_connection() -> None:
    settings = Settings(bundle=Path("a.veilcam"))
    tls = {"tls_certificate": Path("c.pem"), "tls_key": Path("k.pem")}
    assert (settings.connections, settings.streams) == (512, 256)
    settings = settings.model_copy(update=tls)
    assert (settings.connections, settings.streams) == (128, 64)


@pytest.mark.parametrize("callers", [1, 2, 16, 1024])
@pytest.mark.parametrize("tls", [{}, {"tls_certificate": Path("c"), "tls_key": Path("k")}])
def test_limits_follow_the_number_of_callers(callers: int, tls: dict[str, Any]) -> None:
    settings = Settings(bundle=Path("a.veilcam"), callers=callers, **tls)
    assert callers < settings.connections <= 4096
    assert 1 <= settings.caller_streams <= settings.streams < settings.connections
    assert 1 < settings.queue < settings.connections
    assert settings.concurrency < settings.connections or callers == 1024
    assert settings.burst > settings.rate > 0


def test_limits_by_default_are_those_of_the_documentation() -> None:
    settings = Settings(bundle=Path("a.veilcam"))
    assert (settings.rate, settings.burst, settings.concurrency) == (100.0, 200, 64)
    assert (settings.caller_streams, settings.queue) == (16, 8)


@pytest.mark.parametrize("host", ["127.0.0.1", "127.0.0.2", "::1", "localhost"])
def test_this_machine_is_served(host: str) -> None:
    settings = Settings(bundle=Path("a.veilcam"), host=host)
    assert settings.host in ("127.0.0.1", "127.0.0.2", "::1")


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("port", 70_000),
        ("settle", -1.0),
        ("settle", float("nan")),
        ("exposure", 11.0),
        ("guard", 601.0),
        ("guard", float("inf")),
        ("auth", "sometimes"),
        ("callers", 0),
        ("callers", 1025),
        ("log_level", "loud"),
        ("release", "everything"),
        ("release", "flat"),
        ("raw_budget", -1),
        ("raw_budget", 10**9 + 1),
        ("device", "virtual"),
        ("panel_tab", "blue"),
        ("spi_hz", 0),
        ("gpio_chip", ""),
        ("data_line", -1),
        ("reset_line", 5000),
        ("panel_read_back", "yes"),
        ("camera_number", -1),
        ("exposure_factor", 0.5),
        ("exposure_factor", float("inf")),
    ],
)
def test_values_out_of_range_are_named(name: str, value: object) -> None:
    message = refused(**{name: value})
    assert message.startswith(f"--{name.replace('_', '-')}: ")
    assert "\n" not in message


def test_real_camera_needs_a_bundle_and_a_simulated_one_has_the_demo_s() -> None:
    with pytest.raises(ValidationError) as caught:
        Settings.model_validate({})
    assert one_line(caught.value).startswith("--bundle is missing")
    assert Settings.model_validate({"device": "simulated"}).bundle == BUNDLE


def test_environment_fills_in(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VEILCAM_BUNDLE", "b.veilcam")
    monkeypatch.setenv("VEILCAM_ROTATION", '{"mode": "captures", "captures": 4}')
    monkeypatch.setenv("VEILCAM_PORT", "9000")
    settings = Settings.model_validate({"port": 9001})
    assert settings.bundle == Path("b.veilcam")
    assert settings.rotation == EveryCaptures(captures=4)
    assert settings.port == 9001


def test_state_goes_where_systemd_says(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", "/elsewhere")
    assert default_state_dir() == Path("/elsewhere/veilcam")
    monkeypatch.setenv("STATE_DIRECTORY", "/var/lib/veilcam")
    assert default_state_dir() == Path("/var/lib/veilcam")
    monkeypatch.setenv("VEILCAM_STATE_DIRECTORY", "/srv/veilcam")
    assert default_state_dir() == Settings(bundle=Path("a.veilcam")).state_dir
    assert default_state_dir() == Path("/srv/veilcam")


@pytest.mark.parametrize(
    ("name", "remedy"),
    [
        ("VEILCAM_PROT", "did you mean VEILCAM_PORT?"),
        ("VEILCAM_TLS_CERT", "did you mean VEILCAM_TLS_CERTIFICATE?"),
        ("veilcam_paneltab", "did you mean VEILCAM_PANEL_TAB?"),
        ("VEILCAM_XYZZY_PLUGH_FROTZ", "leave it out"),
        ("VEILCAM_", "leave it out"),
    ],
)
def test_name_that_is_nobody_s_is_refused(
    monkeypatch: pytest.MonkeyPatch, name: str, remedy: str
) -> None:
    monkeypatch.setenv(name, "the value, which may be secret")
    assert refused() == f"{name} in the environment is no setting: {remedy}"
    result = runner.invoke(app, ["serve", "--simulate"])
    assert result.exit_code == 2
    assert result.stderr == f"veilcamd: error: {refused()}\n"


def test_every_name_at_fault_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VEILCAM_PROT", "1")
    monkeypatch.setenv("VEILCAM_HOTS", "::1")
    assert refused().count("did you mean") == 2


def test_no_name_that_is_used_anywhere_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    root = Path(__file__).resolve().parents[3]
    files = [root / "Makefile", root / "README.md"]
    for room in ("client", "server", "deploy", "docs", "examples", "benchmarks"):
        files += (
            path for path in (root / room).rglob("*") if path.suffix in (".py", ".md", ".env")
        )
    named = set(
        re.findall(r"VEILCAM_[A-Z][A-Z_]*[A-Z]\b", "\n".join(path.read_text() for path in files))
    )
    assert {"VEILCAM_TOKEN", "VEILCAM_URL", "VEILCAM_PANEL_TAB", "VEILCAM_TEST_THREADS"} <= named
    for name in (*named, "veilcam_port"):
        monkeypatch.setenv(name, "a value")
    assert unknown_names(Settings.model_fields) == {}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--every-seconds", "0"], "--every-seconds: Input should be greater than or equal to 0.1"),
        (["--every-captures", "0"], "--every-captures: Input should be greater than"),
        (["--every-captures", "2", "--every-seconds", "2"], "not both"),
        (["--jitter", "2"], "--jitter goes with --every-seconds"),
        (["--every-captures", "2", "--jitter", "2"], "--jitter goes with --every-seconds"),
        (["--every-seconds", "2", "--jitter", "2"], "leaves a mask less than 0.1 s"),
        (["--reuse", "2"], "--reuse goes with --every-seconds or --every-captures"),
        (["--every-captures", "2", "--reuse", "-1"], "--reuse: Input should be greater than"),
        (["--release", "everything"], "--release: Input should be 'none'"),
        (["--host", "0.0.0.0"], "other machines are served with TLS and tokens only"),
        (["--port", "-1"], "--port: "),
        (["--settle", "-1"], "--settle: "),
    ],
)
def test_bad_options_end_with_one_line(options: list[str], message: str) -> None:
    result = runner.invoke(app, ["serve", "--simulate", *options])
    assert result.exit_code == 2
    assert message in result.stderr
    assert result.stderr.startswith("veilcamd: error: ")
    assert result.stderr.count("\n") == 1


CONTRADICTIONS: tuple[tuple[dict[str, Any], tuple[str, ...]], ...] = (
    ({"exposure": 0.1, "exposure_factor": 101.0}, ("--exposure 0.1 s", "--exposure-factor 101")),
    ({"exposure": 0.0}, ("--exposure 0 s", "--exposure-factor 1")),
    ({"exposure_factor": 200.0}, ("--exposure 0.01 s", "--exposure-factor 200")),
    (
        {"rotation": EverySeconds(seconds=1.0), "settle": 2.0},
        ("--every-seconds 1", "--settle 2 s"),
    ),
    (
        {"rotation": EverySeconds(seconds=9.0, jitter=8.0), "exposure": 1.0},
        ("--every-seconds 9", "--jitter 8", "--exposure 1 s"),
    ),
    ({"watch": "10/s", "exposure": 0.2}, ("--watch 10/s", "--exposure 0.2 s")),
    (
        {"watch": "5/s", "rotation": EveryCaptures(captures=1), "settle": 0.3},
        ("--watch 5/s", "--settle 0.3 s"),
    ),
    ({"watch": "off", "quiet_hours": "22-7"}, ("--watch off", "--quiet-hours")),
    ({"quiet_hours": "7-7"}, ("--quiet-hours", "no time at all")),
    ({"data_line": 24}, ("--data-line", "--reset-line")),
    ({"data_line": 10}, ("--data-line 10", "--spi /dev/spidev0.0")),
    ({"reset_line": 8}, ("--reset-line 8", "--spi /dev/spidev0.0")),
    ({"reset_line": 17, "spi": Path("/dev/spidev1.1")}, ("--reset-line 17", "/dev/spidev1.1")),
    ({"snr_db": 30.0}, ("--snr-db", "--simulate")),
    ({"scenes": ("scene.npy",)}, ("add --simulate",)),
    ({"wrong_classifier": True}, ("it needs --simulate",)),
    ({"tls_certificate": Path("c.pem")}, ("--tls-certificate", "--tls-key", "give both")),
    ({"tls_key": Path("k.pem")}, ("--tls-certificate", "--tls-key", "give both")),
    (
        {"tls_certificate": Path("c"), "tls_key": Path("k"), "socket": Path("s")},
        ("unix socket", "--tls-certificate", "needs no TLS"),
    ),
    ({"owner_keys": Path("k"), "allow_older": True}, ("--owner-keys", "--allow-older")),
)


@pytest.mark.parametrize(("given", "names"), CONTRADICTIONS)
def test_settings_that_contradict_each_other_are_refused_by_their_names(
    given: dict[str, Any], names: tuple[str, ...]
) -> None:
    message = refused(device="pi", **given)
    assert all(name in message for name in names), message
    assert "\n" not in message


@pytest.mark.parametrize(
    ("exposure", "settle", "timeout", "every"),
    [
        (0.01, 0.1, 5.0, 600.0),
        (1.2, 0.1, 5.0, 600.0),
        (2.0, 0.1, 8.05, 600.0),
        (10.0, 60.0, 40.05, 1260.0),
    ],
)
def test_times_follow_from_exposure_and_settling(
    exposure: float, settle: float, timeout: float, every: float
) -> None:
    settings = Settings(bundle=Path("a.veilcam"), exposure=exposure, settle=settle)
    assert settings.capture_timeout == pytest.approx(timeout)
    assert settings.self_test_every == every


@pytest.mark.parametrize(
    "given",
    [
        {"exposure": 10.0},
        {"exposure": 0.1, "exposure_factor": 100.0},
        {"exposure": 0.0, "settle": 0.0, "device": "simulated"},
        {"rotation": EverySeconds(seconds=2.2, jitter=0.1), "settle": 2.0},
        {"watch": "10/s"},
        {"watch": "10/s", "rotation": EveryCaptures(captures=1), "settle": 0.08},
        {"data_line": 7},
        {"data_line": 10, "spi": Path("/dev/spidev1.0")},
        {"data_line": 10, "gpio_chip": "mine"},
    ],
)
def test_settings_that_only_just_fit_are_taken(given: dict[str, Any]) -> None:
    assert Settings(**{"bundle": Path("a.veilcam"), "device": "pi", **given})


def test_ratio_of_noise_that_is_no_number_is_refused() -> None:
    assert refused(snr_db=math.nan).startswith("--snr-db: ")
