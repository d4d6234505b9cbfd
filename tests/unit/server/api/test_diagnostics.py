"""What the daemon tells of itself: metrics and diagnostics."""

from __future__ import annotations

import asyncio
import platform
import re
import shutil
import subprocess
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import TYPE_CHECKING
from unittest.mock import Mock

import httpx
import pytest
from prometheus_client.parser import text_string_to_metric_families

from veilcam_client.wire.rotation import EveryCaptures
from veilcam_client.wire.status import Diagnostics
from veilcam_server.api.app import create_app
from veilcam_server.api.routes.diagnostics import CHECKUP_EVERY, Checkups
from veilcam_server.devices import DisplayError, SensorError
from veilcam_server.doctor.finding import Finding
from veilcam_server.gate.protocol import Connections, GateProtocol
from veilcam_server.security.admission import open_admission
from veilcam_server.settings import Settings

if TYPE_CHECKING:
    from tests.unit.server.conftest import Bench, Running

pytestmark = pytest.mark.anyio

API = (Path(__file__).parents[4] / "docs" / "api.md").read_text()


def samples(text: str) -> dict[tuple[str, str], float]:
    """Values by name and labels."""
    return {
        (sample.name, ",".join(f"{key}={value}" for key, value in sorted(sample.labels.items()))): (
            sample.value
        )
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }


async def test_metrics_count_what_happened(
    running: Running, bench: Bench, display_fault: DisplayError
) -> None:
    def fail() -> None:
        raise SensorError("no frame came")

    async with running() as client:
        await client.post("/v1/captures")
        await client.post("/v1/classifications")
        await client.post("/v1/rotation/advance")
        bench.sensor.before = fail
        await client.post("/v1/captures")
        await client.get("/v1/a-stranger-s-words")
        await client.request("BREW", "/v1/status")
        answer = await client.get("/v1/metrics")
    assert answer.headers["content-type"].startswith("text/plain; version=1.0.0")
    found = samples(answer.text)
    assert found["veilcam_captures_total", ""] == 2
    assert found["veilcam_classifications_total", ""] == 1
    assert found["veilcam_masks_shown_total", ""] == 1
    assert found["veilcam_faults_total", "code=sensor_failed"] == 1
    assert found["veilcam_state", "state=ready"] == 1
    assert found["veilcam_state", "state=safe"] == 0
    assert found["veilcam_queued_captures", ""] == 0
    assert found["veilcam_log_entries_missed_total", ""] == 0
    name = "veilcam_http_request_duration_seconds_count"
    assert found[name, "method=POST,route=/v1/captures,status=200"] == 1
    assert found[name, "method=POST,route=/v1/captures,status=503"] == 1
    assert found[name, "method=other,route=none,status=404"] == 1
    assert "stranger" not in answer.text
    assert "BREW" not in answer.text


@asynccontextmanager
async def behind_a_gate(bench: Bench, connections: Connections) -> AsyncIterator[httpx.AsyncClient]:
    service = bench.service(bench.camera())
    transport = httpx.ASGITransport(create_app(service, connections=connections))
    async with (
        service.open(),
        httpx.AsyncClient(transport=transport, base_url="http://localhost") as client,
    ):
        yield client


async def test_metrics_count_connections(bench: Bench) -> None:
    connections = Connections(1, 0, 600.0, 600.0)
    for _ in range(3):
        connections.enter(Mock(GateProtocol, peer="a"))
    async with behind_a_gate(bench, connections) as client:
        counted = samples((await client.get("/v1/metrics")).text)
    assert counted["veilcam_open_connections", ""] == 1
    assert counted["veilcam_connections_dropped_total", "reason=evicted"] == 2
    assert counted["veilcam_connections_dropped_total", "reason=body"] == 0
    assert counted["veilcam_connections_failed_total", ""] == 0


async def test_metrics_tell_what_runs_and_how_old_the_mask_is(
    running: Running, display_fault: DisplayError, bench: Bench
) -> None:
    async with running() as client:
        told = (await client.get("/v1/status")).json()
        found = samples((await client.get("/v1/metrics")).text)
        later = samples((await client.get("/v1/metrics")).text)
        bench.display.faults = [display_fault, display_fault]
        await client.post("/v1/rotation/advance")
        without = samples((await client.get("/v1/metrics")).text)
    labels = f"python_version={platform.python_version()},version={told['version']}"
    assert found["veilcam_build_info", labels] == 1
    age = "veilcam_epoch_age_seconds", ""
    assert told["rotation"]["epoch_age_s"] < found[age] < later[age] < 60
    # No mask is shown, so none is old.
    assert age not in without


async def test_metrics_are_named_as_prometheus_wants_it(running: Running) -> None:
    """https://prometheus.io/docs/practices/naming/, and what promtool finds, where it is."""
    async with running() as client:
        await client.post("/v1/captures")
        text = (await client.get("/v1/metrics")).text
    families = list(text_string_to_metric_families(text))
    assert len(families) > 12
    for family in families:
        assert re.fullmatch("(veilcam|process)(_[a-z]+)+", family.name), family.name
        assert family.documentation.endswith("."), family.name
        # The only units are base units, at the end; what is counted ends with _total.
        assert not re.search("_(ms|milliseconds|minutes|mb|kb|percent)(_|$)", family.name)
        for sample in family.samples:
            assert sample.name.endswith("_total") == (family.type == "counter")
        assert not family.name.endswith(("_count", "_sum", "_bucket", "_gauge", "_counter"))
    names = {family.name for family in families}
    assert {"veilcam_http_request_duration_seconds", "veilcam_epoch_age_seconds"} <= names
    promtool = shutil.which("promtool")
    if promtool is not None:
        command = [promtool, "check", "metrics"]
        found = subprocess.run(command, input=text, capture_output=True, text=True, check=False)
        assert (found.returncode, found.stdout, found.stderr) == (0, "", "")


async def test_every_metric_is_documented_and_no_other(bench: Bench) -> None:
    async with behind_a_gate(bench, Connections(1, 0, 600.0, 600.0)) as client:
        text = (await client.get("/v1/metrics")).text
    told = set(re.findall(r"^# TYPE (veilcam_\w+)", text, re.MULTILINE))
    rows = re.findall(r"^\| (`veilcam_.*) \| (?:gauge|counter|histogram) \|", API, re.MULTILINE)
    documented = {name for row in rows for name in re.findall(r"\w+", row)}
    assert {name for name in told if not name.endswith("_created")} == documented


async def test_metrics_tell_nothing_of_what_was_seen(running: Running, bench: Bench) -> None:
    async with running(policy=EveryCaptures(captures=1)) as client:
        labels = {(await client.post("/v1/classifications")).json()["label"] for _ in range(3)}
        first = (await client.get("/v1/metrics")).text
        names = {name for name, _ in samples(first)}
    assert not any(f'"{label}"' in first for label in labels)
    assert not any(epoch in first for epoch in bench.epochs)
    assert all(name.startswith(("veilcam_", "process_")) for name in names)


async def test_two_daemons_in_one_process_count_apart(running: Running, lone_bench: Bench) -> None:
    lone_bench.state_dir = lone_bench.state_dir.with_name("other")
    async with running() as client, running(on=lone_bench) as other:
        await client.post("/v1/captures")
        assert samples((await other.get("/v1/metrics")).text)["veilcam_captures_total", ""] == 0


async def test_diagnostics_tell_of_the_last_states_and_faults(
    running: Running, bench: Bench, display_fault: DisplayError, tmp_path: Path
) -> None:
    async with running() as client:
        bench.display.faults = [display_fault, display_fault]
        await client.post("/v1/rotation/advance")
        answer = await client.get("/v1/diagnostics")
    told = Diagnostics.model_validate_json(answer.content)
    states = [past.state for past in told.states]
    assert states[0] == "ready"
    assert "safe" in states
    assert told.faults[0].code == "display_failed"
    assert told.fault_counts["display_failed"] == 1
    assert told.events["fault"] >= 1
    assert told.log_missed == 0
    assert told.versions["veilcam"]
    assert [past.at for past in told.states] == sorted(past.at for past in told.states)


@pytest.mark.parametrize("path", ["/v1/captures", "/v1/classifications"])
async def test_panel_that_does_not_hide_is_told_to_all_and_answered_to_nobody(
    running: Running, bench: Bench, path: str
) -> None:
    async with running(policy=EveryCaptures(captures=1)) as client:
        bench.sensor.lights = lambda: 1.0
        answer = await client.post(path)
        told = Diagnostics.model_validate_json((await client.get("/v1/diagnostics")).content)
    assert answer.status_code == 503
    assert answer.json()["code"] == "panel_not_hiding"
    assert [fault.code for fault in told.faults] == ["panel_not_hiding"]
    assert "none yet" in told.faults[0].detail
    assert told.events.get("capture", 0) == told.events.get("classification", 0) == 0
    assert told.states[-1].state == "safe"


async def test_settings_are_told_without_what_could_be_secret(
    running: Running, tmp_path: Path
) -> None:
    planted = "PLANTED"
    given = {
        "bundle": tmp_path / f"{planted}.veilcam",
        "device": "simulated",
        "scenes": (str(tmp_path / planted),),
        "imperfections": tmp_path / planted,
        "host": "127.9.8.7",
        "state_dir": tmp_path / planted,
        "tls_certificate": tmp_path / planted,
        "tls_key": tmp_path / planted,
        "rotation": {"mode": "captures", "captures": 77},
        "callers": 5,
    }
    settings = Settings.model_validate(given)
    with open_admission(settings) as admission:
        async with running(admission=admission) as client:
            text = (await client.get("/v1/diagnostics")).text
    assert planted not in text
    assert str(tmp_path) not in text
    assert "127.9.8.7" not in text
    told = Diagnostics.model_validate_json(text).settings
    assert set(told) == set(Settings.model_fields)
    assert told["tls_key"] == told["host"] == "given"
    assert told["device"] == "simulated"
    assert told["callers"] == 5
    assert told["socket"] is None
    rotation = told["rotation"]
    assert isinstance(rotation, dict)
    assert rotation["captures"] == 77


async def test_doctor_looks_once_in_a_while_whoever_asks() -> None:
    looks, now = 0, 100.0

    def examine() -> list[Finding]:
        nonlocal looks
        looks += 1
        return [Finding("disk", "bad", f"{looks} MiB free", "make room")]

    checkups = Checkups(examine, lambda: now)
    first, again = await asyncio.gather(checkups.findings(), checkups.findings())
    assert first is again
    assert first.findings[0].model_dump() == {
        "name": "disk",
        "outcome": "bad",
        "found": "1 MiB free",
        "remedy": "make room",
    }
    now += CHECKUP_EVERY
    assert (await checkups.findings()).findings[0].found == "2 MiB free"
    assert looks == 2
